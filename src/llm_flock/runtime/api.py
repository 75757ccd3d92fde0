"""The Python entry point: flies one mission and returns its result."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Unpack, cast

from llm_flock.errors import FieldError, FlockError, InputError, RecordError
from llm_flock.llm.own import split_choice
from llm_flock.llm.sharing import CallLane
from llm_flock.mission import Mission
from llm_flock.record.writer import GivenUp, NullWriter, RecordSink, RecordWriter, Tee
from llm_flock.robots.simulated import Readings, start_positions
from llm_flock.runtime.bodies import InstantBodies
from llm_flock.runtime.config import RECORD_NAME, RunConfig, warn_of_mission
from llm_flock.runtime.entries import run_info
from llm_flock.runtime.journal import Journal
from llm_flock.runtime.loops import wait_for
from llm_flock.runtime.parameters import Parameters, plain
from llm_flock.runtime.planners import TeamPlanners
from llm_flock.runtime.result import RunResult
from llm_flock.runtime.rules import assignment_rule, consensus_rule, own_rules
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.trial import Steer, Trial, TrialProgress

__all__ = ["RECORD_NAME", "open_outputs", "run", "run_async"]

CHECKS: dict[str, Callable[[Any], Any]] = {"consensus": consensus_rule, "assignment": assignment_rule}
"""Fields that take objects, also beside a whole configuration."""


def run(mission: Mission | None = None, **given: Unpack[Parameters]) -> RunResult:
    """Fly one mission, and wait for its end; works in scripts, notebooks and threads.

    Where an event loop is running already, as in a notebook, the run gets a thread of its own. There,
    `await run_async(...)` leaves the loop free.

    Args:
        mission: the team's task; the paper's circle of ten if left out.
        config: a whole configuration (`RunConfig`), instead of a mission and fields.
        on_round: called after each round, in the thread that flies.
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
    return wait_for(_fly(mission, **given))


async def run_async(mission: Mission | None = None, **given: Unpack[Parameters]) -> RunResult:
    """Fly one mission: as `run`, within the running event loop.

    Raises:
        asyncio.CancelledError: after the record was brought to a readable end.
    """
    return await _fly(mission, **given)


async def _fly(
    mission: Mission | None,
    *,
    config: RunConfig | None = None,
    on_round: Callable[[TrialProgress], None] | None = None,
    progress: bool = True,
    trace: bool = True,
    sink: RecordSink | None = None,
    lane: CallLane | None = None,
    steer: Steer | None = None,
    **fields: Any,
) -> RunResult:
    fields = {field: value for field, value in fields.items() if value is not None}
    if config is not None and (mission is not None or fields.keys() - CHECKS.keys()):
        raise FieldError("config", says="give either config, or mission and options, not both")
    if config is not None and not isinstance(cast(object, config), RunConfig):
        raise InputError("config", config, "a RunConfig; load_config reads one from a file")
    rules = {field: fields.pop(field) for field in CHECKS.keys() & fields.keys()}
    objects = {field: CHECKS[field](rule) for field, rule in rules.items() if not isinstance(rule, str)}
    choice, own = split_choice(fields.pop("model", ""))
    if config is None:
        if mission is not None and not isinstance(cast(object, mission), Mission):
            raise InputError("mission", mission, "a Mission; fields are given by their names, such as shape='circle'")
        names = rules | {field: rule.name for field, rule in objects.items()}
        base = {} if mission is None else {"mission": mission.model_dump(exclude_none=True)}
        plain_fields = {field: plain(field, value) for field, value in fields.items()}
        config = RunConfig.build(base, model=choice or None, **names, **plain_fields)
        rules = objects  # names are in the configuration now, old ones under their current name
    protocol = config.protocol
    consensus = consensus_rule(rules.get("consensus", protocol.consensus or ""))
    assignment = assignment_rule(rules.get("assignment", protocol.assignment or ""))

    # Build every part, and so refuse whatever is wrong; only then open files, and fly.
    warn_of_mission(config.mission)
    given = config.trial
    rng = stream(given.seed, Stream.START)
    start = start_positions(config.mission, given.start_positions, given.start, rng, given.start_area)
    bodies = InstantBodies(Readings(config.mission, start, given.noise, stream(given.seed, Stream.NOISE)))
    planners = TeamPlanners(config, lane, own)
    code = own_rules((consensus, assignment))
    with ExitStack() as stack:
        outputs = open_outputs(config, planners, sink, trace=trace, unrepeatable=code)
        journal, record = stack.enter_context(outputs)
        if progress and "IPython" in sys.modules:
            from llm_flock.runtime.notebook import notebook_progress

            on_round = stack.enter_context(notebook_progress(config.mission.shape, on_round))
        trial = Trial(config, (consensus, assignment), planners, bodies, journal, start, on_round, steer)
        try:
            await trial.run()
        except BaseException:
            with suppress(FlockError):  # trouble with the record must not hide the first error
                trial.finish(record)
            raise
        finally:
            await planners.close()
        return trial.finish(record)


@contextmanager
def open_outputs(
    config: RunConfig,
    planners: TeamPlanners,
    sink: RecordSink | None = None,
    *,
    trace: bool = False,
    unrepeatable: Sequence[str] = (),
    on_broken: Callable[[RecordError], None] | None = None,
) -> Generator[tuple[Journal, str | None]]:
    """Open the files that a run writes: its journal, which keeps a trace or not, and the path of its record.

    `unrepeatable` says what the configuration cannot repeat, besides the models. With `on_broken`, a record that cannot
    be written any more is given up, and `on_broken` gets the error; without, whoever writes gets it.

    Raises:
        InputError: a file exists already, or cannot be made.
    """
    with ExitStack() as stack:
        path, cassette = config.record, config.model.record_llm
        if cassette is not None:
            from llm_flock.llm.replay import CassetteWriter

            planners.listen(stack.enter_context(CassetteWriter(Path(cassette), simulated=planners.simulated)))
        try:
            writer: RecordSink = NullWriter() if path is None else stack.enter_context(RecordWriter(path))
        except InputError:
            if cassette is not None:
                Path(cassette).unlink()  # created just now, and still empty
            raise
        if on_broken is not None and path is not None:
            writer = GivenUp(writer, on_broken)
        journal = Journal(
            config.mission,
            writer if sink is None else Tee(writer, sink),
            replans=config.protocol.gaps == "replan",
            trace=trace,
        )
        journal.unrepeatable = [*planners.unrepeatable, *unrepeatable]
        planners.listen(journal.attempt)
        if path is not None:  # only a record needs it, and asking git takes longer than many rounds
            about = run_info(
                config,
                simulated=planners.simulated,
                weights=planners.weights,
                unrepeatable=journal.unrepeatable,
            )
            writer.write(about)
        yield journal, None if path is None else str(path)
