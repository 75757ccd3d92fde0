"""From question to proposal: a robot asks its model for a plan, checks the answer, and proposes it to the team."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from llm_flock.events import AskPlan, Note, RoundBegan
from llm_flock.message import MissionStamp
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion
from llm_flock.protocol._agreement.agreement import Agreement
from llm_flock.protocol._breaker import BreakerState, CircuitBreaker, Fallback, fallback_notes
from llm_flock.protocol._parts import Parts


class Proposals:
    """The plans that one robot proposes. Call `ask` once a round, and `take` with the answer."""

    def __init__(self, robot: int, agreement: Agreement, parts: Parts, fallback: Fallback) -> None:
        self.breaker = CircuitBreaker("plan", enabled=fallback != "hold")
        self._robot = robot
        self._agreement, self._membership, self._verifier = agreement, parts.membership, parts.verifier
        self._fallback: Fallback = fallback
        self._asked: PlanQuestion | None = None
        self._asked_about: tuple[MissionStamp, Plan | None] | None = None

    @property
    def hopeless(self) -> NoAnswer | None:
        """The rejection of the model's last plan; None with a plan, or while the model is still asked for one."""
        breaker = self.breaker
        return breaker.reason if self._agreement.plan is None and breaker.is_open and breaker.refusals else None

    def ask(self, event: RoundBegan) -> list[AskPlan | Note]:
        """Notes, and last the question for this round. None is asked if no plan is needed, or geometry answers."""
        agreement, mission = self._agreement, self._agreement.terrain
        places = self._membership.places(agreement)
        if places is None and agreement.owes_proposal and agreement.plan is not None:
            places = len(agreement.plan)
        if places is None or not agreement.may_propose(places):
            return []
        self._asked = PlanQuestion(
            mission=mission.at(event.round).resized(places),
            robot=self._robot,
            round=event.round,
            position=event.position,
            neighbors=event.observed,
            still=agreement.bodies,
        )
        self._asked_about = self._topic
        if not self.breaker.asks(event.round):
            failure = self.breaker.reason
            assert failure is not None, "an open breaker has a reason"
            return [*self._plan_by_geometry(self._asked, failure)]
        if self.breaker.state is BreakerState.HALF_OPEN:
            self._asked = replace(self._asked, probe=True)
        return [AskPlan(self._asked)]

    def take(self, answer: PlanAnswer | NoAnswer) -> list[Note]:
        """Propose the model's answer, or say why there is none."""
        assert self._asked is not None, "only a robot that asked is answered"
        if self._topic != self._asked_about:
            return [Note("stale_answer", {"about": "plan"})]
        checked = self._verifier.plan(self._asked, answer)
        if isinstance(checked, PlanAnswer):
            return [*self.breaker.usable(), *self._propose(self._asked, answer, checked, checked.by)]
        notes = [self._agreement.lack_plan(checked), *self.breaker.refused(self._asked.round, checked)]
        return [*notes, *self._plan_by_geometry(self._asked, checked)]

    @property
    def _topic(self) -> tuple[MissionStamp, Plan | None]:
        """The subject of a question. Its answer is useful as long as mission and plan stay the same."""
        return self._agreement.stamp, self._agreement.plan

    def _plan_by_geometry(self, question: PlanQuestion, failure: NoAnswer) -> list[Note]:
        """Propose geometry's plan in place of the model's, if geometry stands in for whole plans."""
        if self._fallback != "geometry":
            return []
        from llm_flock.protocol._geometry import geometric_plan

        answer = geometric_plan(question)
        checked = self._verifier.plan(question, answer)
        if isinstance(checked, NoAnswer):
            return []
        notes = fallback_notes("plan", "geometry", failure)
        return [*notes, *self._propose(question, answer, checked, "geometry")]

    def _propose(
        self, question: PlanQuestion, asked: PlanAnswer | NoAnswer, plan: PlanAnswer, by: Literal["model", "geometry"]
    ) -> list[Note]:
        """Propose a plan that passed its checks, as asked or enlarged."""
        given = asked.plan if isinstance(asked, PlanAnswer) else plan.plan
        enlarged = [] if given == plan.plan else [Note("enlarged", {"asked": given.digest})]
        return [*enlarged, *self._agreement.propose(self._in_frame(question, plan), by)]

    def _in_frame(self, question: PlanQuestion, answer: PlanAnswer) -> PlanAnswer:
        mission = self._agreement.mission
        if mission.velocity is None:
            return answer
        return replace(answer, plan=answer.plan.mapped(tuple(-x for x in mission.drift(question.round))))
