"""One flight: connect, preflight, take off, flock, land; and down safely from wherever anything goes wrong."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from llm_flock.robots.base import Robot, RobotError
from llm_flock.runtime.api import minds, open_books
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.flight.guard import Grounded, Guard
from llm_flock.runtime.flight.heartbeat import Heartbeat
from llm_flock.runtime.flight.landing import LANDED, STOPPED, Landing
from llm_flock.runtime.flight.lift import NotAloft, take_off
from llm_flock.runtime.flight.log import FlightLog
from llm_flock.runtime.flight.monitors import Kind, Trouble
from llm_flock.runtime.flight.patience import Impatient
from llm_flock.runtime.flight.preflight import Report, preflight
from llm_flock.runtime.flight.team import FlyingTeam, SetPointRefused
from llm_flock.runtime.journal import Journal
from llm_flock.runtime.result import FlightFigures, RunResult
from llm_flock.runtime.roster import Roster
from llm_flock.runtime.rules import assignment_rule, consensus_rule
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.team import Thinkers
from llm_flock.runtime.trial import Trial, TrialProgress
from llm_flock.transport.memory import MemoryTransport

TAKING_OFF = "taking off"
"""What is said when it begins: from then on the operator may end the flight."""

NEVER_UP = "never took off"
CUT = "motors cut"
CUT_UNCONFIRMED = "motors cut, not confirmed"
SAFE_ENDS = frozenset({LANDED, STOPPED, NEVER_UP, CUT})
"""Ends of a drone after which nothing is to be done about it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightResult:
    """One flight, or why it was none.

    Attributes:
        report: the preflight.
        result: the trial that was flown, figures of the flight in its summary; None where nothing took off.
    """

    report: Report
    result: RunResult | None = None


class Flight:
    """Flies one mission. Call `run` once; `abort` and `emergency` at any time meanwhile.

    Args:
        config: the flight file.
        robots: one for each robot of the mission, not connected yet.
        on_round: told after each round, for a live display.
        on_stage: told what begins now, in a few words.
    """

    def __init__(
        self,
        config: FlightConfig,
        robots: Sequence[Robot],
        *,
        on_round: Callable[[TrialProgress], None] | None = None,
        on_stage: Callable[[str], None] | None = None,
    ) -> None:
        self._config = config
        self._robots = robots
        self._on_round = on_round
        self._say = on_stage or _silently
        self._guard: Guard | None = None

    def abort(self) -> bool:
        """Land everybody; whether anybody had taken off, or was about to."""
        if self._guard is None:
            return False
        self._guard.abort()
        return True

    def emergency(self) -> bool:
        """Cut all motors; whether there was a flight."""
        if self._guard is None:
            return False
        self._guard.emergency()
        return True

    async def run(self, confirm: Callable[[Report], Awaitable[bool]]) -> FlightResult:
        """Fly.

        Args:
            confirm: is shown a preflight that was passed; nothing takes off unless it says so.

        Raises:
            InputError: the file, or a place to write to, will not do; nothing has moved.
            FlockError: the deadman did not start, or a file cannot be written any more; everybody was landed.
        """
        config = self._config
        thinkers = Thinkers(config)
        try:
            self._say("connecting")
            report = await preflight(config, self._robots)
            if not report.passed or not await confirm(report):
                return FlightResult(report=report)
            with open_books(config, thinkers) as (journal, record):
                return FlightResult(report=report, result=await self._fly(thinkers, journal, record, report))
        finally:
            await thinkers.close()
            for robot in self._robots:
                with suppress(TimeoutError, RobotError):  # whoever is out of reach has been named already
                    await robot.close()

    async def _fly(self, thinkers: Thinkers, journal: Journal, record: str | None, report: Report) -> RunResult:
        config = self._config
        log = FlightLog(config, journal.writer)
        team = FlyingTeam(config, self._robots, log)
        guard = self._guard = Guard(config, team, log)
        self._impatience(thinkers, guard)
        trial = self._trial(thinkers, journal, team)
        journal.mission_given(config.mission, 0, team.set_point_rows)
        log.note("preflight", checks=len(report.checks))
        landing = Landing(config, team, log)
        async with Heartbeat(config, lambda: team.aloft) as heart:
            team.tell_deadman = heart.tell
            watching = asyncio.create_task(guard.watch())
            watching.add_done_callback(lambda task: _unwatched(task, guard))
            try:
                await self._mission(guard, team, trial, log)
            finally:
                self._say("landing")
                await landing.all_down()
                await guard.settled()
                watching.cancel()
        if log.failure is not None:
            raise log.failure
        return trial.finish(record, self._figures(guard, landing, log))

    async def _mission(self, guard: Guard, team: FlyingTeam, trial: Trial, log: FlightLog) -> None:
        """Take off and flock, until the mission or the flight is over."""
        with suppress(Grounded):
            await self._until_grounded(guard, team, trial, log)
        trial.begin()
        if guard.trouble is not None:
            trial.stopped, trial.reason = guard.trouble.kind.value, guard.trouble.detail

    async def _until_grounded(self, guard: Guard, team: FlyingTeam, trial: Trial, log: FlightLog) -> None:
        try:
            self._say(TAKING_OFF)
            await guard.while_safe(take_off(self._config, team, log))
            self._say("flying")
            await guard.while_safe(trial.run())
        except SetPointRefused as refused:
            guard.trip(Trouble(kind=Kind.SET_POINT, detail=str(refused)))
        except (RobotError, NotAloft, TimeoutError) as error:
            guard.trip(Trouble(kind=Kind.REFUSED, detail=str(error) or "a drone did not answer in time"))

    def _impatience(self, thinkers: Thinkers, guard: Guard) -> None:
        safety = self._config.safety

        def told(robot: int) -> Callable[[int], None]:
            name = self._robots[robot].name
            return lambda rounds: guard.trip(
                Trouble(kind=Kind.MODEL_SILENT, robot=robot, detail=f"{name}: no answer in {rounds} rounds on end")
            )

        thinkers.wrap(lambda robot, inner: Impatient(inner, safety.think_s, safety.silent_rounds, told(robot)))

    def _trial(self, thinkers: Thinkers, journal: Journal, team: FlyingTeam) -> Trial:
        config = self._config
        protocol, mission = config.protocol, config.mission
        rules = consensus_rule(protocol.consensus or ""), assignment_rule(protocol.assignment or "")
        schedule = config.schedule()
        roster = Roster(minds(config, *rules), mission.n_robots, schedule.asleep)
        transport = MemoryTransport(mission.n_robots, config.links, stream(config.trial.seed, Stream.LINKS))
        return Trial(config, schedule, roster, thinkers, team, transport, journal, self._on_round)

    def _figures(self, guard: Guard, landing: Landing, log: FlightLog) -> FlightFigures:
        ends: dict[str, str] = {}
        for robot, body in enumerate(self._robots):
            if robot in guard.confirmed:
                ends[body.name] = CUT if guard.confirmed[robot] else CUT_UNCONFIRMED
            else:
                ends[body.name] = landing.ends.get(robot, NEVER_UP)
        found, trouble = log.figures, guard.trouble
        return FlightFigures(
            ended="mission" if trouble is None else trouble.kind.value,
            reason=None if trouble is None else trouble.detail,
            ends=ends,
            safe=set(ends.values()) <= SAFE_ENDS,
            air_s=round(guard.aloft_s, 3),
            min_separation_m=found.nearest_m if found.nearest_m < float("inf") else None,
            tracking_rms_m=(found.squares / found.counted) ** 0.5 if found.counted else None,
            tracking_max_m=found.worst_m if found.counted else None,
            fan_out_ms=1000 * max(found.fan_outs_s) if found.fan_outs_s else None,
        )


def _silently(stage: str) -> None:
    """Nobody is told."""


def _unwatched(task: asyncio.Task[None], guard: Guard) -> None:
    """A flight that nobody watches must not go on."""
    if not task.cancelled() and (error := task.exception()) is not None:
        guard.trip(Trouble(kind=Kind.UNWATCHED, detail=f"{type(error).__name__}: {error}"))
