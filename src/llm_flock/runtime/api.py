"""The Python entry point: a mission in, a result out."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from llm_flock.errors import FlockError, InputError
from llm_flock.llm.replay import CassetteWriter
from llm_flock.llm.sharing import Lane
from llm_flock.mission import Mission
from llm_flock.protocol.agent import Agent
from llm_flock.protocol.agreement.assignment import AssignmentRule
from llm_flock.protocol.agreement.consensus import ConsensusRule
from llm_flock.record.writer import NullWriter, RecordSink, RecordWriter, Tee
from llm_flock.robots.simulated import check_start, draw_start
from llm_flock.runtime.bodies import AtOnce
from llm_flock.runtime.config import RunConfig, build_config
from llm_flock.runtime.entries import run_info
from llm_flock.runtime.journal import Journal
from llm_flock.runtime.result import RunResult
from llm_flock.runtime.roster import Roster
from llm_flock.runtime.rules import assignment_rule, consensus_rule
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.team import Thinkers
from llm_flock.runtime.trial import Steer, Trial, TrialProgress
from llm_flock.transport.memory import MemoryTransport

RECORD_NAME = "run.mcap"


def run(mission: Mission | None = None, **options: Any) -> RunResult:
    """Run one trial and wait for it; takes what `run_async` takes."""
    return asyncio.run(run_async(mission, **options))


async def run_async(
    mission: Mission | None = None,
    *,
    consensus: str | ConsensusRule | None = None,
    assignment: str | AssignmentRule | None = None,
    config: RunConfig | None = None,
    on_round: Callable[[TrialProgress], None] | None = None,
    sink: RecordSink | None = None,
    lane: Lane | None = None,
    steer: Steer | None = None,
    **options: Any,
) -> RunResult:
    """Run one trial.

    Args:
        mission: what the team is asked to do; the paper's circle of ten if left out.
        consensus: name of a rule, or a rule of one's own.
        assignment: name of a rule, or a rule of one's own.
        config: a whole configuration instead of a mission and options.
        on_round: told after each round.
        sink: takes note of all that a record would hold, whether there is one or not.
        lane: the way to what this run shares with others: a budget, rates of providers, connections.
        steer: asked before each round, and free to change what is to happen.
        options: any field of the configuration by its name (`model=`, `rounds=`, `seed=`, `loss=`, `out=`, ...).

    Returns:
        Arrays and figures of the trial. With `out`, the record is written to `out/run.mcap` as it happens.

    Raises:
        InputError: a value is not allowed; nothing has been written then.
        ReplayDrift: a replayed conversation differs from the recorded one.
        asyncio.CancelledError: after the record was brought to a readable end.
    """
    if config is None:
        names = {
            field: rule if rule is None or isinstance(rule, str) else rule.name
            for field, rule in (("consensus", consensus), ("assignment", assignment))
        }
        base = {} if mission is None else {"mission": mission.model_dump(exclude_none=True)}
        config = build_config(base, **names, **options)
    elif mission is not None or options:
        raise InputError("config", "given", "either config, or mission and options")
    protocol = config.protocol
    if consensus is None or isinstance(consensus, str):
        consensus = consensus_rule(protocol.consensus or "")
    if assignment is None or isinstance(assignment, str):
        assignment = assignment_rule(protocol.assignment or "")
    rules = consensus, assignment

    return await _fly(config, minds(config, *rules), on_round, sink, lane, steer)


def minds(config: RunConfig, consensus: ConsensusRule, assignment: AssignmentRule) -> Callable[[int], Agent]:
    """What makes the mind of each robot."""
    protocol = config.protocol

    def mind(robot: int) -> Agent:
        return Agent(
            robot,
            config.mission,
            consensus,
            assignment,
            shield_on=bool(protocol.shield),
            verify=bool(protocol.verify),
            on_event=config.model.decide == "on-event",
            noise_bound=config.trial.noise,
            time_out=protocol.time_out,
            gaps=protocol.gaps,
        )

    return mind


async def _fly(
    config: RunConfig,
    mind: Callable[[int], Agent],
    on_round: Callable[[TrialProgress], None] | None,
    sink: RecordSink | None,
    lane: Lane | None,
    steer: Steer | None,
) -> RunResult:
    """Build every part, refusing what is wrong; only then open files, and fly."""
    mission, seed = config.mission, config.trial.seed
    given = config.trial.start_positions
    rule = config.trial.start
    start = draw_start(mission, rule, stream(seed, Stream.START)) if given is None else check_start(mission, given)
    bodies = AtOnce(mission, start, config.trial.noise, stream(seed, Stream.NOISE))
    transport = MemoryTransport(mission.n_robots, config.links, stream(seed, Stream.LINKS))
    thinkers = Thinkers(config, lane)
    schedule = config.schedule()
    roster = Roster(mind, mission.n_robots, schedule.asleep)
    with open_books(config, thinkers, sink) as (journal, record):
        journal.mission_given(mission, 0, start)
        trial = Trial(config, schedule, roster, thinkers, bodies, transport, journal, on_round, steer)
        try:
            await trial.run()
        except BaseException:
            with suppress(FlockError):  # the record's own trouble must not hide what happened
                trial.finish(record)
            raise
        finally:
            await thinkers.close()
        return trial.finish(record)


@contextmanager
def open_books(
    config: RunConfig, thinkers: Thinkers, sink: RecordSink | None = None
) -> Generator[tuple[Journal, str | None]]:
    """Open everything that a run is written to: its journal, and the path of its record.

    Raises:
        InputError: a file is in the way, or cannot be made.
    """
    with ExitStack() as stack:
        path = None if config.trial.out is None else Path(config.trial.out) / RECORD_NAME
        cassette = None if config.model.record_llm is None else Path(config.model.record_llm)
        if cassette is not None:
            thinkers.listen(stack.enter_context(CassetteWriter(cassette)))
        try:
            writer = stack.enter_context(NullWriter() if path is None else RecordWriter(path))
        except InputError:
            if cassette is not None:
                cassette.unlink()  # this run made it a moment ago, and nothing is in it
            raise
        journal = Journal(
            config.mission, writer if sink is None else Tee(writer, sink), replans=config.protocol.gaps == "replan"
        )
        thinkers.listen(journal.attempt)
        if path is not None:  # only then: asking git for the revision takes longer than many a round
            writer.write(run_info(config, simulated=thinkers.simulated, weights=thinkers.weights))
        yield journal, None if path is None else str(path)
