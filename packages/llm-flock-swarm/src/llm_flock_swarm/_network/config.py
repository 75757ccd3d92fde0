"""A swarm's configuration: that of a run, and how its processes connect and keep time."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from llm_flock.errors import InputError
from llm_flock.llm import parse_model, parse_models, says_simulated
from llm_flock.mission import Mission
from llm_flock.runtime import ConfigSection, Ros2Config, RunConfig, is_endpoint, number, seconds
from llm_flock_swarm._signed.certificates import LIARS

logger = logging.getLogger(__name__)


class NetworkConfig(ConfigSection):
    """Endpoints and periods: the same for all robots of a swarm."""

    swarm: str = Field(
        default="flock",
        pattern=r"^[A-Za-z0-9_-]{1,64}$",
        json_schema_extra={"expected": "1 to 64 letters, digits, - and _"},
        description="Name of the swarm; others are ignored",
    )
    listen: str = Field(
        default="tcp/127.0.0.1:0", description="Own endpoints, separated by commas; port 0 takes a free one"
    )
    connect: str = Field(
        default="tcp/127.0.0.1:7447",
        description="Endpoints of peers to connect to, separated by commas; one that answers is enough",
    )
    keys: str | None = Field(
        default=None, description="Folder made by `llm-flock keys`: sign every message, and connect over TLS"
    )
    liars: int = Field(
        default=LIARS,
        ge=1,
        description="Robots with keys that may lie together: one more must see that a place is free or blocked. More "
        "than one needs a team of more than three times as many",
    )
    lease_s: float = seconds(2.0, "Give up a link after this silence")
    gossip_s: float = seconds(0.1, "Time between two message exchanges")
    control_s: float = seconds(0.1, "Control period: time between two projections of the motion on what is safe")
    step_s: float = seconds(0.5, "Time that a body takes for max_step: sets the bodies' speed")
    frame_s: float = seconds(0.04, "Time between two readings of the sensors")
    beacon_s: float = seconds(0.1, "Time between two beacons")
    lag_s: float = seconds(0.05, "Longest delay of a command to the body; later ones are refused")
    clock_error_s: float = number(0.002, "Largest difference between two machines' clocks [s]")
    gather_s: float = number(5.0, "Longest wait for the other robots before the first round [s]")
    answer_s: float = seconds(300.0, "Longest wait for a model's answer, retries included")
    max_s: float = seconds(120.0, "End the swarm after this time")
    partition: str | None = Field(
        default=None,
        pattern=r"^\d+(\.\d+)?-\d+(\.\d+)?$",
        json_schema_extra={"expected": "FROM-UNTIL in seconds, such as 5-12.5"},
        description="For tests: FROM-UNTIL, the seconds in which the two halves of the ids do not hear each other",
    )

    @field_validator("listen", "connect")
    @classmethod
    def _check_endpoints(cls, text: str, info: ValidationInfo) -> str:
        for endpoint in endpoints(text):
            if not is_endpoint(endpoint):
                allowed = "endpoints such as tcp/127.0.0.1:7447, with commas between them"
                raise InputError(info.field_name or "connect", endpoint, allowed)
        return text


def check_still(mission: Mission) -> None:
    """InputError for a formation that moves."""
    if mission.velocity is not None:
        says = "cannot be used in a swarm of processes: rounds are not in step"
        raise InputError("velocity", mission.velocity, says=says)


def check_unsigned(config: SwarmConfig, mission: Mission) -> None:
    """InputError for stages and preferences in a team with keys: no robot may order, or claim a place by right."""
    for field in ("then", "prefer"):
        if config.network.keys is not None and getattr(mission, field):
            raise InputError(field, None, says="cannot be used in a team with keys, which follows signed orders only")


class SwarmConfig(RunConfig):
    """Everything that defines a swarm; `InputError` for a field of runs that swarms do not support."""

    network: NetworkConfig = Field(default_factory=NetworkConfig)
    ros2: Ros2Config = Field(default_factory=Ros2Config, title="ROS 2")

    @model_validator(mode="after")
    def _check_swarm(self) -> Self:
        trial = self.trial
        bodies = ("noise", "drift", "sensing_delay", "moving_obstacles")
        for field in ("kill", "join", "battery", "kill_random", "join_random", "changes", *bodies):
            if getattr(trial, field):
                raise InputError(field, getattr(trial, field), says="cannot be used in a swarm of processes")
        protocol = self.protocol
        if protocol.relay or protocol.collision_check != "none":
            says = "cannot be used in a swarm of processes: it needs all robots in one"
            raise InputError("protocol", protocol.protocol, says=says)
        if protocol.judge != "rule":
            raise InputError("judge", protocol.judge, "'rule' in a swarm of processes")
        check_still(self.mission)
        check_unsigned(self, self.mission)
        liars, n = self.network.liars, self.mission.n_robots
        if liars > LIARS and 3 * liars >= n:
            raise InputError("liars", liars, f"at most {max(LIARS, (n - 1) // 3)} of {n} robots: fewer than a third")
        return self

    @property
    def simulated(self) -> bool:
        """Whether any language model is a simulated stand-in; classes of the user's own are imported to tell."""
        return any(map(says_simulated, self._names))

    @property
    def unrepeatable(self) -> list[str]:
        """The properties of models that a record's configuration cannot repeat, in sentences."""
        return [f"{name} is code of the user's own, of which only the name is recorded." for name in self._own]

    @property
    def _own(self) -> list[str]:
        return [name for name in self._names if parse_model(name).kind == "own"]

    @property
    def _names(self) -> Iterable[str]:
        return dict.fromkeys(parse_models(self.model.model, self.mission.n_robots))

    @property
    def speed(self) -> float:
        """Largest speed of a body [units/s]."""
        return self.mission.max_step / self.network.step_s

    @property
    def passing_distance(self) -> float:
        """Distance at which bodies that do not move in step fly past each other unhindered, as a rule [units]."""
        network = self.network
        stale_s = network.frame_s + network.clock_error_s + network.control_s + network.lag_s
        return self.mission.safe_distance + self.speed * stale_s


def warn_of_spacing(config: SwarmConfig) -> None:
    """Log a warning if places are so near that bodies not in step may never reach them."""
    mission, needed = config.mission, config.passing_distance
    if config.protocol.shield and mission.n_places > 1 and mission.spacing < needed:
        logger.warning(
            "spacing = %g is too small for bodies that do not move in step: at this speed they pass each other at "
            "%.3g. The team may never form; a larger spacing would do, or slower bodies (a longer step_s).",
            mission.spacing,
            needed,
        )


def endpoints(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def check_models(config: SwarmConfig) -> None:
    """Refuse several models on board in a swarm on one machine: each process would load an engine on the same cores."""
    n = config.mission.n_robots
    on_board = [name for name in parse_models(config.model.model, n) if parse_model(name).kind == "plugin"]
    if len(on_board) > 1:
        allowed = "one robot's at most in a swarm on one machine; `run` has one engine for all robots, and `robot` "
        raise InputError("model", on_board[0], allowed + "starts one robot on a computer of its own")
