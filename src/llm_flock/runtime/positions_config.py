"""Where a flight's drones get their positions: on board, or from outside."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from llm_flock.errors import InputError
from llm_flock.runtime.config import ConfigSection, seconds


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
    pose_rate_hz: float = Field(
        default=30.0, ge=5, le=200, allow_inf_nan=False, description="Most poses a second to one drone"
    )
    pose_late_s: float = seconds(0.1, "Largest delay of a pose over the fastest one; a later one is not sent", most=10)
    pose_lost_s: float = seconds(0.5, "In flight: land after this time without an accepted pose of a drone", most=10)
    pose_frozen_s: float = Field(
        default=0.5,
        ge=0,
        le=60,
        allow_inf_nan=False,
        description="A pose that repeats the very same numbers for longer than this is not sent; 0: any may [s]",
    )
    pose_jump_m: float = Field(
        default=0.1,
        gt=0,
        le=10,
        allow_inf_nan=False,
        description="Largest jump of a pose, beyond what a drone can fly; a farther one is not sent [m]",
    )

    @property
    def outside(self) -> bool:
        """Whether poses come from outside."""
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
