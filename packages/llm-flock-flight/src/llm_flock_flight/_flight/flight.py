"""One flight: connect, preflight, take off, flock, land. After any fault, the drones land from where they are."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, TypeAlias

from llm_flock.arrays import Points
from llm_flock.errors import RecordError
from llm_flock.planner import Planner
from llm_flock.record import RecordSink
from llm_flock.robots import PoseSource, Robot, RobotError
from llm_flock.runtime import (
    FlightFigures,
    Journal,
    RunResult,
    TeamPlanners,
    Trial,
    TrialProgress,
    finish_trial,
    load_solvers,
    open_outputs,
    warn_of_mission,
)
from llm_flock_flight._flight.claims import claim_drones
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.heartbeat import HeartbeatSender
from llm_flock_flight._flight.homing import fly_home, homes_of
from llm_flock_flight._flight.landing import FELL, LANDED, STOPPED, Landing
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.monitors import Trouble, TroubleKind
from llm_flock_flight._flight.positions import checks_of, feeding, watching
from llm_flock_flight._flight.preflight import Check, PreflightReport, preflight, radio_checks
from llm_flock_flight._flight.supervisor import FlightEnded, FlightSupervisor
from llm_flock_flight._flight.takeoff import TakeOffFailed, take_off
from llm_flock_flight._flight.team import FlyingTeam, NotArrived, SetPointRefused
from llm_flock_flight._flight.timed_planner import TimedPlanner
from llm_flock_flight._positions import PoseFeed

logger = logging.getLogger(__name__)

Stage: TypeAlias = Literal["connecting", "taking off", "flying", "returning", "landing"]
"""What a flight does, in this order; the operator may end it from taking off on."""

RETURN = "return"  # how a flight ended whose operator let all drones return
NEVER_UP = "never took off"
CUT = "motors cut"
SAFE_ENDS = frozenset({LANDED, STOPPED, FELL, NEVER_UP, CUT})  # ends after which a drone needs no attention


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightResult:
    """The preflight, the trial that was flown (None if nothing took off), and the error that ended the record early."""

    report: PreflightReport
    result: RunResult | None = None
    broken_record: Exception | None = None


class Flight:
    """Flies one mission. Call `run` once; `abort`, `return_home` and `emergency` at any time meanwhile.

    Listeners hear of each round, each stage as it begins, and each drone's connection. The `sink` takes every message
    of a record, whether one is written or not, until it raises. `poses` replace the source that the configuration
    names.
    """

    def __init__(
        self,
        config: FlightConfig,
        robots: Sequence[Robot],
        *,
        on_round: Callable[[TrialProgress], None] | None = None,
        on_stage: Callable[[Stage], None] = lambda _: None,
        on_connect: Callable[[Check], None] = lambda _: None,
        sink: RecordSink | None = None,
        poses: PoseSource | None = None,
    ) -> None:
        load_solvers()
        self._config = config
        self._robots = robots
        self._on_round = on_round
        self._on_stage = on_stage
        self._on_connect = on_connect
        self._sink = sink
        self._poses = poses
        self._supervisor: FlightSupervisor | None = None
        self._ended: dict[str, Exception] = {}  # parts that only look on
        self._stage: Stage = "connecting"
        self._ordered_home = asyncio.Event()

    def abort(self) -> bool:
        """Land all drones; returns False if the flight has not begun."""
        return self._trip(Trouble(TroubleKind.ABORT, detail="the operator lands all drones"))

    def return_home(self) -> bool:
        """Let all drones fly to above their starts and land there; returns False if the flight has not begun.

        A motion under way is flown to its end first. During take-off all are landed, as they are above their starts.
        """
        if self._supervisor is None:
            return False
        if self._stage == "flying":
            self._ordered_home.set()
        elif self._stage not in ("returning", "landing"):
            return self.abort()
        return True

    def emergency(self) -> bool:
        """Cut all motors, wherever the drones are; returns False if the flight has not begun."""
        all_robots = frozenset(range(len(self._robots)))
        return self._trip(Trouble(TroubleKind.EMERGENCY, detail="the operator cuts all motors", cut=all_robots))

    def _enter(self, stage: Stage) -> None:
        self._stage = stage
        self._on_stage(stage)

    def _trip(self, trouble: Trouble) -> bool:
        if self._supervisor is None:
            return False
        self._supervisor.trip(trouble)
        return True

    async def run(self, confirm: Callable[[PreflightReport], Awaitable[bool]]) -> FlightResult:
        """Fly. Nothing takes off unless `confirm` returns True; it gets a preflight that was passed.

        A flight goes on if its record breaks off. Raises InputError or FlockError before take-off. In flight, raises
        FlockError only if answers can no longer be saved, and then after all drones have landed.
        """
        with claim_drones(self._config) as claims:
            return await self._run(confirm, claims)

    async def _run(self, confirm: Callable[[PreflightReport], Awaitable[bool]], claims: Sequence[int]) -> FlightResult:
        config = self._config
        warn_of_mission(config.mission)
        planners = TeamPlanners(config)
        try:
            self._enter("connecting")
            async with feeding(config, self._robots, self._poses) as feed:
                look = checks_of(config, self._robots, feed)
                report = await preflight(
                    config,
                    self._robots,
                    self._on_connect,
                    more=lambda states, now_s: [*look(states, now_s), *radio_checks(config)],
                )
                if not report.passed or not await confirm(report):
                    return FlightResult(report=report)
                result: RunResult | None = None
                try:
                    with open_outputs(config, planners, self._sink, ended=self._ended) as (journal, record):
                        result = await self._fly(planners, journal, record, report, feed, claims)
                except RecordError as error:
                    if result is None:
                        raise
                    self._ended.setdefault("record", error)  # all are down
                return FlightResult(report=report, result=result, broken_record=self._ended.get("record"))
        finally:
            await planners.close()
            await asyncio.gather(*map(_close, self._robots))

    async def _fly(
        self,
        planners: TeamPlanners,
        journal: Journal,
        record: str | None,
        report: PreflightReport,
        feed: PoseFeed | None,
        claims: Sequence[int],
    ) -> RunResult:
        config, safety = self._config, self._config.safety
        log = FlightLog(config, journal.writer)
        team = FlyingTeam(config, self._robots, log)
        supervisor = self._supervisor = FlightSupervisor(config, team, log)

        def timed(robot: int, planner: Planner) -> Planner:
            detail = f"{team.names[robot]}: no answer in {safety.silent_rounds} rounds in a row"
            trouble = Trouble(TroubleKind.MODEL_SILENT, robot, detail)
            # With a circuit breaker, geometry flies a drone whose model is silent.
            silent = safety.silent_rounds if config.protocol.fallback == "hold" else None
            return TimedPlanner(planner, safety.think_s, silent, lambda: supervisor.trip(trouble))

        planners.wrap(timed)
        rules, start = config.protocol.rules(), team.readings.places
        trial = Trial(config, rules, planners, team, journal, start, self._on_round)
        log.note("preflight", checks=len(report.checks))
        if "record" in self._ended:
            raise self._ended["record"]  # nothing has taken off yet
        landing = Landing(config, team, log)
        async with HeartbeatSender(config, lambda: team.aloft, claims) as heartbeats:
            team.on_take_off = heartbeats.beat
            silent = f"this process gave no sign of life for {config.fleet.deadman_s:g} s: the deadman lands all drones"
            heartbeats.on_taken = lambda: supervisor.trip(Trouble(TroubleKind.HUNG, detail=silent))
            watchers = [asyncio.create_task(supervisor.watch())]
            if feed is not None:
                watchers.append(watching(config, feed, team, log, supervisor.trip))
            for task in watchers:
                task.add_done_callback(lambda task: _end_unwatched(task, supervisor))
            try:
                await self._mission(supervisor, team, trial, log)
            finally:
                try:
                    self._enter("landing")
                finally:  # a listener may raise
                    await self._land(landing, heartbeats)
                await supervisor.cuts_done()
                for task in watchers:
                    task.cancel()
                if feed is not None:
                    log.note("poses", refused=feed.refused)
        return finish_trial(trial, record, self._result(supervisor, landing, log, feed))

    async def _mission(self, supervisor: FlightSupervisor, team: FlyingTeam, trial: Trial, log: FlightLog) -> None:
        """Take off and flock, until the mission or the flight ends; then return, if that is asked for."""
        homes = homes_of(self._config, team.readings.places)
        try:
            self._enter("taking off")
            await supervisor.while_safe(take_off(self._config, team, log))
            self._enter("flying")
            await supervisor.while_safe(self._until_ordered_home(trial, team))
            if self._ordered_home.is_set() or self._config.safety.at_end == "return":
                await supervisor.while_safe(self._return(team, homes, log))
        except FlightEnded:
            pass  # the supervisor knows the trouble
        except SetPointRefused as refused:
            supervisor.trip(Trouble(TroubleKind.SET_POINT, detail=str(refused)))
        except NotArrived as late:
            supervisor.trip(Trouble(TroubleKind.OFF_COURSE, detail=str(late)))
        except (RobotError, TakeOffFailed) as error:
            supervisor.trip(Trouble(TroubleKind.REFUSED, detail=str(error)))
        trial.begin()
        if self._ordered_home.is_set():
            trial.stopped, trial.reason = RETURN, "the operator lets all drones return"
        if supervisor.trouble is not None:
            trial.stopped, trial.reason = supervisor.trouble.kind.value, supervisor.trouble.detail

    async def _land(self, landing: Landing, heartbeats: HeartbeatSender) -> None:
        """Land all drones. Once the deadman lands them, leave them to it, and call only those that it did not land."""
        work, taken = asyncio.ensure_future(landing.land_all()), asyncio.ensure_future(heartbeats.taken.wait())
        try:
            await asyncio.wait((work, taken), return_when=asyncio.FIRST_COMPLETED)
        finally:
            taken.cancel()
            if not work.done():
                work.cancel()
                await asyncio.wait((work,))
        if not work.cancelled():
            work.result()
            return
        await asyncio.gather(*map(_close, self._robots))  # its links work only while ours are silent
        landing.take(await heartbeats.ends())
        await landing.land_all()

    async def _until_ordered_home(self, trial: Trial, team: FlyingTeam) -> None:
        """Fly the mission to its end, or until all are ordered home; never breaks off a joint motion for that."""
        mission = asyncio.ensure_future(trial.run())
        ordered = asyncio.ensure_future(self._ordered_home.wait())
        try:
            await asyncio.wait((mission, ordered), return_when=asyncio.FIRST_COMPLETED)
            async with team.in_motion:
                pass
        finally:
            ordered.cancel()
            # Nothing runs between the end of a motion and here, so none begins.
            mission.cancel()
            await asyncio.wait((mission,))
        if not mission.cancelled():
            mission.result()

    async def _return(self, team: FlyingTeam, homes: Points, log: FlightLog) -> None:
        self._enter("returning")
        log.note("returning")
        away = await fly_home(self._config, team.readings, team.fly_together, homes)
        names = [team.names[robot] for robot in away]
        log.note("returned", not_home=names)
        if names:
            logger.warning("%s: not home, and landed where it is now", ", ".join(names))

    def _result(
        self, supervisor: FlightSupervisor, landing: Landing, log: FlightLog, feed: PoseFeed | None
    ) -> FlightFigures:
        ends: dict[str, str] = {}
        for robot, body in enumerate(self._robots):
            if robot in supervisor.confirmed:
                ends[body.name] = CUT if supervisor.confirmed[robot] else "motors cut, not confirmed"
            else:
                ends[body.name] = landing.ends.get(robot, NEVER_UP)
        trouble, ordered = supervisor.trouble, self._ordered_home.is_set()
        return FlightFigures(
            ended=RETURN if trouble is None and ordered else "mission" if trouble is None else trouble.kind.value,
            reason=None if trouble is None else trouble.detail,
            ends=ends,
            safe=set(ends.values()) <= SAFE_ENDS,
            air_s=round(supervisor.aloft_s, 3),
            min_separation_m=log.nearest_m if log.nearest_m < float("inf") else None,
            tracking_rms_m=(log.squares / log.counted) ** 0.5 if log.counted else None,
            tracking_max_m=log.worst_m if log.counted else None,
            fan_out_ms=1000 * max(log.fan_outs_s) if log.fan_outs_s else None,
            poses_refused=None if feed is None else feed.refused,
            lag_s=round(log.lag_s, 3),
        )


async def _close(robot: Robot) -> None:
    """Close a link; a drone out of reach is named in the result."""
    with suppress(TimeoutError, RobotError):
        await robot.close()


def _end_unwatched(task: asyncio.Task[None], supervisor: FlightSupervisor) -> None:
    """End a flight whose supervision has failed."""
    if not task.cancelled() and (error := task.exception()) is not None:
        supervisor.trip(Trouble(TroubleKind.UNWATCHED, detail=f"{type(error).__name__}: {error}"))
