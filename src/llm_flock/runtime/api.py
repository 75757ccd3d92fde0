"""The Python entry point: flies one mission and returns its result."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from llm_flock.errors import FlockError, InputError
from llm_flock.llm.replay import CassetteWriter
from llm_flock.llm.sharing import CallLane
from llm_flock.mission import Mission
from llm_flock.protocol.agreement.assignment import AssignmentRule
from llm_flock.protocol.agreement.consensus import ConsensusRule
from llm_flock.record.writer import NullWriter, RecordSink, RecordWriter, Tee
from llm_flock.robots.simulated import start_positions
from llm_flock.runtime.bodies import InstantBodies
from llm_flock.runtime.config import RECORD_NAME, RunConfig, warn_of_mission
from llm_flock.runtime.entries import run_info
from llm_flock.runtime.journal import Journal
from llm_flock.runtime.planners import TeamPlanners
from llm_flock.runtime.result import RunResult
from llm_flock.runtime.rules import assignment_rule, consensus_rule
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.trial import Steer, Trial, TrialProgress

__all__ = ["RECORD_NAME", "open_outputs", "run", "run_async"]


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
    lane: CallLane | None = None,
    steer: Steer | None = None,
    **options: Any,
) -> RunResult:
    """Run one trial.

    Args:
        mission: the team's task; the paper's circle of ten if left out.
        consensus: name of a rule, or a rule object.
        assignment: name of a rule, or a rule object.
        config: a whole configuration instead of a mission and options.
        on_round: called after each round.
        sink: takes every message of a record, whether a record is written or not.
        lane: access to what this run shares with others: a budget, rates of providers, connections.
        steer: awaited before each round, and free to change the schedule, the links and the planners.
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
        config = RunConfig.build(base, **names, **options)
    elif mission is not None or options:
        raise InputError("config", "given", "either config, or mission and options")
    protocol = config.protocol
    if consensus is None or isinstance(consensus, str):
        consensus = consensus_rule(protocol.consensus or "")
    if assignment is None or isinstance(assignment, str):
        assignment = assignment_rule(protocol.assignment or "")

    # Build every part, and so refuse whatever is wrong; only then open files, and fly.
    warn_of_mission(config.mission)
    given = config.trial
    rng = stream(given.seed, Stream.START)
    start = start_positions(config.mission, given.start_positions, given.start, rng, given.start_area)
    bodies = InstantBodies(config.mission, start, given.noise, stream(given.seed, Stream.NOISE))
    planners = TeamPlanners(config, lane)
    with open_outputs(config, planners, sink) as (journal, record):
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
    config: RunConfig, planners: TeamPlanners, sink: RecordSink | None = None
) -> Generator[tuple[Journal, str | None]]:
    """Open the files that a run writes: its journal, and the path of its record.

    Raises:
        InputError: a file exists already, or cannot be made.
    """
    with ExitStack() as stack:
        path, cassette = config.record, config.model.record_llm
        if cassette is not None:
            planners.listen(stack.enter_context(CassetteWriter(Path(cassette))))
        try:
            writer = NullWriter() if path is None else stack.enter_context(RecordWriter(path))
        except InputError:
            if cassette is not None:
                Path(cassette).unlink()  # created just now, and still empty
            raise
        journal = Journal(
            config.mission, writer if sink is None else Tee(writer, sink), replans=config.protocol.gaps == "replan"
        )
        planners.listen(journal.attempt)
        if path is not None:  # only a record needs it, and asking git takes longer than many rounds
            writer.write(run_info(config, simulated=planners.simulated, weights=planners.weights))
        yield journal, None if path is None else str(path)
