"""The flight file: a run's configuration, its place in the world, the drones, and the safety limits."""

from __future__ import annotations

import math
from itertools import product
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from llm_flock.arrays import Point
from llm_flock.errors import InputError
from llm_flock.robots.base import PEAK_SPEED, MotionLimits, Position
from llm_flock.runtime.config import ConfigSection, RunConfig, seconds
from llm_flock.runtime.flight.drones import ROUNDING_M, check_drones, check_starts
from llm_flock.runtime.flight.frame import MissionFrame
from llm_flock.runtime.positions_config import PositionsConfig
from llm_flock.runtime.ros2_config import Ros2Config

Metres = Annotated[float, Field(ge=-1000, le=1000, allow_inf_nan=False)]

NOT_IN_FLIGHT = ("kill", "join", "kill_random", "join_random", "noise", "start_positions")
"""Fields of a run that flights do not support: faults, noise and starts of real drones are real."""

DOWN_M = 0.12
"""A drone with an estimate this near to the floor is down [m]."""

HEIGHT_TRACKING_M = 0.15
"""Default of `height_tracking_m` in the plane: a Crazyflie's stock controller overshoots a take-off by 8 cm [m]."""


def _length(default: float, description: str) -> Any:
    return Field(default=default, gt=0, le=1000, allow_inf_nan=False, description=f"{description} [m]")


def _seconds(default: float, description: str) -> Any:
    return seconds(default, description, most=3600)


class WorldConfig(ConfigSection):
    """Place of the mission in the world frame of the localisation system, z up."""

    scale_m: float = _length(0.1, "Length of one mission unit")
    stretch: float = Field(
        default=1.0, ge=1, le=100, allow_inf_nan=False, description="Missions in space: extra scale of z over x and y"
    )
    yaw_deg: float = Field(
        default=0.0, ge=-360, le=360, description="The mission's x axis in the world, counterclockwise [degrees]"
    )
    origin_m: tuple[Metres, Metres] = Field(
        default=(0.0, 0.0), description="Middle of the arena in the world, x and y [m]"
    )
    altitude_m: float = _length(1.0, "Height of a mission in the plane, or of the middle of the arena: z")
    floor_m: Metres = Field(default=0.0, description="Height of the floor: z [m]")
    geofence: tuple[tuple[Metres, Metres, Metres], tuple[Metres, Metres, Metres]] = Field(
        default=((-6.0, -6.0, -0.5), (6.0, 6.0, 2.5)),
        description="Lower and upper corner of the box that no drone may leave, in the world [m]",
    )


class DroneConfig(ConfigSection):
    """One robot of the fleet."""

    name: str = Field(min_length=1, max_length=64, description="Name in reports")
    uri: str | None = Field(default=None, description="Address: radio://..., udp://... or serial://...")
    system_id: int | None = Field(default=None, ge=1, le=254, description="MAVLink: system id of the autopilot [1]")
    start: tuple[Metres, ...] | None = Field(
        default=None, min_length=2, max_length=3, description="Position before take-off: x, y and z [m]"
    )
    parameters: dict[str, Annotated[float, Field(allow_inf_nan=False)]] = Field(
        default_factory=dict, description="Firmware parameters to set on connecting, by group.name"
    )
    ready_battery_v: float | None = Field(
        default=None, ge=0, le=100, description="Preflight: lowest battery voltage of this drone [V]"
    )
    low_battery_v: float | None = Field(
        default=None, ge=0, le=100, description="In flight: land below this battery voltage of this drone [V]"
    )


class FleetConfig(ConfigSection):
    """The drones: robot 0 of the mission is the first, and so on."""

    robot: str = Field(
        default="simulated", description="Driver: simulated, crazyflie, mavlink, physics, or package.module:function"
    )
    drones: tuple[DroneConfig, ...] = Field(default=(), description="Drones, in the order of the mission's robots")
    crazyflies: str | None = Field(
        default=None, description="Read the drones from Crazyswarm2's crazyflies.yaml, instead of a list"
    )
    controller: Literal["pid", "mellinger", "indi", "brescianini", "lee"] | None = Field(
        default=None, description="Crazyflies: controller to set on connecting; none leaves the firmware's (PID)"
    )
    estimator: Literal["kalman", "ukf"] | None = Field(
        default=None, description="Crazyflies: estimator to set on connecting; none leaves the firmware's"
    )
    cache: str | None = Field(
        default=None, description="Folder for the drones' tables, which speed up later connections; none: your cache"
    )
    local_frames: Literal["start", "common"] = Field(
        default="start",
        description="MAVLink: the autopilots count positions from where each drone starts, or from the world's zero",
    )
    origin_lat_lon_alt: tuple[float, float, float] | None = Field(
        default=None,
        description="MAVLink with GPS: place of the world's zero on the Earth [degrees, degrees, m above sea level]",
    )
    take_off_group: int = Field(default=1, ge=1, le=1000, description="Number of drones that take off at once")
    connect_s: float = _seconds(60.0, "Longest wait for the connections before take-off")
    stop_watchdog: bool = Field(
        default=False,
        description="Crazyflies: cut the motors of a drone that no radio reached for a second. It falls, "
        "and has to be restarted after every flight",
    )
    deadman: bool = Field(default=True, description="Start a process that lands the drones if this one dies or hangs")
    deadman_s: float = _seconds(1.5, "Let the deadman take over after this silence of the flight process")

    @model_validator(mode="before")
    @classmethod
    def _check_empty(cls, given: Any) -> Any:
        # A list that a file leaves empty is an oversight; no list at all asks for drawn starts.
        if isinstance(given, dict) and given.get("drones") == [] and given.get("crazyflies") is None:  # pyright: ignore[reportUnknownMemberType]
            raise InputError("drones", "[]", "one for each of the mission's robots, or no list: then starts are drawn")
        return given  # pyright: ignore[reportUnknownVariableType]

    @property
    def watched(self) -> bool:
        """Whether to start a deadman.

        Drones simulated in the flight process end with it anyway; those with the stop watchdog have fallen before it
        could call them.
        """
        return self.deadman and not self.stop_watchdog and self.robot not in ("simulated", "physics")


class SafetyConfig(ConfigSection):
    """Distances to keep, conditions to monitor, and times to react."""

    min_separation_m: float = _length(0.2, "Smallest distance between two drones side by side, centre to centre")
    downwash_m: float = _length(0.6, "Smallest distance between two drones above each other")
    tracking_m: float = _length(0.05, "Largest distance between a drone and its set-point, as late as the team is")
    height_tracking_m: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        allow_inf_nan=False,
        description="The same for heights; none: 0.15 in the plane (or tracking_m, if larger), tracking_m in space [m]",
    )
    lag_s: float | None = Field(
        default=None,
        ge=0,
        le=60,
        allow_inf_nan=False,
        description="Longest delay of the team behind its set-points; none: by the drones' controllers [s]",
    )
    max_speed_m_s: float = Field(
        default=1.0, gt=0, le=20, allow_inf_nan=False, description="Highest speed of a set-point [m/s]"
    )
    round_s: float = _seconds(3.0, "Duration of each motion, from rest to rest")
    settle_s: float = _seconds(1.0, "Longest wait after a motion for the drones to arrive")
    take_off_s: float = _seconds(2.5, "Duration of a take-off")
    land_s: float = _seconds(3.0, "Duration of a landing")
    start_tolerance_m: float = _length(0.15, "Preflight: largest distance from the given start position")
    ready_battery_v: float = Field(default=3.8, ge=0, le=100, description="Preflight: lowest battery voltage [V]")
    ready_link: float = Field(default=0.7, ge=0, le=1, description="Preflight: smallest share of acknowledged packets")
    low_battery_v: float = Field(
        default=3.2, ge=0, le=100, description="In flight: land below this battery voltage [V]"
    )
    low_battery_s: float = _seconds(1.0, "Time for which the battery must stay low before that")
    stall_s: float = _seconds(0.5, "Largest age of a position estimate")
    jump_m: float = _length(0.3, "Largest jump of a position estimate, beyond what a drone can fly")
    off_course_s: float = _seconds(0.5, "Longest time that a drone may be farther than tracking_m from its set-point")
    cut_outside_m: float = _length(1.0, "Cut the motors of a drone that is this far outside the geofence")
    silent_rounds: int = Field(
        default=3,
        ge=1,
        le=1000,
        description="With fallback hold: land after this many rounds without an answer",
    )
    think_s: float = _seconds(20.0, "Longest wait for a model while the drones hover")
    max_flight_s: float = _seconds(240.0, "Land after this time in the air")
    at_end: Literal["land", "return"] = Field(
        default="land", description="After the mission: land on the spot, or return to above the starts and land there"
    )
    reach_s: float = _seconds(15.0, "Keep calling a drone that is out of reach, to land it, for this time")


def mission_frame(world: WorldConfig, low: Point, high: Point) -> MissionFrame:
    """A mission in the world, by the corners of its arena [units]."""
    return MissionFrame(
        anchor=tuple((a + b) / 2 for a, b in zip(low, high, strict=True)),
        scale_m=world.scale_m,
        stretch=world.stretch if len(low) == 3 else 1.0,
        yaw=math.radians(world.yaw_deg),
        origin=world.origin_m,
        altitude_m=world.altitude_m,
    )


class FlightConfig(RunConfig):
    """Everything that defines a flight.

    Raises:
        InputError: the mission cannot be flown safely, or not within the given limits.
    """

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
        if not self.protocol.shield:
            raise InputError("shield", self.protocol.shield, says="has to be on in a flight, whatever the protocol")
        self._check_positions()
        check_drones(self)
        self._check_distances()
        self._check_speed()
        self._check_fence()
        check_starts(self)
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
        if self.mission.dim == 3 and self.safe_distance_m * world.stretch < above - ROUNDING_M:
            raise InputError(
                "stretch",
                world.stretch,
                f"at least {above / self.safe_distance_m:.3g}, so that no drone flies in another's downwash: "
                f"downwash_m + 2 height_tracking_m = {above:g} m above each other",
            )

    def _check_speed(self) -> None:
        steepest = self.world.stretch if self.mission.dim == 3 else 1.0
        longest = self.mission.max_step * self.world.scale_m * steepest
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
        steepest = self.world.stretch if self.mission.dim == 3 else 1.0
        return PEAK_SPEED * self.mission.max_step * self.world.scale_m * steepest / self.safety.round_s

    @property
    def frame(self) -> MissionFrame:
        """The mission in the world."""
        return mission_frame(self.world, *self.mission.arena)

    @property
    def driver_limits(self) -> MotionLimits:
        """Limits that the drivers enforce by themselves, as a last gate behind the checks of the flight."""
        low, high = self.world.geofence
        return MotionLimits(low=low, high=high, max_speed_m_s=1.001 * self.safety.max_speed_m_s)
