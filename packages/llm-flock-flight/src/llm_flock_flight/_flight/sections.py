"""The sections of a flight file that only flights have: the drones, the safety limits, and positions from outside."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from llm_flock.errors import InputError
from llm_flock.runtime import ConfigSection, Metres, metres, number, seconds

_seconds = partial(seconds, most=3600)


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

    @property
    def watched(self) -> bool:
        """Whether to start a deadman: simulated drones end with the process, and the stop watchdog would be faster."""
        return self.deadman and not self.stop_watchdog and self.robot not in ("simulated", "physics")

    @property
    def shares_links(self) -> bool:
        """Whether two processes can call the drones: by network, unless they call us, at a port that one can open."""
        scheme = {"crazyflie": "udp://", "mavlink": "udpout://"}.get(self.robot)
        return scheme is not None and all((drone.uri or "").startswith(scheme) for drone in self.drones)


class SafetyConfig(ConfigSection):
    """Distances to keep, conditions to monitor, and times to react."""

    min_separation_m: float = metres(0.2, "Smallest distance between two drones side by side, centre to centre")
    downwash_m: float = metres(0.6, "Smallest distance between two drones above each other")
    tracking_m: float = metres(0.05, "Largest distance between a drone and its set-point, as late as the team is")
    height_tracking_m: float | None = metres(
        None, "The same for heights; none: 0.15 in the plane (or tracking_m, if larger), tracking_m in space"
    )
    lag_s: float | None = number(
        None, "Longest delay of the team behind its set-points; none: by the drones' controllers [s]", most=60
    )
    max_speed_m_s: float = Field(
        default=1.0, gt=0, le=20, allow_inf_nan=False, description="Highest speed of a set-point [m/s]"
    )
    round_s: float = _seconds(3.0, "Duration of each motion, from rest to rest")
    settle_s: float = _seconds(1.0, "Longest wait after a motion for the drones to arrive")
    take_off_s: float = _seconds(2.5, "Duration of a take-off")
    land_s: float = _seconds(3.0, "Duration of a landing")
    start_tolerance_m: float = metres(0.15, "Preflight: largest distance from the given start position")
    ready_battery_v: float = Field(default=3.8, ge=0, le=100, description="Preflight: lowest battery voltage [V]")
    ready_link: float = Field(default=0.7, ge=0, le=1, description="Preflight: smallest share of acknowledged packets")
    low_battery_v: float = Field(
        default=3.2, ge=0, le=100, description="In flight: land below this battery voltage [V]"
    )
    low_battery_s: float = _seconds(1.0, "Time for which the battery must stay low before that")
    stall_s: float = _seconds(0.5, "Largest age of a position estimate")
    jump_m: float = metres(0.3, "Largest jump of a position estimate, beyond what a drone can fly")
    off_course_s: float = _seconds(0.5, "Longest time that a drone may be farther than tracking_m from its set-point")
    cut_outside_m: float = metres(1.0, "Cut the motors of a drone that is this far outside the geofence")
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

    @property
    def downwash(self) -> float:
        """How many times the smallest distance side by side applies to drones above each other."""
        return self.downwash_m / self.min_separation_m


class PositionsConfig(ConfigSection):
    """Positions from outside, for drones that do not find out by themselves where they are."""

    pose_source: Literal["none", "udp", "mocap", "ros2"] = Field(
        default="none",
        description="Positions from outside: none (the drones know theirs), udp (datagrams), mocap, or ros2",
    )
    pose_host: str = Field(
        default="127.0.0.1", min_length=1, max_length=256, description="udp: address of this machine to listen at"
    )
    pose_port: int = Field(default=19700, ge=1, le=65535, description="udp: port to listen at")
    mocap_system: Literal["vicon", "optitrack", "qualisys", "vrpn", "mock"] | None = Field(
        default=None, description="mocap: the system: vicon, optitrack, qualisys, vrpn, or mock, which sees nothing"
    )
    mocap_host: str | None = Field(
        default=None, min_length=1, max_length=256, description="mocap: host name or address of its server"
    )
    pose_attitude: bool = Field(
        default=False, description="Send orientations too: only if bodies in the motion capture point as the drones do"
    )
    pose_rate_hz: float = number(30.0, "Most poses a second to one drone", least=5, most=200)
    pose_late_s: float = seconds(0.1, "Largest delay of a pose over the fastest one; a later one is not sent", most=10)
    pose_lost_s: float = seconds(0.5, "In flight: land after this time without an accepted pose of a drone", most=10)
    pose_frozen_s: float = number(
        0.5, "A pose that repeats the very same numbers for longer than this is not sent; 0: any may [s]", most=60
    )
    pose_jump_m: float = metres(
        0.1, "Largest jump of a pose, beyond what a drone can fly; a farther one is not sent", most=10
    )

    @property
    def outside(self) -> bool:
        return self.pose_source != "none"

    @model_validator(mode="after")
    def _check_positions(self) -> Self:
        for field in ("mocap_system", "mocap_host"):
            given = getattr(self, field)
            if self.pose_source == "mocap" and given is None:
                raise InputError(field, given, says=f"is needed with pose_source = {self.pose_source!r}")
            if self.pose_source != "mocap" and given is not None:
                raise InputError(field, given, says="can be used with pose_source = 'mocap' only")
        if self.pose_lost_s < 3.0 / self.pose_rate_hz:
            raise InputError(
                "pose_lost_s",
                self.pose_lost_s,
                f"at least {3.0 / self.pose_rate_hz:.3g} s, the time of three poses at {self.pose_rate_hz:g} a second",
            )
        return self
