"""One robot's decision process: a state machine that takes events and returns effects.

It knows itself and what events told it; there is no clock, no network and no model in here. Every runtime, in one
process or one process a robot, drives this same machine. The table of legal events is in `llm_flock.protocol.events`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import assert_never

from llm_flock.arrays import Point, moved
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.protocol.assignment import AssignmentRule, Claim
from llm_flock.protocol.consensus import ConsensusRule
from llm_flock.protocol.events import (
    TRANSITIONS,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    Decided,
    Effect,
    Event,
    MissionGiven,
    MoveTo,
    NegotiationEnded,
    Note,
    Origin,
    Phase,
    Planned,
    Received,
    RoundBegan,
    Stopped,
    TickBegan,
    TickEnded,
)
from llm_flock.protocol.judge import Judge, fallback_notes
from llm_flock.protocol.liveness import TIME_OUT, Liveness
from llm_flock.protocol.messages import Pedigree
from llm_flock.protocol.negotiation import Gaps, Negotiation
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.safety import Safety
from llm_flock.protocol.search import Search, advance
from llm_flock.protocol.waiting import waiting_place


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
    ) -> None:
        self.robot = robot
        self.phase = Phase.IDLE
        self.position: Point = ()
        self._judge = Judge(mission, verify=verify, shield_on=shield_on, any_size=gaps == "remake")
        liveness = Liveness(robot, mission.n_robots, time_out)
        self._talks = Negotiation(robot, mission, consensus, assignment, self._judge, liveness, gaps=gaps)
        self._safety = Safety(robot, mission, noise_bound) if shield_on else None
        self._question: StepQuestion | None = None
        self._round = 0
        self._listening = False
        self._drift: Point = ()  # of the mission's frame now, and at the end of this round
        self._ahead: Point = ()
        self._aim: Point = ()
        self._places = mission.n_places
        self._sensed: Mapping[int, Point] = {}
        self._observed: tuple[Point, ...] = ()
        self._search = Search()

    @property
    def mission(self) -> Mission:
        """The mission in force, as this robot knows it."""
        return self._talks.mission

    @property
    def plan(self) -> Plan | None:
        """The plan it follows, in the frame of the mission: where its places are when the centre is at `center`."""
        return self._talks.plan

    @property
    def pedigree(self) -> Pedigree | None:
        """Origin of that plan."""
        return self._talks.pedigree

    @property
    def claim(self) -> Claim:
        """The place it claims in the plan, and all that goes with it."""
        return self._talks.claim

    @property
    def neighbors(self) -> int:
        """Robots within its radio range, |N_i|."""
        return self._talks.neighbors

    @property
    def rejected(self) -> Counter[str]:
        """Messages refused on receipt, by reason."""
        return self._talks.rejected

    @property
    def influence(self) -> float:
        """I_i = |N_i| / N (paper, eq. 1)."""
        return self.neighbors / self.mission.n_robots

    @property
    def goal(self) -> Point | None:
        """Position of the claimed slot at the end of this round [units; world frame]."""
        if self.plan is None or self.claim.slot is None:
            return None
        return moved(self.plan.points[self.claim.slot], self._ahead)

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
                phase, effects = self.phase, [*self._talks.receive(event.payload)]
            case TickBegan():
                phase, effects = self.phase, [Broadcast(self._talks.broadcast())]
            case TickEnded():
                phase, effects = self.phase, [*self._talks.settle()]
            case MissionGiven():
                counter = self._talks.stamp.counter + 1
                phase, effects = self.phase, [self._talks.take_mission(event.mission, counter)]
            case RoundBegan():
                phase, effects = self._begin(event)
            case Planned():
                phase, effects = Phase.NEGOTIATING, self._take_plan(event.answer)
            case NegotiationEnded():
                phase, effects = self._ask_step()
            case Decided():
                phase, effects = Phase.MOVING, self._move(event.answer)
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
        self._listening = self._round == 0 and event.round > 1 and event.neighbors > 0
        self._round = event.round
        self.position = event.position
        self._sensed = event.sensed
        self._observed = event.observed
        if self.mission.velocity:
            self._drift, self._ahead = self.mission.drift(event.round - 1), self.mission.drift(event.round)
        else:
            self._drift = self._ahead = ()
        talks, reach = self._talks, self.mission.comm_range
        near = frozenset(j for j, x in event.sensed.items() if math.dist(x, event.position) <= reach)
        sensed = {j: moved(x, self._drift, -1.0) for j, x in event.sensed.items()} if self._drift else event.sensed
        talks.begin_round(event.round, moved(event.position, self._drift, -1.0), sensed, near, event.neighbors)
        talks.watch_team(may_shrink=self._search.given_up)
        places = self.mission.n_places if talks.plan is None else talks.remake
        if places is None or self._listening:
            return Phase.NEGOTIATING, []
        self._places = places
        return Phase.PLANNING, [
            AskPlan(
                PlanQuestion(
                    robot=self.robot,
                    round=event.round,
                    position=event.position,
                    neighbors=event.observed,
                    mission=self.mission.at(event.round).resized(places),
                )
            )
        ]

    def _take_plan(self, answer: PlanAnswer | NoAnswer) -> list[Effect]:
        """A proposal of one's own; what the planner sees in the world is kept in the frame of the mission."""
        if isinstance(answer, PlanAnswer) and self._ahead:
            answer = replace(answer, plan=Plan.of(moved(x, self._ahead, -1.0) for x in answer.plan.points))
        return [*self._talks.propose(answer, self._places)]

    def _ask_step(self) -> tuple[Phase, list[Effect]]:
        plan, slot = self.plan, self.claim.slot
        if plan is None:
            return Phase.MOVING, self._hold("no_goal", "no plan yet")
        effects = list[Effect]()
        if slot is None:
            aim = self._waiting_place(plan)
            if aim is None:
                return Phase.MOVING, self._hold("no_goal", "every place is taken by others")
        else:
            effects.extend(self._look_for_others(plan, slot))
            aim = self._search.target
        self._aim = plan.points[slot or 0] if aim is None else aim
        question = StepQuestion(
            robot=self.robot,
            round=self._round,
            position=self.position,
            neighbors=self._observed,
            plan=Plan.of(moved(x, self._ahead) for x in plan.points) if self._ahead else plan,
            slot=slot,
            target=None if aim is None else moved(aim, self._ahead),
            mission=self.mission.at(self._round).resized(len(plan)),
        )
        self._question = question
        return Phase.DECIDING, [*effects, AskStep(question)]

    def _waiting_place(self, plan: Plan) -> Point | None:
        """Where a robot without a place goes to be out of the others' way; None where it may stay.

        In the frame of the mission, as the result: with a formation that travels it travels along.
        """
        here = moved(self.position, self._drift, -1.0)
        others = [moved(x, self._drift, -1.0) for x in self._sensed.values()]
        place = waiting_place(self.mission, here, plan, others)
        return None if place == here and not self._ahead else place

    def _look_for_others(self, plan: Plan, slot: int) -> list[Note]:
        """Begin, continue or end the search for robots that hold the slots known as vacant; note what stays empty."""
        table, talks = self.claim.table, self._talks
        if table is None:
            return []
        before, spacing, live = self._search, self.mission.spacing, talks.liveness
        here = moved(self.position, self._drift, -1.0)
        self._search = advance(
            before,
            position=here,
            plan=plan,
            slot=slot,
            table=table,
            center=self.mission.center,
            spacing=spacing,
            at_goal=math.dist(here, plan.points[slot]) <= AT_GOAL * spacing,
            strangers=len(live.strangers),
            silent=len(live.silent),
        )
        notes = list[Note]()
        vacant = self._search.known[1]
        if bool(before.way) != bool(self._search.way):
            notes.append(Note("search", {"begun": bool(self._search.way), "vacant": list(vacant)}))
        if self._search.given_up and not before.given_up:
            notes.append(Note("gap", {"slots": list(vacant), "silent": sorted(live.silent | live.strangers)}))
        return notes

    def _move(self, answer: StepAnswer | NoAnswer) -> list[Effect]:
        question = self._question
        assert question is not None, "only a robot that asked is answered"
        fit = self._judge.waypoint(question, answer)
        asked = answer.waypoint
        if isinstance(fit, NoAnswer):
            return self._hold(fit.cause, fit.reason, asked)
        failure = answer.instead_of if isinstance(answer, StepAnswer) else None
        notes = fallback_notes("step", "geometry", failure)
        flown, origin = fit, Origin.MODEL
        if self._safety is not None:
            flight = self._safety.step(self.position, self._sensed, fit, self._aim, self._drift)
            flown, origin = flight.waypoint, flight.origin
            notes.extend(flight.notes)
        if origin is Origin.MODEL and flown != asked:  # clipped to the goal or to the step limit
            notes.append(Note("shielded", {"proposed": asked, "flown": flown}))
            origin = Origin.SHIELD
        if failure is not None and origin is not Origin.DETOUR:
            origin = Origin.FALLBACK
        return [*notes, MoveTo(waypoint=flown, proposed=asked, origin=origin)]

    def _hold(self, cause: str, reason: str, asked: Point | None = None) -> list[Effect]:
        """Nothing to do, and why."""
        held = Note("held", {"cause": cause, "reason": reason})
        if self._safety is None:
            return [held, MoveTo(waypoint=self.position, proposed=asked, origin=Origin.HOLD)]
        flight = self._safety.stay(self.position, self._sensed)
        return [held, *flight.notes, MoveTo(waypoint=flight.waypoint, proposed=asked, origin=flight.origin)]
