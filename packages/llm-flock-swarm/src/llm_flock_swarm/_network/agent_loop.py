"""Drives one agent at its own pace: it asks its model as soon as it may, and waits for no other robot.

Motion rounds, message exchanges at a fixed period, and control of the body at another share one event loop. A heartbeat
period has as many exchanges as a lockstep round: heartbeats and time-outs are counted in periods here.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Any

from llm_flock import events
from llm_flock.agent import Agent
from llm_flock.arrays import Point
from llm_flock.bounds import MAX_REASON
from llm_flock.errors import FlockError, InputError
from llm_flock.events import AskJudgement, AskPlan, AskStep, Broadcast, Effect, Event, MoveTo, Note, Origin, Phase
from llm_flock.message import NO_OWNER
from llm_flock.metrics import AT_GOAL
from llm_flock.planner import NoAnswer, PlanAnswer, Planner, StepAnswer
from llm_flock.protocol import Authorization
from llm_flock.record import LlmEntry, ProtocolEvent
from llm_flock.transport import Radio
from llm_flock_swarm._network.accusations import Accuser
from llm_flock_swarm._network.body_control import STILL, BodyControl
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.mission_orders import changed_mission
from llm_flock_swarm._network.process import PeriodClock, phase_s
from llm_flock_swarm._network.receiving import INTERNAL_ERROR, count_refusals
from llm_flock_swarm._network.wire import MissionOrder, RobotReport
from llm_flock_swarm._zenoh import LinkTraffic

SETTLED_EXCHANGES = 2  # exchanges without another slot after which agreement about a new plan counts as settled
LATEST = 2.0  # a move ends at the latest after this multiple of its unhindered duration
MAX_NOTES = 256  # events in one report; more of them, in a flood of bad messages say, are only counted
MAX_FAULTS = 20  # exchanges in a row that meet an error in this program before the robot gives up
RETELL = 25  # one report in this many names the plan's places and the mission again, for observers that came later
STUCK_S = 0.3  # a body that has not moved for this long cannot get any nearer [s]


class AgentLoop:
    """Drives one agent; in a team with keys, `accuser` shows observers what no honest robot sends."""

    def __init__(
        self,
        config: SwarmConfig,
        agent: Agent,
        planner: Planner,
        radio: Radio,
        body: BodyControl,
        broadcast: Callable[[bytes], None],
        accuser: Accuser | None = None,
    ) -> None:
        self.agent = agent
        self.round = 0
        self.period = 0
        self.waypoints: Counter[str] = Counter()
        self.notes: list[dict[str, Any]] = []
        self.refused = Counter[str]()
        self._dropped_notes = self._faults = self._reports = 0
        self._config, self._planner, self._radio, self._body = config, planner, radio, body
        self._broadcast, self._accuser = broadcast, accuser
        self._known = {config.mission.digest}
        self._comm_rounds = 0
        self._settled_at = 0
        self._last_topic: object = None
        self._order: AskStep | MoveTo | None = None
        self._changed = asyncio.Event()
        self._moving: MoveTo | None = None
        self._going_for: object = None
        self._due = 0.0

    def handle(self, event: Event) -> list[Effect]:
        """Give the agent an event; keep its notes and orders, and return its question for a plan."""
        rest: list[Effect] = []
        for effect in self.agent.handle(event):
            match effect:
                case Note():
                    self.note(effect.kind, dict(effect.detail))
                case Broadcast():
                    self._broadcast(effect.payload)
                case AskStep() | MoveTo():
                    self._order = effect
                    self._changed.set()
                case AskPlan():
                    rest.append(effect)
                case AskJudgement():
                    raise AssertionError("robots of a swarm do not judge: its configuration refuses it")
        return rest

    def note(self, kind: str, detail: dict[str, Any]) -> None:
        if len(self.notes) < MAX_NOTES:
            self.notes.append({"kind": kind, "detail": detail})
        else:
            self._dropped_notes += 1

    def look(self) -> None:
        if self._radio.position is not None and self.agent.phase is not Phase.STOPPED:
            self.handle(events.Sensed(**self._sight()))

    def receive(self, payload: bytes, sender: int) -> None:
        if self.agent.position and self.agent.phase is not Phase.STOPPED:
            self.handle(events.Received(payload, sender))

    def take_order(self, order: MissionOrder) -> None:
        """Take another mission from the operator; one that is not allowed is only recorded."""
        try:
            mission = changed_mission(self.agent.mission, order.fields)
        except (InputError, TypeError) as error:
            self.note("rejected_message", {"reason": "mission", "detail": str(error)})
            return
        signed = Authorization(counter=order.counter, signature=order.signature) if order.signature else None
        self.handle(events.MissionGiven(mission=mission, ordered_at=order.counter, authorization=signed))

    def _sight(self) -> dict[str, Any]:
        """Sensor readings; a robot under way uses the waypoint that it flies to as its position."""
        here = self._body.waypoint or self._radio.position
        assert here is not None, "a robot begins once it knows where it is"
        sensed = self._radio.sensed()
        return {
            "position": here,
            "degree": self._radio.neighbors(time.time()),
            "sensed": sensed,
            "observed": tuple(sensed.values()),
        }

    async def gossip(self) -> None:
        """Exchange messages periodically until cancelled."""
        gossip_s = self._config.network.gossip_s
        clock = PeriodClock(gossip_s, phase_s(self.agent.robot, self._config.mission.n_robots, gossip_s))
        while True:
            await clock.next()
            before = self.refused[INTERNAL_ERROR]
            with count_refusals(self.refused):
                self.exchange()
            self._faults = 0 if self.refused[INTERNAL_ERROR] == before else self._faults + 1
            if self._faults >= MAX_FAULTS:
                raise FlockError(f"robot {self.agent.robot} cannot go on: {MAX_FAULTS} exchanges in a row failed")

    def exchange(self) -> None:
        """Decide on the messages since the last exchange, count a heartbeat once a period, then broadcast."""
        self.look()
        if not self.agent.position:
            return
        self.handle(events.CommRoundEnded())
        if self._accuser is not None:
            accusation = self._accuser.accuse(self.agent.rejected.total(), self.agent.mission)
            if accusation is not None:
                self.note(accusation.kind, dict(accusation.detail))
        if self._comm_rounds % (self._config.protocol.comm_rounds or 1) == 0:
            self.period += 1
            self.handle(events.HeartbeatDue(self.period))
        self.handle(events.CommRoundBegan())
        self._comm_rounds += 1
        if self._topic != self._last_topic:
            self._last_topic, self._settled_at = self._topic, self._comm_rounds
            self._changed.set()
            if self._body.waypoint is not None and self._topic != self._going_for:
                self._body.waypoint = None  # it stops within a control period, then sets out for its new place

    @property
    def _topic(self) -> tuple[str, str | None, int | None]:
        agent = self.agent
        return agent.mission.digest, None if agent.plan is None else agent.plan.digest, agent.claim.slot

    async def live(self) -> None:
        try:
            while True:
                await self._fly_round()
        finally:
            self.handle(events.Stopped())

    async def _fly_round(self) -> None:
        self.round += 1
        topic = self._topic[:2]
        for effect in self.handle(events.RoundBegan(round=self.round, **self._sight())):
            assert isinstance(effect, AskPlan)
            answer = await self._ask(self._planner.plan(effect.question), lambda: self._topic[:2] != topic)
            self.handle(events.Planned(answer))
        await self._settle()
        self._order = None
        self.look()
        self.handle(events.AgreementEnded())
        move = await self._decide()
        await self._land()
        self.waypoints[move.origin.value] += 1
        self._moving = move
        moves = self._take_off(move.waypoint)
        self.handle(events.Arrived())
        if not moves or self._is_there(move):
            await self._rest()

    async def _settle(self) -> None:
        """Wait until agreement about a new place has settled, for a heartbeat period at most."""
        network = self._config.network
        for _ in range(self._config.protocol.comm_rounds or 1):
            if self._comm_rounds - self._settled_at >= SETTLED_EXCHANGES:
                return
            await asyncio.sleep(network.gossip_s)

    async def _decide(self) -> MoveTo:
        """The waypoint to fly to; a newer question replaces the one under way."""
        while True:
            order, self._order = self._order, None
            assert order is not None, "the agent has said what to decide"
            if isinstance(order, MoveTo):
                return order
            answer = await self._ask(self._planner.step(order.question), lambda: self._order is not None)
            await self._land()
            if self._order is None:
                self.look()
                self.handle(events.Decided(answer))

    async def _ask(self, question: Awaitable[PlanAnswer | StepAnswer | NoAnswer], stale: Callable[[], bool]) -> Any:
        """The answer; `NoAnswer` if it is late or has become stale."""
        task = asyncio.ensure_future(question)
        deadline = time.monotonic() + self._config.network.answer_s
        try:
            while not task.done():
                self._changed.clear()
                if stale():
                    return NoAnswer(cause="stale", reason="the question is not asked any more")
                left = deadline - time.monotonic()
                if left <= 0.0:
                    return NoAnswer(cause="timeout", reason=f"no answer within {self._config.network.answer_s:g} s")
                change = asyncio.ensure_future(self._changed.wait())
                await asyncio.wait((task, change), timeout=left, return_when=asyncio.FIRST_COMPLETED)
                change.cancel()
            return task.result()
        finally:
            if not task.done():
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)

    def _take_off(self, waypoint: Point) -> bool:
        """Set out, if it is any way. The next question is asked at once, from where the body will arrive."""
        here = self._radio.position
        assert here is not None
        distance = math.dist(here, waypoint)
        if distance <= STILL:
            return False
        self._going_for = self._topic
        self._body.fly_to(waypoint)
        self._due = time.monotonic() + LATEST * distance / self._config.speed + STUCK_S
        return True

    async def _land(self) -> None:
        """Wait until the body has arrived, cannot get any nearer, or has lost its waypoint."""
        body, radio = self._body, self._radio
        last, moved_at = radio.position, time.monotonic()
        while body.waypoint is not None and not body.arrived:
            await asyncio.sleep(self._config.network.control_s / 4)
            now = time.monotonic()
            if radio.position != last:
                last, moved_at = radio.position, now
            if now - moved_at > STUCK_S or now > self._due:
                break
        body.waypoint = None

    def _is_there(self, move: MoveTo) -> bool:
        """Whether a move ends at the robot's place, or where it waits."""
        goal, near = self.agent.goal, AT_GOAL * self.agent.mission.spacing
        return move.origin is Origin.HOLD or (goal is not None and math.dist(goal, move.waypoint) <= near)

    async def _rest(self) -> None:
        """Wait for a heartbeat period, or until the place changes, before the next question."""
        network = self._config.network
        await self._land()
        self._changed.clear()
        rest_s = network.gossip_s * (self._config.protocol.comm_rounds or 1)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._changed.wait(), rest_s)

    def report(
        self, calls: list[LlmEntry], latencies_s: list[float], traffic: LinkTraffic, contradicted: int
    ) -> RobotReport:
        """The state for observers, with the plan and the mission where no report has named them of late."""
        agent = self.agent
        if self._reports % RETELL == 0:
            self._known.clear()
        self._reports += 1
        known, plan, origin, mission, move = self._known, agent.plan, agent.provenance, agent.mission, self._moving
        told = plan if plan is not None and plan.digest not in known else None
        shape = None if mission.digest in known else mission.model_dump(mode="json")
        known.update({mission.digest} if plan is None else {mission.digest, plan.digest})
        notes, self.notes = self.notes, []
        if self._dropped_notes:
            notes.append({"kind": "dropped_notes", "detail": {"count": self._dropped_notes}})
            self._dropped_notes = 0
        refused = Counter({"contradicted_beacon": contradicted} if contradicted else {})
        return RobotReport(
            round=self.round,
            period=self.period,
            phase=agent.phase.value,
            mission=(agent.ordered_at, mission.digest),
            order=agent.authorization,
            plan_id=None if plan is None else plan.digest,
            plan=told,
            proposer=None if origin is None else origin.proposer,
            slot=agent.claim.slot,
            replans=agent.replans,
            blocked=tuple(a for a, entry in enumerate(agent.claim.table or ()) if entry[2] < NO_OWNER),
            waypoint=None if move is None else move.waypoint,
            origin="start" if move is None else move.origin.value,
            neighbors=agent.degree,
            happened=tuple(ProtocolEvent(round=0, comm_round=None, robot=agent.robot, **note) for note in notes),
            calls=tuple(calls),
            waypoints=dict(self.waypoints),
            sent=traffic.sent["say"],
            bytes=traffic.bytes["say"] + traffic.bytes["beacon"],
            rejected=dict(agent.rejected + traffic.refused + self.refused + refused),
            breakers=agent.open_breakers,
            hopeless=None if agent.hopeless is None else agent.hopeless.reason[:MAX_REASON],
            latencies_s=tuple(latencies_s),
            shape=shape,
        )
