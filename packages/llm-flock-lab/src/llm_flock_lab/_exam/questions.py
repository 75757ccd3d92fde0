"""The questions of the exam: their fields, and their form in a file of JSON lines.

A question holds no prompt. Prompts are rendered when it is asked, from the templates that robots use.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, cast

from llm_flock.arrays import Point
from llm_flock.errors import InputError
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.planner import JudgementOption, JudgementQuestion, PlanQuestion, StepQuestion

SECTIONS: Mapping[str, str] = {
    "plan": "a plan of the whole formation: every shape, in the plane and in space, 3 to 30 places",
    "place": "each robot of a team chooses a place, and no two the same",
    "step": "the next position: near, far, others beside the way, walls, obstacles, limits",
    "others": "robots that stand in the way of a step, or on the places of a plan",
    "path": "a path of several positions",
    "retry": "an answer after the reason why the first was refused",
    "agreement": "a step by the team's plan after its own plan was not adopted",
    "mission": "a mission in words as a typed answer: what is flown, a question back, or a refusal",
    "distraction": "a plan of a shape in words with irrelevant, contradictory or hostile text in it",
    "edit": "a formation program changed as words say",
    "judgement": "what to do after a death, a weak battery, a blocked way or an order: one of some options, by a wish",
}
"""The sections, in the order in which they are asked, and what each asks for."""

WRITTEN = {"mission", "edit", "judgement"}
"""The sections whose questions were written or flown, and not generated: there are no private ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """One question; lengths and positions in mission units, world frame."""

    id: str
    section: str
    n: int
    tags: tuple[str, ...] = ()
    distance: float | None = None  # of the goal [step limits]
    mission: Mapping[str, Any] | None = None
    robots: tuple[int, ...] = (0,)  # who is asked; several in `place` only
    position: Point | None = None
    neighbors: tuple[Point, ...] = ()
    still: tuple[Point, ...] = ()
    plan: tuple[Point, ...] = ()  # of the team, for a step
    slot: int | None = None
    corner: Point | None = None
    horizon: int = 1
    first: Mapping[str, Any] | None = None  # refused answer put into the model's mouth (`retry`)
    own: Mapping[str, Any] | None = None  # plan that the model is taken to have proposed (`agreement`)
    meant: str | None = None  # shape that a text describes (`distraction`)
    words: str | None = None
    flying: bool = False  # whether the team flies `mission` when it gets the words
    event: str | None = None  # what has come up (`judgement`)
    options: tuple[Mapping[str, Any], ...] = ()
    wish: str | None = None  # what counts
    wanted: tuple[Mapping[str, Any], ...] = ()  # right answers to words, or the right option

    @property
    def asks_plan(self) -> bool:
        """Whether the question is for a plan, and not for a step, a mission or a judgement."""
        return self.words is None and not self.plan and not self.options

    def build_mission(self) -> Mission:
        assert self.mission is not None, "every question has a mission"
        return build_mission(**self.mission)

    def plan_question(self, mission: Mission, robot: int, round_: int) -> PlanQuestion:
        return PlanQuestion(
            mission=mission,
            robot=robot,
            round=round_,
            position=self.position or mission.center,
            neighbors=self.neighbors,
            still=self.still,
        )

    def step_question(self, mission: Mission, round_: int) -> StepQuestion:
        assert self.position is not None, "a question for a step has a position"
        return StepQuestion(
            mission=mission,
            robot=self.robots[0],
            round=round_,
            position=self.position,
            neighbors=self.neighbors,
            plan=Plan.of(self.plan),
            slot=self.slot,
            corner=self.corner,
            horizon=self.horizon,
        )

    def judgement_question(self, mission: Mission, round_: int) -> JudgementQuestion:
        assert self.event is not None, "a question for a judgement has an event"
        options = tuple(JudgementOption(**option) for option in self.options)
        return JudgementQuestion(mission=mission, robot=self.robots[0], round=round_, event=self.event, options=options)


def to_lines(questions: Iterable[Question]) -> str:
    """JSON lines, without fields that have their default."""
    defaults = {field.name: field.default for field in fields(Question)}
    plain = ({name: value for name, value in asdict(q).items() if value != defaults[name]} for q in questions)
    return "".join(json.dumps(one, separators=(",", ":")) + "\n" for one in plain)


def from_lines(text: str, source: str) -> list[Question]:
    """Questions from JSON lines; `source` names them in errors."""
    found: list[Question] = []
    for number, line in enumerate(text.splitlines(), start=1):
        try:
            found.append(Question(**{name: _frozen(value) for name, value in json.loads(line).items()}))
        except (TypeError, ValueError, AttributeError) as error:
            raise InputError("questions", f"{source}, line {number}", f"a question of the exam ({error})") from None
    return found


def digest(questions: Iterable[Question]) -> str:
    """16 hexadecimal digits that identify a set of questions and their order."""
    return hashlib.blake2b(to_lines(questions).encode(), digest_size=8).hexdigest()


def _frozen(value: Any) -> Any:
    """Lists as tuples, at every depth: a question read from a file equals the one that was written."""
    if isinstance(value, dict):
        return {name: _frozen(part) for name, part in cast("dict[str, Any]", value).items()}
    return tuple(map(_frozen, cast("list[Any]", value))) if isinstance(value, list) else value
