"""The keyword parameters of `run` and `run_async`: every field of the configuration, for type checkers and editors."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict, cast

from llm_flock.llm.frame import FrameName
from llm_flock.llm.own import ModelChoice
from llm_flock.llm.sharing import CallLane
from llm_flock.obstacles import Obstacle
from llm_flock.protocol.agreement.assignment import AssignmentRule
from llm_flock.protocol.agreement.consensus import ConsensusRule
from llm_flock.protocol.breaker import Fallback
from llm_flock.record.writer import RecordSink
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.schedule import Change
from llm_flock.runtime.trial import Steer, TrialProgress

Row: TypeAlias = Sequence[float]
"""Coordinates of a point [units]."""

FILES = ("out", "record_llm", "prompts")
"""Fields that name files or folders: paths are taken too."""


class Parameters(TypedDict, total=False):
    """What `run` takes besides a mission. The default of a field stands in the configuration; None means not given."""

    # The run as a whole, and its surroundings.
    config: RunConfig | None
    on_round: Callable[[TrialProgress], None] | None
    progress: bool
    trace: bool
    sink: RecordSink | None
    lane: CallLane | None
    steer: Steer | None
    # The mission.
    shape: str
    n_robots: int
    places: int | None
    center: Row
    velocity: Row | None
    since: int
    spacing: float
    safe_distance: float
    max_step: float
    comm_range: float
    sense_range: float | None
    arena: Sequence[Row]
    points: Sequence[Row] | None
    obstacles: Sequence[Obstacle | Mapping[str, Any]]
    # The protocol.
    protocol: Literal["flock", "paper", "baseline"]
    consensus: str | ConsensusRule | None
    assignment: str | AssignmentRule | None
    shield: bool | None
    verify: bool | None
    fallback: Fallback | None
    comm_rounds: int | None
    gaps: Literal["report", "replan"]
    time_out: int
    # Language models.
    model: ModelChoice
    base_url: str | None
    answers: Literal["text", "json"]
    history: str
    decide: Literal["every-round", "on-event"]
    observe: Literal["in-range", "all"]
    max_retries: int
    prompts: str | Path | None
    wish: str | None
    frame: FrameName | None
    temperature: str | float | None
    reasoning_effort: str | None
    model_seed: str | int | None
    record_llm: str | Path | None
    # Limits and budget.
    max_concurrent: int
    timeout_s: float
    max_tries: int
    max_answer_tokens: int | None
    max_calls: int | None
    max_tokens: int | None
    max_cost: float | None
    # Links.
    loss: float
    delay: int
    duplicate: float
    reorder: float
    # The trial.
    rounds: int | None
    stop_when_formed: bool
    seed: int
    start: Literal["separated", "uniform", "connected"]
    start_positions: Sequence[Row] | None
    start_area: Sequence[Row] | None
    kill: str | None
    join: str | None
    kill_random: int
    join_random: int
    changes: Sequence[Change | Mapping[str, Any]]
    noise: float
    out: str | Path | None


def plain(field: str, value: Any) -> Any:
    """A value as the configuration takes it: paths as text, NumPy's arrays and numbers as Python's."""
    if field in FILES and isinstance(value, os.PathLike):
        return os.fspath(cast("os.PathLike[str]", value))
    to_list = getattr(value, "tolist", None)
    return value if to_list is None else to_list()
