"""One robot's decision process: a state machine that takes events and returns effects.

It knows itself and what events told it; there is no clock, no network and no model in here. Every runtime, in one
process or one process a robot, drives this same machine. The table of legal events is in `llm_flock.protocol.events`.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import assert_never

from llm_flock.arrays import Point, moved
from llm_flock.mission import Mission
from llm_flock.protocol.agreement.agreement import Agreement
from llm_flock.protocol.agreement.assignment import AssignmentRule, Claim
from llm_flock.protocol.agreement.consensus import ConsensusRule
from llm_flock.protocol.agreement.exchange import Exchange
from llm_flock.protocol.events import (
    TRANSITIONS,
    AgreementEnded,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    Effect,
    Event,
    HeartbeatDue,
    MissionGiven,
    Note,
    Phase,
    Planned,
    Received,
    RoundBegan,
    Sensed,
    Stopped,
)
from llm_flock.protocol.membership.all_to_all import AllToAll
from llm_flock.protocol.membership.connectivity import ConnectivityRecovery
from llm_flock.protocol.membership.liveness import TIME_OUT, Liveness
from llm_flock.protocol.membership.replanning import Gaps, Replanning
from llm_flock.protocol.membership.waiting import waiting_place
from llm_flock.protocol.messages.channel import Channel, PlainChannel
from llm_flock.protocol.messages.message import BLOCKED, MissionStamp, Provenance
from llm_flock.protocol.motion.pilot import Observation, Pilot
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer
from llm_flock.protocol.signed import signed
from llm_flock.protocol.signed.certificates import Authenticator
from llm_flock.protocol.verification.validator import Validator


class IllegalEvent(AssertionError):
    """The runtime sent an event that the machine does not take in its present phase."""


class Agent:
    """One robot's mind.

    Args:
        robot: own id, 0 .. N-1.
        mission: what the team is asked to do.
        consensus: rule that chooses the plan.
        assignment: rule that chooses the slot.
        shield_on: project every waypoint on the buffered Voronoi cell, and go round what blocks the way.
        noise_bound: largest error of a believed position [units].
        verify: check every plan before it is followed, and every step before it is flown.
        time_out: rounds without a heartbeat after which a robot is taken for dead.
        gaps: what to do about places that nobody is alive to take: report them, or have the plan remade.
        on_event: let the planner give a path, and ask it again only when something unforeseen happens.
        own_clock: the runtime counts heartbeats by `HeartbeatDue`; they are counted with the rounds otherwise.
        authenticator: signs what this robot says and checks what others say; without one nothing is signed.
    """

    def __init__(
        self,
        robot: int,
        mission: Mission,
        consensus: ConsensusRule,
        assignment: AssignmentRule,
        *,
        shield_on: bool,
        noise_bound: float = 0.0,
        verify: bool = False,
        time_out: int = TIME_OUT,
        gaps: Gaps = "report",
        on_event: bool = False,
        own_clock: bool = False,
        authenticator: Authenticator | None = None,
    ) -> None:
        self.robot = robot
        self.phase = Phase.IDLE
        self._own_clock = own_clock
        self._liveness = liveness = Liveness(robot, mission.n_robots, time_out)
        self._replanning = Replanning(robot, liveness, gaps)
        self._validator = validator = Validator(verify=verify, shield_on=shield_on, any_size=gaps == "replan")
        all_to_all = AllToAll(robot, mission.n_robots, enabled=authenticator is None)
        channel: Channel = PlainChannel(robot, mission.n_robots, mission.dim)
        if authenticator is not None:
            channel, assignment = signed(robot, mission, authenticator, liveness, assignment)
        self._agreement = Agreement(
            robot,
            mission,
            consensus,
            assignment,
            validator=validator,
            liveness=liveness,
            replanning=self._replanning,
            all_to_all=all_to_all,
        )
        self._exchange = Exchange(
            robot, self._agreement, validator=validator, liveness=liveness, channel=channel, all_to_all=all_to_all
        )
        self._pilot = Pilot(robot, mission, validator, shield_on=shield_on, noise_bound=noise_bound, on_event=on_event)
        self._connectivity = ConnectivityRecovery(self._agreement, liveness, all_to_all)
        self._scene: Observation | None = None
        self._seen: tuple[int, RoundBegan | Sensed] | None = None
        self._asked: PlanQuestion | None = None
        self._asked_about: object = None

    @property
    def position(self) -> Point:
        """Where it believes it is [units; world frame]; empty before the first round."""
        return () if self._scene is None else self._scene.position

    @property
    def on_path(self) -> bool:
        """Whether this round's step was foreseen, and nobody asked for it."""
        return self._pilot.on_path

    @property
    def mission(self) -> Mission:
        """The mission in force, as this robot knows it."""
        return self._agreement.mission

    @property
    def mission_counter(self) -> int:
        """How many missions came before it, as this robot knows."""
        return self._agreement.stamp.counter

    @property
    def plan(self) -> Plan | None:
        """The plan it follows, in the frame of the mission: where its places are when the centre is at `center`."""
        return self._agreement.plan

    @property
    def provenance(self) -> Provenance | None:
        """Origin of that plan."""
        return self._agreement.provenance

    @property
    def claim(self) -> Claim:
        """The place it claims in the plan, and all that goes with it."""
        return self._agreement.claim

    @property
    def neighbors(self) -> int:
        """Robots within its radio range, |N_i|."""
        return self._agreement.neighbors

    @property
    def rejected(self) -> Counter[str]:
        """Messages and claims refused on receipt, by reason."""
        return self._exchange.rejected

    @property
    def influence(self) -> float:
        """I_i = |N_i| / N (paper, eq. 1)."""
        return self.neighbors / self.mission.n_robots

    @property
    def goal(self) -> Point | None:
        """Position of the claimed slot at the end of this round [units; world frame]."""
        if self.plan is None or self.claim.slot is None:
            return None
        ahead = () if self._scene is None else self._scene.ahead
        return moved(self.plan.points[self.claim.slot], ahead)

    def handle(self, event: Event) -> list[Effect]:
        """Take one event; return what is to be done about it, in order.

        Raises:
            IllegalEvent: the event is not in TRANSITIONS for the present phase.
        """
        allowed = TRANSITIONS.get((self.phase, type(event)))
        if allowed is None:
            raise IllegalEvent(f"{type(event).__name__} in phase {self.phase}")
        phase: Phase
        effects: list[Effect]
        match event:
            case Received():
                phase, effects = self.phase, self._receive(event)
            case CommRoundBegan():
                phase, effects = self.phase, [Broadcast(self._exchange.broadcast())]
            case CommRoundEnded():
                phase, effects = self._settle()
            case Sensed():
                phase, effects = self.phase, self._look_about(event)
            case HeartbeatDue():
                phase, effects = self.phase, self._begin_period(event.period)
            case MissionGiven():
                phase, effects = self.phase, [self._exchange.give_mission(event.mission, event.authorization)]
            case RoundBegan():
                phase, effects = self._begin(event)
            case Planned():
                phase, effects = Phase.AGREEING, self._take_plan(event.answer)
            case AgreementEnded():
                phase, effects = self._decide()
            case Decided():
                phase, effects = self._take_step(event.answer)
            case Arrived():
                phase, effects = Phase.IDLE, []
            case Stopped():
                phase, effects = Phase.STOPPED, []
            case _:
                assert_never(event)
        assert phase in allowed, f"{type(event).__name__} led from {self.phase} to {phase}"
        self.phase = phase
        return effects

    def _begin(self, event: RoundBegan) -> tuple[Phase, list[Effect]]:
        listening = self._scene is None and event.round > 1 and event.neighbors > 0
        agreement, mission = self._agreement, self.mission
        self._look(event.round, event)
        if not self._own_clock:
            self._begin_period(event.round)
        places = self._replanning.places(mission, agreement.plan, sees_bodies=bool(agreement.bodies))
        if places is None or listening:
            # Who joins a team that is at work hears it out before it proposes a plan of its own.
            return Phase.AGREEING, []
        self._asked = PlanQuestion(
            mission=mission.at(event.round).resized(places),
            robot=self.robot,
            round=event.round,
            position=event.position,
            neighbors=event.observed,
            still=agreement.bodies,
        )
        self._asked_about = self._topic[:2]
        return Phase.PLANNING, [AskPlan(self._asked)]

    @property
    def _topic(self) -> tuple[MissionStamp, Plan | None, int | None]:
        """What questions are about: an answer is of use as long as this is the same."""
        return self._agreement.stamp, self.plan, self.claim.slot

    def _begin_period(self, number: int) -> list[Effect]:
        """Count a heartbeat, look who is alive, and greet who is near."""
        assert self._seen is not None, "a robot looks before it greets"
        agreement, event = self._agreement, self._seen[1]
        reach = self.mission.comm_range
        near = frozenset(j for j, x in event.sensed.items() if math.dist(x, event.position) <= reach)
        self._liveness.begin_round(number, near)
        agreement.begin_round(event.neighbors)
        self._exchange.begin_round(near)
        self._replanning.watch(
            agreement.mission, agreement.plan, agreement.claim.table, may_shrink=self._connectivity.given_up
        )
        return []

    def _look_about(self, event: Sensed) -> list[Effect]:
        """Another look, in whatever phase; a step that is being decided on is flown from what is seen now."""
        self._look(1 if self._scene is None else self._scene.round, event)
        if self.phase is Phase.DECIDING and self._scene is not None:
            self._pilot.look(self._scene)
        return []

    def _settle(self) -> tuple[Phase, list[Effect]]:
        """Decide on what was heard. A step in question whose plan or place has changed by that is asked for anew."""
        notes: list[Effect] = [*self._agreement.settle(self._exchange.drain())]
        if self.phase is not Phase.DECIDING or self._topic == self._asked_about:
            return self.phase, notes
        phase, effects = self._decide()
        return phase, [*notes, Note("stale_question", {"about": "step"}), *effects]

    def _take_step(self, answer: StepAnswer | NoAnswer) -> tuple[Phase, list[Effect]]:
        """Fly what was answered, unless the answer is about a mission, plan or place of before."""
        if self._topic == self._asked_about:
            return Phase.MOVING, self._pilot.take(answer)
        phase, effects = self._decide()
        return phase, [Note("stale_answer", {"about": "step"}), *effects]

    def _look(self, number: int, event: RoundBegan | Sensed) -> None:
        """See the world of this round, and see it again from the frame of a mission that has come up since."""
        mission = self.mission
        moving = mission.velocity is not None
        self._scene = scene = Observation(
            round=number,
            position=event.position,
            sensed=event.sensed,
            observed=event.observed,
            drift=mission.drift(number - 1) if moving else (),
            ahead=mission.drift(number) if moving else (),
        )
        self._seen = number, event
        sensed = {j: scene.seen(x) for j, x in event.sensed.items()} if moving else event.sensed
        self._agreement.sense(scene.here, sensed)

    def _receive(self, event: Received) -> list[Effect]:
        before = self.mission
        notes: list[Effect] = [*self._exchange.receive(event.payload, event.sender)]
        if self.mission is not before and self._seen is not None:
            self._look(*self._seen)
        return notes

    def _take_plan(self, answer: PlanAnswer | NoAnswer) -> list[Effect]:
        """A proposal of one's own; what the planner sees in the world is kept in the frame of the mission."""
        assert self._asked is not None and self._scene is not None, "only a robot that asked is answered"
        if self._topic[:2] != self._asked_about:
            return [Note("stale_answer", {"about": "plan"})]
        answer, ahead = self._validator.plan(self._asked, answer), self._scene.ahead
        if isinstance(answer, PlanAnswer) and ahead:
            answer = replace(answer, plan=Plan.of(moved(x, ahead, -1.0) for x in answer.plan.points))
        return [*self._agreement.propose(answer)]

    def _decide(self) -> tuple[Phase, list[Effect]]:
        scene, plan, slot = self._scene, self.plan, self.claim.slot
        assert scene is not None, "a round has begun"
        effects, target, idle = list[Effect](), None, None
        if plan is None:
            idle = "no plan yet"
        elif slot is None:
            # A place of its own has nobody to wait at; with a formation that travels a spare travels along.
            others = [scene.seen(x) for x in scene.sensed.values()]
            blocked = [a for a, (_, _, owner) in enumerate(self.claim.table or ()) if owner == BLOCKED]
            target = waiting_place(self.mission, scene.here, plan, others, blocked)
            idle = "every place is taken by others" if target == scene.here and not scene.ahead else None
        else:
            target, notes = self._connectivity.where_to(scene.here, plan, slot)
            effects.extend(notes)
        if plan is None or idle is not None:
            self._pilot.forget()
            return Phase.MOVING, [*effects, *self._pilot.hold(scene, "no_goal", idle or "")]
        told = self.mission.at(scene.round).resized(len(plan))
        self._asked_about = self._topic
        effects.extend(self._pilot.decide(scene, told, plan, slot, target))
        return (Phase.DECIDING if isinstance(effects[-1], AskStep) else Phase.MOVING), effects
