"""One robot's verification: which plans it follows and forwards, and which waypoints it hands to its shield."""

from __future__ import annotations

from llm_flock.arrays import Point
from llm_flock.errors import InputError
from llm_flock.mission import Mission
from llm_flock.protocol.events import Note
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol.verification.plans import check_plan, check_proposal, plan_class
from llm_flock.protocol.verification.steps import check_step, mended

REMEMBERED = 1024
"""So many refused plans are remembered, to note each of them once."""


class Validator:
    """Checks plans and steps; with verification off it finds nothing wrong with any of them.

    Args:
        mission: what the plans and steps are for.
        verify: whether anything is checked.
        shield_on: whether a waypoint that only lacks separation may be left to the shield.
        any_size: whether a plan may have fewer places than the mission: one that was remade for the live team.
    """

    def __init__(self, mission: Mission, *, verify: bool, shield_on: bool, any_size: bool = False) -> None:
        self.verify = verify
        self.mission = mission
        self._any_size = any_size
        self._shield_on = shield_on
        self._refused: set[str] = set()
        self._last: tuple[Mission, Plan, int] | None = None

    def objection(self, plan: Plan | None) -> str | None:
        """Why this plan may not be followed, or None."""
        return check_plan(self._asked_of(plan), plan) if self.verify and plan is not None else None

    def plan_class(self, plan: Plan | None) -> int:
        """The plan's place in the order of plans; 0 for all of them where nothing is checked."""
        if plan is None or not self.verify:
            return 0
        # Nearly always the plan that all follow: its class is asked for once a message.
        if self._last is None or self._last[0] is not self.mission or self._last[1] is not plan:
            self._last = (self.mission, plan, int(plan_class(self._asked_of(plan), plan)))
        return self._last[2]

    def fitting(self, places: int) -> Mission | None:
        """The mission for a plan of so many places; None where there is no such shape."""
        try:
            return self.mission.resized(places)
        except InputError:
            return None

    def _asked_of(self, plan: Plan) -> Mission:
        """What a plan is measured by: the mission itself, or as it would be for a smaller team."""
        smaller = self._any_size and len(plan) < self.mission.n_places
        return (self.fitting(len(plan)) if smaller else None) or self.mission

    def is_new(self, refused: Plan) -> bool:
        """Whether this refused plan has not been noted yet."""
        if refused.digest in self._refused:
            return False
        if len(self._refused) >= REMEMBERED:
            # Whoever floods the radio with plans may fill the record, but not the memory.
            self._refused.clear()
        self._refused.add(refused.digest)
        return True

    def plan(self, question: PlanQuestion, answer: PlanAnswer | NoAnswer) -> PlanAnswer | NoAnswer:
        """The answer, or why its plan is none."""
        if not isinstance(answer, PlanAnswer) or not self.verify:
            return answer
        objection = check_proposal(question.mission, answer.plan, question.still)
        return answer if objection is None else NoAnswer(cause="unverified", reason=objection)

    def waypoint(self, question: StepQuestion, answer: StepAnswer | NoAnswer) -> Point | NoAnswer:
        """What to aim for: the answer if it is faultless, what clipping makes of it if that helps, or why to hold."""
        asked = answer.waypoint
        if not self.verify:
            return answer.waypoint if isinstance(answer, StepAnswer) else answer
        fit = None if asked is None else mended(question.mission, question, asked, shield_on=self._shield_on)
        if fit is not None:
            return fit
        if isinstance(answer, NoAnswer):
            return answer
        return NoAnswer(cause="unverified", reason=check_step(question.mission, question, answer.waypoint) or "")


def fallback_notes(question: str, by: str, failure: NoAnswer | None) -> list[Note]:
    """What is noted when plain geometry or a neighbour's plan stood in for a planner; nothing where none failed."""
    if failure is None:
        return []
    return [Note("fallback", {"question": question, "by": by, "cause": failure.cause, "reason": failure.reason})]
