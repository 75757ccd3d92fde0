"""The result of a run, and its summary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from llm_flock.errors import InputError
from llm_flock.events import Origin
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.record._schema import Entry, RunInfo, SummaryMessage
from llm_flock.runtime._config import RunConfig

if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingTypeStubs]
    import polars

    from llm_flock.record._reader import RunRecord, TableName


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionOutcome:
    """The outcome of one mission of a run."""

    round: int  # at whose start it was given to a robot, 0 for the first one
    shape: str
    places: int  # of its formation
    formed: int | None  # first round in which the team had formed; None if it never had
    lower_bound_rounds: int | None  # as in `Summary`, from where the robots were when the mission was given


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightFigures:
    """The figures of a flight. Distances are those of estimates, while both drones were in the air."""

    ended: str  # why it ended: mission, return by the operator's order, or the kind of failure
    reason: str | None  # the failure as text
    ends: dict[str, str]  # how each drone ended, by name: landed, never took off, cut, out of reach, ...
    safe: bool  # whether each drone landed, never took off, or confirmed that its motors were cut
    air_s: float  # from the first take-off until the last drone was down
    min_separation_m: float | None  # smallest of two drones, heights scaled by the vertical rule; None for one alone
    tracking_rms_m: float | None  # root mean square distance of drones from their set-points, the team's delay ago
    tracking_max_m: float | None  # the largest of these distances
    fan_out_ms: float | None  # longest time to send all drones their targets; None if none was sent
    poses_refused: dict[str, int] | None = None  # poses from outside that were not sent, by drone and reason
    lag_s: float = 0.0  # longest delay of the drones behind their set-points in a round, the same for all


def by_origin(counts: Mapping[str, int]) -> dict[str, int]:
    """Waypoints flown by every origin, zeros included."""
    return {origin.value: counts.get(origin.value, 0) for origin in Origin if origin is not Origin.START}


def waypoint_shares(counts: Mapping[str, int]) -> dict[str, float]:
    """Waypoints by origin as shares of all; zeros if none was flown."""
    total = max(1, sum(counts.values()))
    return {origin: count / total for origin, count in counts.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """The figures of one trial; field names are the keys of `--json`.

    With several missions, `formed`, `rounds_to_formed` and `lower_bound_rounds` are about the last one, and count from
    when it was given. Robots that are not awake count for separation only.
    """

    shape: str  #: The mission's shape.
    n_robots: int  #: Team size N.
    seed: int  #: Seed of the run.
    consensus: str  #: Rule that chose the plan.
    assignment: str  #: Rule that chose the slots.
    shield: bool  #: Whether the safety shield was on.
    models: tuple[str, ...]  #: The language models as configured, each once, with those given in flight.
    simulated: bool  #: Whether any of them was a simulated stand-in.
    #: Why the run ended: formed, rounds, budget, no_plan (no robot has a plan, and all models were refused until they
    #: are no longer asked), no_answers (the same, or three rounds on end without circuit breakers, and every model call
    #: failed), interrupted or failed.
    stopped: str
    reason: str | None  #: The commonest or last failure as text, if the run ended by no_plan, no_answers or failed.
    rounds: int  #: Motion rounds flown.
    #: One plan, distinct goals, every robot within 0.05 spacing of its goal, residual to the ideal shape at most 0.1
    #: spacing, held for 3 rounds. Unless `rounds` was given, the run ends 3 * lower_bound_rounds + 20 rounds after the
    #: last mission was given, or a robot died or joined.
    formed: bool
    #: Formed, with the plan of a model, without any waypoint of geometry, and with no circuit breaker ever open.
    formed_by_models: bool
    rounds_to_formed: int | None  #: The first of those 3 rounds; None if it never came.
    #: Bottleneck assignment distance from the start to the agreed plan, in steps of max_step, less the 0.05 spacing at
    #: which a robot counts as at its goal, rounded up; None without one plan.
    lower_bound_rounds: int | None
    #: Mean distance to the ideal shape at the end [units] (paper, section 4.2); None without ideal.
    procrustes_mean: float | None
    procrustes_mean_squared: float | None  #: Mean squared distance [units^2] (paper, appendix C).
    #: Smallest distance of any two robots over the whole run, along the segments too [units]: of true positions in
    #: simulation, of estimates in flight.
    min_separation: float | None
    #: Smallest distance of another robot that any of them has sensed, with noise, drift and delay [units]; None if
    #: positions are exact.
    nearest_read: float | None
    start_violations: int  #: Pairs that were nearer than the safe distance at the start (min_separation has them too).
    #: First round at whose end each of these had come apart; 0 without any, None if it never came.
    rounds_to_separate: int | None
    #: As min_separation, each of these pairs counted from when it had come apart [units].
    min_separation_after_start: float | None
    #: Smallest distance of a robot's centre to an obstacle, moving ones too, along the segments too, negative inside
    #: [units]; None without obstacles.
    min_clearance: float | None
    #: Rounds of robots in which a moving obstacle came nearer to their centre than half the safe distance.
    obstacle_violations: int
    plans_in_use: int  #: Different plans at the end.
    distinct_goals: int  #: Different goals at the end.
    robots_without_plan: int  #: Robots that never got a plan.
    awake: int  #: Robots at the end that have begun and have not died.
    model_calls: int  #: Answered or failed calls, retries of rejected answers included.
    calls_rejected: int  #: Answers that could not be used.
    calls_failed: int  #: Calls that got no answer.
    faults: dict[str, int]  #: Transport faults met on the way, by kind, retried ones included.
    tokens: int  #: Tokens in and out.
    tokens_input: int  #: Tokens in.
    tokens_output: int  #: Tokens out.
    tokens_cached: int  #: The part of tokens_input that the provider had in its cache.
    cost_usd: float | None  #: Cost where the price of every call is known, else None [US dollars].
    latency_mean_s: float | None  #: Mean duration of a call, waits included [s]; None without calls.
    waypoints: dict[str, int]  #: Waypoints flown, by origin: model, clipped, shield, yield, geometry, hold.
    waypoint_shares: dict[str, float]  #: The same as shares of all.
    steps_over_limit: int  #: Steps that were longer than max_step, which bodies flew up to there.
    #: Distance of the team from the mission's centre [units], to which the error is blind: the mean of its robots'
    #: offsets from their places, and of these places' plans from the centre. None without places.
    center_distance: float | None
    plan_robot: int | None  #: Robot that proposed the plan in force at the end; None without one plan.
    plan_by: str | None  #: Who made that plan: a model, by its name, or `geometry`.
    #: Robots whose circuit breaker was open at any time, so that geometry answered for their model.
    breakers_opened: tuple[int, ...]
    messages_sent: int  #: Broadcasts.
    bytes_per_robot_round: float  #: Bytes broadcast per robot and round.
    messages_rejected: dict[str, int]  #: Messages rejected on receipt, by reason.
    wall_s: float  #: Duration of the run [s].
    record: str | None  #: Path of the record, None with the record off.
    killed: tuple[str, ...] = ()  #: Robots that died, and in which round: `3@12`.
    joined: tuple[str, ...] = ()  #: Robots that joined late or again, in the same form.
    missions: tuple[MissionOutcome, ...] = ()  #: Every mission of the run, the first one first.
    gaps: int | None = None  #: Slots of the plan that no robot owns at the end; None without one plan.
    spares: int | None = None  #: Robots awake at the end without a slot; None without one plan.
    formed_half_tolerance: bool = False  #: As `formed`, with both tolerances halved; the run ends as always.
    formed_twice_tolerance: bool = False  #: As `formed`, with both tolerances doubled.
    flight: FlightFigures | None = None  #: The figures of a flight; None in simulation.
    #: Whether the model that made that plan was taught it, and may only have recalled it; None where that is not known.
    plan_taught: bool | None = None
    answered_by: tuple[str, ...] = ()  #: The models that answered, by the names that their servers gave, sorted.

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class RunResult:
    """One finished trial.

    A notebook shows it as a picture and a table.
    """

    mission: Mission  #: The mission.
    config: RunConfig  #: Everything that defined the run.
    summary: Summary  #: Its figures.
    #: True positions, shape (rounds + 1, n, d) [units; world frame]; row 0 is the start.
    positions: NDArray[np.float64] = field(repr=False)
    #: Mean Procrustes error after each round, shape (rounds + 1,) [units]; NaN without an ideal shape, and in teams
    #: over 300 while not all were at their goals.
    errors: NDArray[np.float64] = field(repr=False)
    plans: tuple[Plan | None, ...] = field(repr=False)  #: Each robot's plan at the end.
    slots: tuple[int | None, ...] = field(repr=False)  #: Each robot's slot in its plan.
    #: Missions, plans, states and figures of every round; None if the run did not keep them.
    trace: tuple[Entry, ...] | None = field(default=None, repr=False)
    #: Sentences on parts of the run that the configuration alone cannot repeat.
    unrepeatable: tuple[str, ...] = field(default=(), repr=False)

    @property
    def formed(self) -> bool:
        """Whether the formation was built, as `Summary.formed` defines it."""
        return self.summary.formed

    def record(self) -> RunRecord:
        """The run as a record in memory, for own figures; it has no conversations, events and versions.

        Raises:
            InputError: the run has kept no trace.
        """
        if self.trace is None:
            raise InputError("trace", False, "true, for a result that draws itself and gives tables")
        return trace_record(self.config, self.trace, self.summary, self.unrepeatable)

    def animate(self, *, fps: int = 12) -> Any:
        """The run as an animation that a notebook shows, and `save` writes; `fps` frames a second, four a round."""
        return self.record().animate(fps=fps)

    def to_polars(self, table: TableName = "rounds") -> polars.DataFrame:
        """The run as a table: `rounds` has a row for each round, `robots` one for each robot and round.

        Raises:
            InputError: there is no such table, or the run has kept no trace.
        """
        return self.record().to_polars(table)

    def to_pandas(self, table: TableName = "rounds") -> pandas.DataFrame:
        """As `to_polars`, for pandas, which `pip install 'llm-flock[notebook]'` installs."""
        return self.record().to_pandas(table)

    def __repr__(self) -> str:
        summary = self.summary
        simulated = ", simulated language models" if summary.simulated else ""
        end = f"formed in round {summary.missions[-1].formed}" if summary.formed else f"not formed: {summary.stopped}"
        return f"RunResult({summary.shape}, {summary.n_robots} robots, seed {summary.seed}, {end}{simulated})"

    def _repr_html_(self) -> str | None:
        """The picture and the table that a notebook shows; None without a trace."""
        return None if self.trace is None else self.record().html()


def trace_record(
    config: RunConfig, trace: Iterable[Entry], summary: Summary | None = None, unrepeatable: Sequence[str] = ()
) -> RunRecord:
    """A record in memory of a run's trace. Without a summary, the run is still under way."""
    from llm_flock.record._reader import gather_record

    about = RunInfo(
        config=config.model_dump(mode="json", exclude={"trial": {"out"}, "model": {"record_llm"}}),
        versions={},
        seed=config.trial.seed,
        simulated=summary is not None and summary.simulated,
        unrepeatable=list(unrepeatable) or None,
        created_at="",
        environment={},
    )
    end = () if summary is None else (SummaryMessage(result=summary.to_dict()),)
    path = Path("" if summary is None else summary.record or "")
    return gather_record(path, (about, *trace, *end))
