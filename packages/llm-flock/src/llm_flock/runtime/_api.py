"""The Python entry point: flies one mission and returns its result."""

from __future__ import annotations

import asyncio
import contextvars
import os
import sys
import threading
from collections.abc import Callable, Coroutine, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, TypeVar, Unpack, cast

from llm_flock.errors import FieldError, FlockError, InputError
from llm_flock.llm._port import FrameName
from llm_flock.mission import Mission, Preference, Stage
from llm_flock.obstacles import MovingObstacle, Obstacle
from llm_flock.printable import shape_title
from llm_flock.protocol._agreement.assignment import AssignmentRule
from llm_flock.protocol._agreement.consensus import ConsensusRule, Ties
from llm_flock.protocol._breaker import Fallback
from llm_flock.record._schema import NullWriter, RecordSink
from llm_flock.runtime._config import RECORD_NAME, RunConfig, warn_of_mission
from llm_flock.runtime._finish import finish_trial
from llm_flock.runtime._journal import Journal, run_info
from llm_flock.runtime._planners import TeamPlanners
from llm_flock.runtime._result import RunResult
from llm_flock.runtime._rules import LeftOut, assignment_rule, consensus_rule, own_rules
from llm_flock.runtime._schedule import Change, Stream, stream
from llm_flock.runtime._trial import Steer, Trial, TrialProgress, starts_of
from llm_flock.simulate import InstantBodies, Readings

if TYPE_CHECKING:
    from llm_flock.llm._limits import CallLane
    from llm_flock.llm._own import ModelChoice, OwnModel

T = TypeVar("T")


def wait_for(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its end, and return its result or raise its error. Ctrl-C cancels it and is raised at its end.

    If an event loop runs in this thread, it stands still meanwhile, and the coroutine gets a thread of its own.
    """
    around: asyncio.AbstractEventLoop | None = None
    with suppress(RuntimeError):
        around = asyncio.get_running_loop()
    if around is None:  # not in the handler: its error would begin every traceback of `main`
        return asyncio.run(main)
    started = threading.Event()
    running: list[tuple[asyncio.AbstractEventLoop, asyncio.Task[T]]] = []

    async def outer() -> T:
        task = asyncio.ensure_future(main)
        running.append((asyncio.get_running_loop(), task))
        started.set()
        return await task

    with ThreadPoolExecutor(1, "llm-flock run") as pool:
        done = pool.submit(contextvars.copy_context().run, asyncio.run, outer())
        try:
            return done.result()
        except BaseException:
            if not done.done():  # Ctrl-C: end the run as it would end in a script
                started.wait()
                loop, task = running[0]
                with suppress(RuntimeError):  # the loop has just been closed
                    loop.call_soon_threadsafe(task.cancel)
            raise


Row: TypeAlias = Sequence[float]  # coordinates of a point [units]


class Parameters(TypedDict, total=False):
    """The parameters of `run` besides a mission. Defaults are those of the configuration; None means not given."""

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
    downwash: float
    max_step: float
    comm_range: float
    sense_range: float | None
    arena: Sequence[Row]
    points: Sequence[Row] | None
    obstacles: Sequence[Obstacle | Mapping[str, Any]]
    turn: float | None
    hold: int
    prefer: Sequence[Preference | Mapping[str, Any]]
    then: Sequence[Stage | Mapping[str, Any]]
    # The protocol.
    protocol: Literal["flock", "paper", "paper-literal", "released", "baseline"]
    consensus: str | ConsensusRule | None
    assignment: str | AssignmentRule | None
    ties: Ties | None
    without: LeftOut | None
    relay: bool | None
    collision_check: str | None
    shield: bool | None
    verify: bool | None
    fallback: Fallback | None
    comm_rounds: int | None
    gaps: Literal["report", "replan"]
    judge: Literal["rule", "models"]
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
    burst: float | None
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
    battery: str | None
    kill_random: int
    join_random: int
    changes: Sequence[Change | Mapping[str, Any]]
    noise: float
    drift: float
    sensing_delay: float
    moving_obstacles: Sequence[MovingObstacle | Mapping[str, Any]]
    out: str | Path | None


def plain(field: str, value: Any) -> Any:
    """A value as the configuration takes it: paths as text, NumPy's arrays and numbers as Python's."""
    if field in ("out", "record_llm", "prompts") and isinstance(value, os.PathLike):
        return os.fspath(cast("os.PathLike[str]", value))
    to_list = getattr(value, "tolist", None)
    return value if to_list is None else to_list()


__all__ = ["RECORD_NAME", "open_outputs", "run", "run_async"]

_CHECKS: dict[str, Callable[[Any], Any]] = {"consensus": consensus_rule, "assignment": assignment_rule}
"""Fields that take objects, also beside a whole configuration."""


def run(mission: Mission | None = None, **given: Unpack[Parameters]) -> RunResult:
    """Fly one mission, and wait for its end; works in scripts, notebooks and threads.

    If an event loop is running already, as in a notebook, the run gets a thread of its own. There,
    `await run_async(...)` keeps the loop free.

    Args:
        mission: the team's task; the paper's circle of ten if left out.
        config: a whole configuration (`RunConfig`), instead of a mission and fields.
        on_round: called after each round, and now and then while robots wait, in the thread that flies.
        progress: shows a line of progress in notebooks, when the run takes longer than half a second.
        trace: keeps what the result needs to draw itself and to give frames; a few hundred bytes a robot and round.
        sink: takes every message of a record, whether a record is written or not.
        lane: access to what this run shares with others: a budget, rates of providers, connections.
        steer: awaited before each round, and free to change the schedule, the links and the planners.
        consensus: name of a rule, or a rule object.
        assignment: name of a rule, or a rule object.
        model: `provider:model` or another name for all robots or by id (`0-4=A,5-9=B`); an object with
            `async def ask(self, call)`, which all robots share; or a list with a name or an object for each robot.
        given: every other parameter is a field of the configuration (`docs/reference/configuration.md`). Those of the
            mission override the fields of `mission`. None means not given.

    Returns:
        Arrays and figures of the trial. With `out`, the record is written to `out/run.mcap` as it happens.

    Raises:
        InputError: a value is not allowed; nothing has been written then.
        ReplayDrift: a replayed conversation differs from the recorded one.
        KeyboardInterrupt: after the record was brought to a readable end.
    """
    return wait_for(run_async(mission, **given))


async def run_async(mission: Mission | None = None, **given: Unpack[Parameters]) -> RunResult:
    """Fly one mission: as `run`, within the running event loop.

    Raises:
        asyncio.CancelledError: after the record was brought to a readable end.
    """
    fields: dict[str, Any] = {field: value for field, value in given.items() if value is not None}
    config: RunConfig | None = fields.pop("config", None)
    on_round: Callable[[TrialProgress], None] | None = fields.pop("on_round", None)
    sink, lane, steer = (fields.pop(name, None) for name in ("sink", "lane", "steer"))
    progress, trace = (fields.pop(name, True) for name in ("progress", "trace"))
    if config is not None and (mission is not None or fields.keys() - _CHECKS.keys()):
        raise FieldError("config", says="give either config, or mission and options, not both")
    if config is not None and not isinstance(cast(object, config), RunConfig):
        raise InputError("config", config, "a RunConfig; load_config reads one from a file")
    rules = {field: fields.pop(field) for field in _CHECKS.keys() & fields.keys()}
    objects = {field: _CHECKS[field](rule) for field, rule in rules.items() if not isinstance(rule, str)}
    choice: ModelChoice = fields.pop("model", "")
    own: Mapping[int, OwnModel] = {}
    if not isinstance(choice, str):
        from llm_flock.llm._own import split_choice

        choice, own = split_choice(choice)
    if config is None:
        if mission is not None and not isinstance(cast(object, mission), Mission):
            raise InputError("mission", mission, "a Mission; fields are given by their names, such as shape='circle'")
        names = rules | {field: rule.name for field, rule in objects.items()}
        base = {} if mission is None else {"mission": mission.model_dump(exclude_none=True)}
        plain_fields = {field: plain(field, value) for field, value in fields.items()}
        config = RunConfig.build(base, model=choice or None, **names, **plain_fields)
        rules = objects  # the configuration has the names, old ones under their current form
    if steer is None:
        config.check_orders()
    protocol = config.protocol
    consensus = consensus_rule(rules.get("consensus", protocol.consensus or ""), protocol.ties or "keep")
    assignment = assignment_rule(rules.get("assignment", protocol.assignment or ""), protocol.without)

    # Build every part first, which rejects invalid values; then open files, and fly.
    asked = config.trial
    warn_of_mission(config.mission, asked.noise + asked.drift)
    start = starts_of(config)
    rng, errors = stream(asked.seed, Stream.NOISE), {"drift": asked.drift, "delay": asked.sensing_delay}
    bodies = InstantBodies(Readings(config.mission, start, asked.noise, rng, **errors, moving=asked.moving_obstacles))
    planners = TeamPlanners(config, lane, own)
    code = own_rules((consensus, assignment))
    with ExitStack() as stack:
        outputs = open_outputs(config, planners, sink, trace=trace, unrepeatable=code)
        journal, record = stack.enter_context(outputs)
        if progress and "IPython" in sys.modules:
            from llm_flock.runtime._notebook import notebook_progress

            on_round = stack.enter_context(notebook_progress(shape_title(config.mission.shape), on_round))
        trial = Trial(config, (consensus, assignment), planners, bodies, journal, start, on_round, steer)
        try:
            await trial.run()
        except BaseException:
            with suppress(FlockError):  # an error of the record must not hide the first one
                finish_trial(trial, record)
            raise
        finally:
            await planners.close()
        return finish_trial(trial, record)


@contextmanager
def open_outputs(
    config: RunConfig,
    planners: TeamPlanners,
    sink: RecordSink | None = None,
    *,
    trace: bool = False,
    unrepeatable: Sequence[str] = (),
    ended: dict[str, Exception] | None = None,
) -> Generator[tuple[Journal, str | None]]:
    """Open the files that a run writes. Yields its journal, with or without a trace, and the path of its record.

    With `ended`, the run goes on without a record or a sink that fails: see `Guarded`.
    """
    with ExitStack() as stack:
        path, cassette = config.record, config.model.record_llm
        if cassette is not None:
            from llm_flock.llm._replay import CassetteWriter

            planners.listen(stack.enter_context(CassetteWriter(Path(cassette), simulated=planners.simulated)))
        writer: RecordSink = NullWriter()
        if path is not None:
            from llm_flock.record._writer import Guarded, RecordWriter

            try:
                writer = stack.enter_context(RecordWriter(path))
            except InputError:
                if cassette is not None:
                    Path(cassette).unlink()  # just created, still empty
                raise
            writer = writer if ended is None else Guarded("record", writer.write, ended)
        target = writer
        if sink is not None:
            from llm_flock.record._writer import Guarded, Tee

            target = Tee(writer, sink if ended is None else Guarded("sink", sink.write, ended))
        journal = Journal(config, target, trace=trace)
        journal.unrepeatable = [*planners.unrepeatable, *unrepeatable]
        planners.listen(journal.attempt)
        if path is not None:  # only a record needs it, and asking git takes longer than many rounds
            simulated, unrepeatable = planners.simulated, journal.unrepeatable
            writer.write(run_info(config, simulated=simulated, weights=planners.weights, unrepeatable=unrepeatable))
        yield journal, None if path is None else str(path)
