"""A swarm's configuration: that of a run, and how its processes find each other and keep time."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from llm_flock.errors import InputError
from llm_flock.llm.models import parse_model, parse_models
from llm_flock.runtime.config import RunConfig, Section


def _seconds(default: float, description: str) -> float:
    return Field(default=default, gt=0, allow_inf_nan=False, description=f"{description} [s]")


class NetworkConfig(Section):
    """Endpoints and periods. All robots of a swarm need the same."""

    swarm: str = Field(
        default="flock", pattern=r"^[A-Za-z0-9_-]{1,64}$", description="Name of the swarm; others are not heard"
    )
    listen: str = Field(
        default="tcp/127.0.0.1:0", description="Own endpoints, with commas between them; port 0 takes a free one"
    )
    connect: str = Field(
        default="tcp/127.0.0.1:7447",
        description="Endpoints of peers to connect to, with commas between them; one that is there is enough",
    )
    keys: str | None = Field(
        default=None, description="Folder that `llm-flock keys` has made: everything is signed, and goes over TLS"
    )
    lease_s: float = _seconds(2.0, "Silence after which a link is given up")
    gossip_s: float = _seconds(0.1, "Time between two message exchanges")
    control_s: float = _seconds(0.1, "Control period: so often the way is projected on what is safe")
    step_s: float = _seconds(0.5, "Time that a move of max_step takes: the bodies' speed")
    frame_s: float = _seconds(0.04, "Time between two readings of the sensors")
    beacon_s: float = _seconds(0.1, "Time between two beacons")
    lag_s: float = _seconds(0.05, "Longest way of a command to the body: later ones are not obeyed")
    clock_error_s: float = Field(
        default=0.002, ge=0, allow_inf_nan=False, description="Largest difference of two machines' clocks [s]"
    )
    gather_s: float = Field(
        default=5.0, ge=0, allow_inf_nan=False, description="How long a robot waits for the others before it begins [s]"
    )
    answer_s: float = _seconds(300.0, "Longest wait for a planner, retries included")
    max_s: float = _seconds(120.0, "The swarm is ended after so long")
    partition: str | None = Field(
        default=None,
        pattern=r"^\d+(\.\d+)?-\d+(\.\d+)?$",
        description="For tests: FROM-UNTIL, seconds in which the two halves of the ids do not hear each other",
    )


class SwarmConfig(RunConfig):
    """Everything that defines a swarm."""

    network: NetworkConfig = Field(default_factory=NetworkConfig)

    @model_validator(mode="after")
    def _check_swarm(self) -> Self:
        trial = self.trial
        for field in ("kill", "join", "kill_random", "join_random", "changes", "noise"):
            if getattr(trial, field):
                raise InputError(field, getattr(trial, field), "nothing in a swarm of processes")
        if self.mission.velocity is not None:
            raise InputError(
                "velocity", self.mission.velocity, "nothing in a swarm of processes: rounds are not in step"
            )
        return self

    @property
    def simulated(self) -> bool:
        """Whether any language model is a simulated stand-in."""
        return "simulated:" in self.model.model

    @property
    def speed(self) -> float:
        """Largest speed of a body [units/s]."""
        return self.mission.max_step / self.network.step_s


def endpoints(text: str) -> list[str]:
    """Endpoints with commas between them."""
    return [part.strip() for part in text.split(",") if part.strip()]


def check_models(config: SwarmConfig) -> None:
    """Refuse models on board in a swarm on one machine: each process would have an engine, all on the same cores.

    Raises:
        InputError: for field `model`.
    """
    n = config.mission.n_robots
    on_board = [name for name in parse_models(config.model.model, n) if parse_model(name).kind == "local"]
    if len(on_board) > 1:
        allowed = "one robot's at most in a swarm on one machine; `run` has one engine for all robots, and `robot` "
        raise InputError("model", on_board[0], allowed + "starts one robot on a computer of its own")
