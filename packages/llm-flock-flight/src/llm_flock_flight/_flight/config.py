"""The flight file: a run's configuration, its place in the world, the drones, and the safety limits."""

from __future__ import annotations

import math
from itertools import product
from typing import Self

from pydantic import Field, model_validator

from llm_flock.errors import InputError
from llm_flock.obstacles import clearance
from llm_flock.robots import PEAK_SPEED, MotionLimits, Position
from llm_flock.runtime import MissionFrame, Ros2Config, RunConfig, WorldConfig
from llm_flock_flight._addresses import one_spelling
from llm_flock_flight._crazyflie.radios import exchanges_of, plan_radios
from llm_flock_flight._flight.sections import FleetConfig, PositionsConfig, SafetyConfig

NOT_IN_FLIGHT = (
    *("kill", "join", "battery", "kill_random", "join_random", "noise", "drift", "sensing_delay"),
    *("moving_obstacles", "start_positions"),
)
"""Fields of a run that flights do not support: faults, noise and starts of real drones are real."""

DOWN_M = 0.12  # a drone with an estimate this near to the floor is down [m]

HEIGHT_TRACKING_M = 0.15
"""Default of `height_tracking_m` in the plane: a Crazyflie's stock controller overshoots a take-off by 8 cm [m]."""

ROUNDING_M = 1e-6  # tolerance of limits on lengths and times [m, s]
ON_FLOOR_M = 0.3  # largest distance of the estimate from the floor for a drone on it [m]


class FlightConfig(RunConfig):
    """Everything that defines a flight; raises InputError if it cannot be flown safely within the given limits."""

    world: WorldConfig = Field(default_factory=WorldConfig)
    fleet: FleetConfig = Field(default_factory=FleetConfig, title="Drones")
    safety: SafetyConfig = Field(default_factory=SafetyConfig)
    positions: PositionsConfig = Field(default_factory=PositionsConfig, title="Positions from outside")
    ros2: Ros2Config = Field(default_factory=Ros2Config, title="ROS 2")

    @model_validator(mode="after")
    def _check_flight(self) -> Self:
        for field in NOT_IN_FLIGHT:
            if getattr(self.trial, field):
                raise InputError(field, getattr(self.trial, field), says="cannot be used in a flight")
        for field in ("unit_m", "use_sim_time", "ros_missions", "ros_poses"):
            if getattr(self.ros2, field):
                raise InputError(
                    field, getattr(self.ros2, field), says="cannot be used in a flight, which ROS only watches"
                )
        if self.protocol.judge != "rule":
            raise InputError("judge", self.protocol.judge, "'rule' in a flight")
        if not self.protocol.shield:
            raise InputError("shield", self.protocol.shield, says="has to be on in a flight, whatever the protocol")
        self._check_positions()
        _check_drones(self)
        self._check_distances()
        self._check_speed()
        self._check_fence()
        _check_starts(self)
        return self

    def _check_positions(self) -> None:
        source = self.positions.pose_source
        if source != "none" and self.fleet.robot in ("simulated", "physics", "mavlink"):
            raise InputError("pose_source", source, says=f"cannot be used with robot = {self.fleet.robot!r}")
        if source == "ros2" and self.ros2.router is None:
            raise InputError("router", None, says="is needed with pose_source = 'ros2'")
        if source != "ros2" and self.ros2.ros_pose_topic is not None:
            raise InputError("ros_pose_topic", self.ros2.ros_pose_topic, says="needs pose_source = 'ros2' in a flight")

    def _check_distances(self) -> None:
        """The safe distance must hold the smallest distance of two drones and twice the tracking error."""
        safety, world = self.safety, self.world
        least = safety.min_separation_m + 2 * safety.tracking_m
        if self.safe_distance_m < least - ROUNDING_M:
            raise InputError(
                "safe_distance",
                self.mission.safe_distance,
                f"at least {least / world.scale_m:g} units: min_separation_m + 2 tracking_m = {least:g} m, and one "
                f"unit is {world.scale_m:g} m (here {self.safe_distance_m:g} m)",
            )
        above = safety.downwash_m + 2 * self.height_tracking_m
        if self.mission.dim == 3 and self.safe_distance_m * self.mission.downwash < above - ROUNDING_M:
            raise InputError(
                "downwash",
                self.mission.downwash,
                f"at least {above / self.safe_distance_m:.3g}, so that no drone flies in another's downwash: "
                f"downwash_m + 2 height_tracking_m = {above:g} m above each other",
            )

    def _check_speed(self) -> None:
        longest = self.mission.max_step * self.world.scale_m
        least = PEAK_SPEED * longest / self.safety.max_speed_m_s
        if self.safety.round_s < least - ROUNDING_M:
            raise InputError(
                "round_s",
                self.safety.round_s,
                f"at least {least:.3g} s: a step of {longest:g} m from rest to rest is {PEAK_SPEED:g} times as fast in "
                f"its middle as on average, and the limit is {self.safety.max_speed_m_s:g} m/s",
            )

        height = self.world.altitude_m - self.world.floor_m
        if height <= 0:
            raise InputError("altitude_m", self.world.altitude_m, f"above the floor at z = {self.world.floor_m:g} m")
        above, lowest = DOWN_M + self.height_tracking_m, min(z for _, _, z in self.corners) - self.world.floor_m
        if lowest < above - ROUNDING_M:
            raise InputError(
                "altitude_m",
                self.world.altitude_m,
                f"at least {self.world.altitude_m + above - lowest:.3g} m: the lowest place is {lowest:.3g} m above "
                f"the floor, and {DOWN_M:g} m + height_tracking_m = {above:g} m are asked for",
            )
        least = PEAK_SPEED * height / self.safety.max_speed_m_s
        for field in ("take_off_s", "land_s"):
            if getattr(self.safety, field) < least - ROUNDING_M:
                raise InputError(
                    field,
                    getattr(self.safety, field),
                    f"at least {least:.3g} s for {height:g} m at no more than {self.safety.max_speed_m_s:g} m/s",
                )

    def _check_fence(self) -> None:
        low, high = self.world.geofence
        if any(a >= b for a, b in zip(low, high, strict=True)):
            raise InputError("geofence", self.world.geofence, "two corners, each number of the first one lower")
        bounds = list(zip(*self.inner_fence, strict=True))
        for x, y, z in self.corners:
            if not all(a - ROUNDING_M <= v <= b + ROUNDING_M for v, (a, b) in zip((x, y, z), bounds, strict=True)):
                raise InputError(
                    "geofence",
                    self.world.geofence,
                    f"the arena of the mission in it, and tracking_m = {self.safety.tracking_m:g} m around it "
                    f"({self.height_tracking_m:g} m above and below): a corner of the arena is at "
                    f"({x:.3g}, {y:.3g}, {z:.3g}) m",
                )
        if self.world.floor_m < low[2]:
            raise InputError("floor_m", self.world.floor_m, f"within the geofence, which begins at z = {low[2]:g} m")

    @property
    def corners(self) -> list[Position]:
        """Corners of the arena in the world [m]."""
        return [self.frame.to_world(corner) for corner in product(*zip(*self.mission.arena, strict=True))]

    @property
    def safe_distance_m(self) -> float:
        """The safe distance in the plane [m]."""
        return self.mission.safe_distance * self.world.scale_m

    @property
    def inner_fence(self) -> tuple[Position, Position]:
        """The box for set-points: a drone that is off by the tracking error stays within the geofence [m]."""
        side, height = self.safety.tracking_m, self.height_tracking_m
        (a, b, c), (x, y, z) = self.world.geofence
        return (a + side, b + side, c + height), (x - side, y - side, z - height)

    @property
    def height_tracking_m(self) -> float:
        """Largest error of a drone's height [m]. In the plane none flies above another, so heights matter less."""
        safety = self.safety
        if safety.height_tracking_m is not None:
            return safety.height_tracking_m
        return safety.tracking_m if self.mission.dim == 3 else max(safety.tracking_m, HEIGHT_TRACKING_M)

    @property
    def fastest_m_s(self) -> float:
        """Highest speed of a set-point in a round [m/s]: the longest step, from rest to rest."""
        return PEAK_SPEED * self.mission.max_step * self.world.scale_m / self.safety.round_s

    @property
    def frame(self) -> MissionFrame:
        """The mission in the world."""
        return self.world.frame(*self.mission.arena)

    @property
    def driver_limits(self) -> MotionLimits:
        """Limits that the drivers enforce by themselves, as a last gate behind the checks of the flight."""
        low, high = self.world.geofence
        return MotionLimits(low=low, high=high, max_speed_m_s=1.001 * self.safety.max_speed_m_s)


def _check_drones(config: FlightConfig) -> None:
    """Drones are one for each robot, told apart by names and addresses, and may fly longer than they take off."""
    drones, n = config.fleet.drones, config.mission.n_robots
    if drones and config.fleet.crazyflies is not None:
        raise InputError("drones", f"{len(drones)} drones", "either drones, or crazyflies")
    if drones and len(drones) != n:
        raise InputError("drones", f"{len(drones)} drones", f"one for each of the mission's {n} robots")
    shared = config.fleet.robot == "mavlink"  # several autopilots may answer at one address
    for field in ("name",) if shared else ("name", "uri"):
        given = [value for drone in drones if (value := getattr(drone, field)) is not None]
        twice = next((value for value in given if given.count(value) > 1), None)
        if twice is not None:
            raise InputError("drones", twice, says=f"two drones have this {field}")
    called = [(drone.name, drone.uri) for drone in drones if drone.uri is not None]
    for fault in plan_radios(called, exchanges_of(round_s=config.safety.round_s)).faults:
        raise InputError("drones", None, says=fault)
    spelt: dict[str, tuple[str, str]] = {}
    for name, uri in called:
        first, as_it = spelt.setdefault(one_spelling(uri), (name, uri))
        if uri != as_it:
            raise InputError("drones", name, says=f"{uri} is the address of {first}, {as_it}, in other words")
    links = [(drone.uri, drone.system_id or 1) for drone in drones if shared]
    for uri, number in links:
        if links.count((uri, number)) > 1:
            raise InputError("system_id", number, f"one that no other drone at {uri} has")
    _check_batteries(config)


def _check_batteries(config: FlightConfig) -> None:
    """A battery that is good enough for a take-off is not too low in the air."""
    safety = config.safety
    limits = [("", safety.ready_battery_v, safety.low_battery_v)]
    for drone in config.fleet.drones:
        ready = safety.ready_battery_v if drone.ready_battery_v is None else drone.ready_battery_v
        low = safety.low_battery_v if drone.low_battery_v is None else drone.low_battery_v
        limits.append((f" of {drone.name}", ready, low))
    for whose, ready, low in limits:
        if low > ready:
            says = f"at most ready_battery_v{whose}, {ready:g} V: a drone would land as soon as it is up"
            raise InputError("low_battery_v", low, says)


def _check_starts(config: FlightConfig) -> None:
    """Starts are on the floor and apart, and drones may fly above them, where they take off and return to."""
    least, floor_m = config.safe_distance_m, config.world.floor_m
    starts = [(drone.name, drone.start) for drone in config.fleet.drones if drone.start is not None]
    for k, (one, here) in enumerate(starts):
        for two, there in starts[:k]:
            apart = math.dist(here[:2], there[:2])
            if apart < least - ROUNDING_M:
                allowed = f"starts at least {least:g} m apart, the safe distance (here {apart:.3f} m)"
                raise InputError("drones", f"{two} and {one}", allowed)
        who = "{} at ({:g}, {:g}) m".format(one, *here)
        if (wrong := wrong_place(config, *here[:2])) is not None:
            raise InputError("drones", who, f"a start {good_place(config)} (here {wrong})")
        if len(here) == 3 and abs(here[2] - floor_m) > ON_FLOOR_M:
            allowed = f"a start within {ON_FLOOR_M:g} m of the floor at z = {floor_m:g} m (here {here[2]:g} m)"
            raise InputError("drones", who, allowed)


def wrong_place(config: FlightConfig, x_m: float, y_m: float) -> str | None:
    """The reason why no drone may fly above a place on the floor; None if one may."""
    mission, place = config.mission, config.frame.to_mission((x_m, y_m, config.world.altitude_m))
    slack = ROUNDING_M / config.world.scale_m
    low, high = mission.arena
    if not all(a - slack <= v <= b + slack for a, v, b in zip(low, place, high, strict=True)):
        return "outside the arena"
    free = clearance(place, mission.obstacles)
    if free >= mission.body_radius - slack:
        return None
    return "in an obstacle" if free <= 0 else f"{free * config.world.scale_m:.2f} m from an obstacle"


def good_place(config: FlightConfig) -> str:
    """The places that `wrong_place` accepts, as text."""
    clear = f", at least {config.safe_distance_m / 2:.3g} m from its obstacles" if config.mission.obstacles else ""
    return f"in the mission's arena{clear}"
