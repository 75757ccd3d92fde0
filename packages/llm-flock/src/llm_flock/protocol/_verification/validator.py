"""One robot's checks: of plans before it follows or forwards them, and of waypoints before its shield sees them."""

from __future__ import annotations

from dataclasses import replace

from llm_flock.errors import InputError
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._parts import Checker
from llm_flock.protocol._verification.plans import check_plan, check_proposal, enlarged, plan_class
from llm_flock.protocol._verification.steps import Verdict, judge


class Validator(Checker):
    """Checks plans and steps; waypoints that only lack separation are left to a shield, and plans may be smaller."""

    verify: bool = True

    def __init__(self, *, shield_on: bool, any_size: bool = False) -> None:
        super().__init__(any_size=any_size)
        self._shield_on = shield_on
        self._last: tuple[Mission | None, Plan | None, int] = None, None, 0

    def objection(self, mission: Mission, plan: Plan | None) -> str | None:
        """The reason to reject a plan, or None. Call before a plan is adopted or forwarded."""
        return check_plan(self._standard(mission, plan), plan) if plan is not None else None

    def plan_class(self, mission: Mission, plan: Plan | None) -> int:
        """The plan's class in the total order of plans."""
        if plan is None:
            return 0
        if self._last[0] is not mission or self._last[1] is not plan:  # most neighbours follow the same plan
            self._last = mission, plan, int(plan_class(self._standard(mission, plan), plan))
        return self._last[2]

    def _standard(self, mission: Mission, plan: Plan) -> Mission:
        """The mission against which a plan is checked: unchanged, or resized for a smaller team."""
        smaller = self.any_size and len(plan) < mission.n_places
        return (resized(mission, len(plan)) if smaller else None) or mission

    def plan(self, question: PlanQuestion, answer: PlanAnswer | NoAnswer) -> PlanAnswer | NoAnswer:
        """The answer, enlarged if rounding put places too near; or the reason to reject its plan."""
        if not isinstance(answer, PlanAnswer):
            return answer
        mission, still, here = question.mission, question.still, question.position
        objection = check_proposal(mission, answer.plan, still, here)
        if objection is not None:
            return NoAnswer(cause="unverified", reason=objection)
        plan = enlarged(mission, answer.plan)
        return answer if check_proposal(mission, plan, still, here) is not None else replace(answer, plan=plan)

    def judge(self, question: StepQuestion, answer: StepAnswer) -> Verdict:
        """The verdict of the checks on the planner's answer."""
        return judge(question, answer, shield_on=self._shield_on)


def resized(mission: Mission, places: int) -> Mission | None:
    """The mission for a plan of another size; None if its shape does not exist in that size."""
    try:
        return mission.resized(places)
    except InputError:
        return None
