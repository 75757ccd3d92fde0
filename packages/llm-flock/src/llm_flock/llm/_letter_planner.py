"""A robot's conversation with a model that is asked for one letter: code computes ways and plans, the model chooses."""

from __future__ import annotations

from llm_flock.llm._frame import frame_step
from llm_flock.llm._letters import read_way, ways_of
from llm_flock.llm._planner import LanguagePlanner
from llm_flock.llm._port import AnswerForm
from llm_flock.protocol._geometry import plan_by_geometry, straight_path
from llm_flock.protocol._planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion


class LetterPlanner(LanguagePlanner):
    """A `Planner` whose model chooses among open ways by its letter (`llm.letters`), with the prompts `letters`.

    Plans come from geometry, and say so; so do steps where there is nothing to choose: fewer than two ways are open, or
    the straight one reaches the goal. Otherwise a robot that is to go slowly would halve its last step for ever.
    """

    LETTERS = True

    async def plan(self, question: PlanQuestion) -> PlanAnswer | NoAnswer:
        """The shape in its reference orientation, by geometry."""
        return plan_by_geometry(question)

    async def step(self, question: StepQuestion) -> StepAnswer | NoAnswer:
        """Ask which way to go; its end is the waypoint. A path has one position."""
        ways = ways_of(question)
        if len(ways) < 2 or ways[0].waypoint == question.goal:
            only = ways[0].waypoint if ways else straight_path(question).waypoint
            return StepAnswer(waypoint=only, by="geometry")

        def read(text: str, _: AnswerForm) -> StepAnswer:
            return StepAnswer(waypoint=read_way(text, ways).waypoint)

        asked, letters = frame_step(question, "world"), "".join(way.letter for way in ways)
        return await self._converse("step", asked, self._prompts.step(question), 1, read, self._check_step, letters)
