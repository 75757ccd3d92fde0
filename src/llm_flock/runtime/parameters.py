"""The parameters of `run` and `run_async`: every field of the configuration, with its type and default."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeAlias, TypeVar, cast

from llm_flock.llm.frame import FrameName
from llm_flock.llm.own import ModelChoice
from llm_flock.llm.sharing import CallLane
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.protocol.agreement.assignment import AssignmentRule
from llm_flock.protocol.agreement.consensus import ConsensusRule
from llm_flock.protocol.breaker import Fallback
from llm_flock.record.writer import RecordSink
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.schedule import Change
from llm_flock.runtime.trial import Steer, TrialProgress

P = ParamSpec("P")
R = TypeVar("R")

Row: TypeAlias = Sequence[float]
"""Coordinates of a point [units]."""

FILES = ("out", "record_llm", "prompts")
"""Fields that name files or folders: paths are taken too."""


def parameters(
    mission: Mission | None = None,
    *,
    # The run as a whole, and its surroundings.
    config: RunConfig | None = None,
    on_round: Callable[[TrialProgress], None] | None = None,
    progress: bool = True,
    trace: bool = True,
    sink: RecordSink | None = None,
    lane: CallLane | None = None,
    steer: Steer | None = None,
    # The mission.
    shape: str = "circle",
    n_robots: int = 10,
    places: int | None = None,
    center: Row = (50.0, 50.0),
    velocity: Row | None = None,
    since: int = 0,
    spacing: float = 10.0,
    safe_distance: float = 3.0,
    max_step: float = 6.0,
    comm_range: float = 15.0,
    sense_range: float | None = None,
    arena: Sequence[Row] = ((0.0, 0.0), (100.0, 100.0)),
    points: Sequence[Row] | None = None,
    obstacles: Sequence[Obstacle | Mapping[str, Any]] = (),
    # The protocol.
    protocol: Literal["flock", "paper", "baseline"] = "flock",
    consensus: str | ConsensusRule | None = None,
    assignment: str | AssignmentRule | None = None,
    shield: bool | None = None,
    verify: bool | None = None,
    fallback: Fallback | None = None,
    comm_rounds: int | None = None,
    gaps: Literal["report", "replan"] = "report",
    time_out: int = 10,
    # Language models.
    model: ModelChoice = "simulated:ideal",
    base_url: str | None = None,
    answers: Literal["text", "json"] = "text",
    history: str = "none",
    decide: Literal["every-round", "on-event"] = "every-round",
    observe: Literal["in-range", "all"] = "in-range",
    max_retries: int = 2,
    prompts: str | Path | None = None,
    wish: str | None = None,
    frame: FrameName | None = None,
    temperature: str | float | None = None,
    reasoning_effort: str | None = None,
    model_seed: str | int | None = None,
    record_llm: str | Path | None = None,
    # Limits and budget.
    max_concurrent: int = 1000,
    timeout_s: float = 120.0,
    max_tries: int = 8,
    max_answer_tokens: int | None = None,
    max_calls: int | None = None,
    max_tokens: int | None = None,
    max_cost: float | None = None,
    # Links.
    loss: float = 0.0,
    delay: int = 0,
    duplicate: float = 0.0,
    reorder: float = 0.0,
    # The trial.
    rounds: int | None = None,
    stop_when_formed: bool = True,
    seed: int = 0,
    start: Literal["separated", "uniform", "connected"] = "separated",
    start_positions: Sequence[Row] | None = None,
    start_area: Sequence[Row] | None = None,
    kill: str | None = None,
    join: str | None = None,
    kill_random: int = 0,
    join_random: int = 0,
    changes: Sequence[Change | Mapping[str, Any]] = (),
    noise: float = 0.0,
    out: str | Path | None = None,
) -> None:
    """Only its signature is of use: see `takes`."""


def takes(template: Callable[P, None]) -> Callable[[Callable[..., R]], Callable[P, R]]:
    """Give a function that takes `**given` the signature of a template, for type checkers, editors and `help`.

    Unlike with parameters of its own, the function knows which of them were given.
    """

    def decorate(function: Callable[..., R]) -> Callable[P, R]:
        own, like = (inspect.signature(each, eval_str=True) for each in (function, template))
        vars(function)["__signature__"] = like.replace(return_annotation=own.return_annotation)
        # Whoever reads defaults from the source, as Sphinx does, finds them where they are written.
        vars(function)["__wrapped__"] = template
        return cast("Callable[P, R]", function)

    return decorate


def plain(field: str, value: Any) -> Any:
    """A value as the configuration takes it: paths as text, NumPy's arrays and numbers as Python's."""
    if field in FILES and isinstance(value, os.PathLike):
        return os.fspath(cast("os.PathLike[str]", value))
    to_list = getattr(value, "tolist", None)
    return value if to_list is None else to_list()
