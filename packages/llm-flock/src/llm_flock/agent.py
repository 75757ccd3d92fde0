"""One robot's decision process: a state machine that takes events and returns effects.

It knows only itself and the content of events: it has no clock, network or model. Every runtime drives this same
machine, whether it runs all robots in one process or one robot per process. `llm_flock.events` has the table of legal
events.
"""

from __future__ import annotations

import math
from collections import Counter
from functools import cached_property
from typing import TYPE_CHECKING, assert_never

from llm_flock import events
from llm_flock.arrays import Point, moved
from llm_flock.events import TRANSITIONS, Effect, Event, Note, Phase
from llm_flock.message import MissionStamp, Provenance
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, StepAnswer
from llm_flock.protocol._agreement.agreement import Agreement
from llm_flock.protocol._agreement.assignment import Claim
from llm_flock.protocol._agreement.messaging import Messaging
from llm_flock.protocol._breaker import CircuitBreaker, Fallback, QuestionKind
from llm_flock.protocol._motion.pilot import Observation, Pilot
from llm_flock.protocol._parts import Parts
from llm_flock.protocol._proposals import Proposals

if TYPE_CHECKING:
    from llm_flock.protocol._agreement.judgement import Judgement
    from llm_flock.protocol._stages import Stages


class IllegalEvent(AssertionError):
    """The runtime sent an event that is not legal in the present phase."""


class Agent:
    """One robot's state machine. Create one per robot, then call `handle` with each event.

    Args:
        robot: own id, 0 .. N-1.
        mission: the first mission; no message changes its limits.
        parts: rules, channel, membership, safety and verifier; null parts where they are left out.
        noise_bound: largest error of a believed position [units].
        on_event: let the planner answer with a path, and ask again only after an unforeseen event.
        fallback: what to do without a usable answer; see `llm_flock.protocol._breaker`.
        judges: ask the planner for judgements after events; see `llm_flock.protocol._agreement.judgement`.
        own_clock: the runtime counts heartbeats with `HeartbeatDue`; otherwise each round counts as one.
    """

    def __init__(
        self,
        robot: int,
        mission: Mission,
        *,
        parts: Parts,
        noise_bound: float = 0.0,
        on_event: bool = False,
        fallback: Fallback = "hold",
        judges: bool = False,
        own_clock: bool = False,
    ) -> None:
        self.robot = robot
        self.phase = Phase.IDLE
        self._own_clock, self._period = own_clock, 0
        self._membership = parts.membership
        self._agreement = Agreement(robot, mission, parts)
        self._judgement = self._new_judgement(parts) if judges else None
        self._messaging = Messaging(robot, self._agreement, parts, self._judgement)
        self._pilot = Pilot(robot, mission, parts, noise_bound=noise_bound, on_event=on_event, fallback=fallback)
        self._proposals = Proposals(robot, self._agreement, parts, fallback)
        self._noise_bound = noise_bound
        self._breakers: dict[QuestionKind, CircuitBreaker] = {
            "plan": self._proposals.breaker,
            "step": self._pilot.breaker,
        }
        self._fallback: Fallback = fallback
        self._scene: Observation | None = None
        self._last_sensed: tuple[int, events.Sensed] | None = None
        self._asked_about: object = None

    @cached_property
    def _stages(self) -> Stages:
        from llm_flock.protocol._stages import Stages  # few missions have stages

        return Stages(self._agreement, self._membership, self._noise_bound)

    def _new_judgement(self, parts: Parts) -> Judgement:
        from llm_flock.protocol._agreement.judgement import Judgement
        from llm_flock.protocol._membership.team import TeamMembership

        assert isinstance(parts.membership, TeamMembership), "only teams that count heartbeats judge"
        return Judgement(self.robot, self._agreement, parts.membership)

    @property
    def position(self) -> Point:
        """Own believed position [units; world frame]; empty before the first round."""
        return () if self._scene is None else self._scene.position

    @property
    def on_path(self) -> bool:
        """Whether this round's step follows the committed path, so the planner was not asked."""
        return self._pilot.on_path

    @property
    def mission(self) -> Mission:
        """The mission in force, as far as this robot knows."""
        return self._agreement.mission

    @property
    def ordered_at(self) -> int:
        """Operator's time of the order for the mission in force, 0 for the first, as far as this robot knows."""
        return self._agreement.stamp.counter

    @property
    def authorization(self) -> bytes:
        """The operator's signature on that order; empty for the first mission, and in teams without keys."""
        return self._messaging.channel.order

    @property
    def open_breakers(self) -> tuple[QuestionKind, ...]:
        """Kinds of questions that its model is not asked, because it gave no usable answers."""
        return tuple(kind for kind, breaker in self._breakers.items() if breaker.is_open)

    @property
    def hopeless(self) -> NoAnswer | None:
        """The rejection of its model's last plan; None if it has a plan, or its model is still asked for one."""
        return self._proposals.hopeless

    @property
    def plan(self) -> Plan | None:
        """The plan it follows [units; frame of the mission, whose centre is at `center`]."""
        return self._agreement.plan

    @property
    def replans(self) -> bool:
        """Whether it will leave that plan, which does not fit the robots that it knows to be alive."""
        return self._membership.replans

    @property
    def provenance(self) -> Provenance | None:
        """Origin of that plan."""
        return self._agreement.provenance

    @property
    def claim(self) -> Claim:
        """The slot it claims in the plan, with bids and offer."""
        return self._agreement.claim

    @property
    def degree(self) -> int:
        """Number of robots within its radio range, |N_i|."""
        return self._agreement.degree

    @property
    def rejected(self) -> Counter[str]:
        """Number of messages and claims rejected on receipt, by reason."""
        return self._messaging.rejected

    @property
    def influence(self) -> float:
        """I_i = |N_i| / N (paper, eq. 1)."""
        return self.degree / self.mission.n_robots

    @property
    def goal(self) -> Point | None:
        """Position of the claimed slot at the end of this round [units; world frame]."""
        if self.plan is None or self.claim.slot is None:
            return None
        ahead = () if self._scene is None else self._scene.ahead
        return moved(self.plan.points[self.claim.slot], ahead)

    def handle(self, event: Event) -> list[Effect]:
        """Take one event; returns the effects to carry out, in order.

        Raises:
            IllegalEvent: the event is not in TRANSITIONS for the present phase.
        """
        allowed = TRANSITIONS.get((self.phase, type(event)))
        if allowed is None:
            raise IllegalEvent(f"{type(event).__name__} in phase {self.phase}")
        phase = self.phase
        effects: list[Effect] = []
        match event:
            case events.Received():
                effects = self._receive(event)
            case events.CommRoundBegan():
                effects = [events.Broadcast(self._messaging.broadcast(self._pilot.course))]
            case events.CommRoundEnded():
                phase, effects = self._settle()
            case events.HeartbeatDue():
                self._begin_period(event.period)
            case events.MissionGiven():
                effects = self._give_mission(event)
            case events.BatteryWeak():
                effects = self._weaken(event.left)
            case events.OrderGiven():
                effects = self._order(event)
            case events.Judged():
                effects = [] if self._judgement is None else [*self._judgement.take(event.answer)]
            case events.RoundBegan():
                phase, effects = self._begin(event)
            case events.Sensed():
                self._sense_between_rounds(event)
            case events.Planned():
                phase, effects = Phase.AGREEING, list[Effect](self._proposals.take(event.answer))
            case events.AgreementEnded():
                phase, effects = self._decide()
            case events.Decided():
                phase, effects = self._take_step(event.answer)
            case events.Arrived():
                phase = Phase.IDLE
            case events.Stopped():
                phase = Phase.STOPPED
            case _:
                assert_never(event)
        assert phase in allowed, f"{type(event).__name__} led from {self.phase} to {phase}"
        self.phase = phase
        return effects

    def _begin(self, event: events.RoundBegan) -> tuple[Phase, list[Effect]]:
        listening = event.degree > 0 and (self._agreement.listens or (self._scene is None and event.round > 1))
        self._sense(event.round, event)
        if not self._own_clock:
            self._begin_period(event.round)
        judgement, effects = self._judgement, list[Effect]()
        if self.mission.then and (stage := self._stages.next(event.round)) is not None:
            effects = self._give_mission(events.MissionGiven(mission=stage, ordered_at=self.ordered_at + 1))
            self._sense(event.round, event)
        if judgement is not None:
            assert self._scene is not None, "a robot looks before it judges"
            effects.extend(judgement.begin_round(event.round, event.position, self._pilot.resting(self._scene)))
        # A robot that joins a working team, or has given up its only plan, listens first, and only then proposes one.
        effects.extend([] if listening else self._proposals.ask(event))
        return (Phase.PLANNING if effects and isinstance(effects[-1], events.AskPlan) else Phase.AGREEING), effects

    @property
    def _topic(self) -> tuple[MissionStamp, Plan | None, int | None]:
        """The subject of a question. Its answer is useful as long as mission, plan and slot stay the same."""
        return self._agreement.stamp, self.plan, self.claim.slot

    def _begin_period(self, number: int) -> None:
        """Count a heartbeat, find silent robots, and greet neighbours."""
        assert self._last_sensed is not None, "a robot looks before it greets"
        self._period = number
        agreement, event = self._agreement, self._last_sensed[1]
        reach = self.mission.comm_range
        near = frozenset(j for j, x in event.sensed.items() if math.dist(x, event.position) <= reach)
        agreement.begin_round(event.degree)
        self._membership.begin_round(number, near, agreement, cannot_fly=self._pilot.breaker.is_open)
        self._messaging.begin_round()

    def _sense_between_rounds(self, event: events.Sensed) -> None:
        """Take sensor values between rounds; a pending step will be flown from these."""
        self._sense(1 if self._scene is None else self._scene.round, event)
        if self.phase is Phase.DECIDING and self._scene is not None:
            self._pilot.look(self._scene)

    def _settle(self) -> tuple[Phase, list[Effect]]:
        """Decide on the messages of a communication round. If plan or slot change, ask for a pending step again."""
        heard = self._messaging.drain()
        notes: list[Effect] = [*self._agreement.settle(heard, void=self._messaging.channel.void(self._agreement.stamp))]
        if self.phase is not Phase.DECIDING or self._topic == self._asked_about:
            return self.phase, notes
        phase, effects = self._decide()
        return phase, [*notes, Note("stale_question", {"about": "step"}), *effects]

    def _take_step(self, answer: StepAnswer | NoAnswer) -> tuple[Phase, list[Effect]]:
        """Fly the answer, unless mission, plan or slot have changed since the question."""
        if self._topic == self._asked_about:
            return Phase.MOVING, self._pilot.take(answer)
        phase, effects = self._decide()
        return phase, [Note("stale_answer", {"about": "step"}), *effects]

    def _sense(self, number: int, event: events.Sensed) -> None:
        """Take sensor values, in the frame of the mission in force."""
        mission = self.mission
        moving = mission.velocity is not None
        self._scene = scene = Observation(
            round=number,
            position=event.position,
            sensed=event.sensed,
            observed=event.observed,
            drift=mission.drift(number - 1) if moving else (),
            ahead=mission.drift(number) if moving else (),
            courses=self._messaging.courses,
            moving=event.moving,
            still=self._agreement.bodies,
            period=self._period if self._own_clock else None,
        )
        self._last_sensed = number, event
        sensed = {j: scene.seen(x) for j, x in event.sensed.items()} if moving else event.sensed
        self._agreement.sense(scene.here, sensed)

    def _give_mission(self, event: events.MissionGiven) -> list[Effect]:
        before = self.mission
        note = self._messaging.give_mission(event)
        if self.mission is not before:
            self._begin_mission()
        return [note]

    def _weaken(self, left: float) -> list[Effect]:
        if self._judgement is not None:
            self._judgement.weaken(left)
        return [Note("battery", {"left": left})]

    def _order(self, given: events.OrderGiven) -> list[Effect]:
        if self._judgement is not None:
            self._judgement.order(given.words, given.round)
        return [Note("order", {"words": given.words})]

    def _receive(self, event: events.Received) -> list[Effect]:
        before = self.mission
        notes: list[Effect] = [*self._messaging.receive(event.payload, event.sender)]
        if self.mission is not before:
            self._begin_mission()
        if self.mission is not before and self._last_sensed is not None:
            self._sense(*self._last_sensed)
        return notes

    def _begin_mission(self) -> None:
        self._pilot.begin_mission()
        if self._judgement is not None:
            self._judgement.begin_mission()
        for breaker in self._breakers.values():
            breaker.begin_mission()

    def _decide(self) -> tuple[Phase, list[Effect]]:
        scene, plan, slot = self._scene, self.plan, self.claim.slot
        membership, agreement = self._membership, self._agreement
        assert scene is not None, "a round has begun"
        if rest := self._pilot.rest(scene):
            return Phase.MOVING, rest
        if self._judgement is not None and (cause := self._judgement.waits) is not None:
            why = "waiting for the team's choice" if cause == "battery" else "waiting as the team chose"
            return Phase.MOVING, self._pilot.hold(scene, cause, why)
        effects, target, idle = list[Effect](), None, None
        unanswered = self._fallback != "hold" and self._proposals.breaker.refusals > 0
        if unanswered if plan is None else membership.lost if slot is None else membership.deserted:
            # Fly where others will look for it: it has no plan, or its knowledge of places or mission is old.
            meeting_point = membership.seek(agreement)
            if meeting_point is not None:
                return Phase.MOVING, self._pilot.seek(scene, self.mission, meeting_point)
        if plan is None:
            idle = "no plan yet: waiting to be found" if unanswered else "no plan yet"
        elif slot is None:
            # A spare robot waits near the formation, and travels along with it.
            target = membership.wait(agreement)
            idle = "every place is taken by others" if target == scene.here and not scene.ahead else None
        else:
            target, agreement.claim, notes = membership.route(agreement)
            effects.extend(notes)
        if plan is None or idle is not None:
            self._pilot.forget()
            return Phase.MOVING, [*effects, *self._pilot.hold(scene, "no_goal", idle or "")]
        mission = agreement.terrain.at(scene.round).resized(len(plan))
        self._asked_about = self._topic
        effects.extend(self._pilot.decide(scene, mission, plan, slot, target))
        return (Phase.DECIDING if isinstance(effects[-1], events.AskStep) else Phase.MOVING), effects
