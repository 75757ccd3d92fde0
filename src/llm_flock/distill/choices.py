"""Questions that are answered with one letter: code computes the ways to go, a model chooses by the mission's wish.

A robot may go straight on, half as far, round to the left or right, or wait. Code says for each way how far it gets and
how near the nearest robot then is, so a model computes no number. It has to read the wish. Ways stand in random order.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np

from llm_flock.arrays import Point
from llm_flock.distill.examples import HELD_OUT_TEAMS, TEAMS, Example, Split, draw_mission, draw_step
from llm_flock.errors import ModelError
from llm_flock.llm.models import ModelPool
from llm_flock.llm.port import Call, CallSettings, ChatMessage, LanguageModel
from llm_flock.protocol.planning import StepQuestion

WayName: TypeAlias = Literal[
    "straight on", "straight on, half as far", "round to the left", "round to the right", "wait"
]
Wish: TypeAlias = Literal["far", "left", "right", "clear", "yield"]

LETTERS = "ABCDE"

ROUND_DEGREES = 50.0
"""Angle between a way round and the way to the goal [degrees]."""

MARGIN = 0.05
"""Smallest lead of the right way, in what it is chosen by: a closer question has no clear answer, and is left out."""

CHOICES = 6000
"""Number of examples of the recipe: `distill data --choices`."""

MOST_TOKENS = 4
"""Longest answer [tokens]: a letter, and room to see that a model would not stop after it."""

AT_ONCE = 4
"""Questions asked at once."""

WORDINGS: Mapping[Wish, Mapping[Split, tuple[str, ...]]] = {
    "far": {
        "train": (
            "Get as far as you safely can.",
            "Lose no time.",
            "Be quick.",
            "Go as far as possible.",
            "We are late.",
        ),
        "held-out": ("Hurry.", "Make the most of this step."),
    },
    "left": {
        "train": (
            "Prefer to pass on the left.",
            "Go round on the left.",
            "Keep left.",
            "If you can, take the left side.",
        ),
        "held-out": ("Swing out to the left where it is safe.", "The left side is preferred."),
    },
    "right": {
        "train": (
            "Prefer to pass on the right.",
            "Go round on the right.",
            "Keep right.",
            "If you can, take the right side.",
        ),
        "held-out": ("Swing out to the right where it is safe.", "The right side is preferred."),
    },
    "clear": {
        "train": ("Move, but stay far from others.", "Come forward with much room.", "Advance with the widest gap."),
        "held-out": ("Make way towards the goal and give the others plenty of space.",),
    },
    "yield": {
        "train": (
            "Let robot 3 go first.",
            "Robot 5 has priority.",
            "Give way to robot 2.",
            "Stay until robot 7 has passed.",
        ),
        "held-out": ("Robot 4 comes before you.", "Do not move before robot 6 does."),
    },
}
"""What a mission may wish, in words. No held-out wording is taught."""

NEIGHBORS: Mapping[Split, tuple[int, ...]] = {"train": (0, 1, 2, 4), "held-out": (3, 5)}
"""Numbers of robots around."""

DISTANCES: Mapping[Split, tuple[float, float]] = {"train": (1.2, 60.0), "held-out": (60.0, 100.0)}
"""How far away goals are [step limits]."""

SYSTEM = (
    "You choose how a robot moves. Never come too close to another. Fulfil the wish if that is safe, "
    "else get as far as is safe. Answer with one letter."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LetterWay:
    """One way to go.

    Attributes:
        waypoint: where it ends [units; frame of the question].
        progress: how much nearer the goal is then [step limits].
        gap: smallest distance to another robot on the way [safe distances]; infinite with nobody around.
    """

    name: WayName
    waypoint: Point
    progress: float
    gap: float

    @property
    def safe(self) -> bool:
        """Whether the way keeps the safe distance."""
        return self.gap >= 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A question with its ways in the order of their letters; `right` is the letter to answer."""

    question: StepQuestion
    wish: Wish
    words: str
    ways: tuple[LetterWay, ...]
    right: str

    @property
    def user(self) -> str:
        """The question as a model sees it, without the rules of `SYSTEM`."""
        steps = math.dist(self.question.position, self.question.goal) / self.question.mission.max_step
        lines = [f"Goal: {steps:.0f} steps away. Robots around: {len(self.question.neighbors)}. Wish: {self.words}"]
        return "\n".join(lines + [f"{a}: {_way_text(way)}" for a, way in zip(LETTERS, self.ways, strict=True)])

    def example(self) -> Example:
        """The question with its answer, to learn from."""
        mission = self.question.mission
        team = f"{mission.shape} {mission.n_places}"
        return Example(kind="choice", system=SYSTEM, user=self.user, answer=self.right, team=team)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChoiceFigures:
    """Results of questions for a letter.

    Attributes:
        asked: number of questions.
        distinct: number of different prompts among them.
        taught: number of these different prompts that the recipe teaches.
        parsed: share of answers that begin with a letter of the question.
        right: share of right answers.
        safe: share of answers that keep the safe distance; an answer that cannot be read does not count.
        by_wish: share of right answers for each wish that was asked.
    """

    asked: int
    distinct: int
    taught: int
    parsed: float
    right: float
    safe: float
    by_wish: Mapping[str, float]


def ways_of(question: StepQuestion) -> tuple[LetterWay, ...]:
    """The five ways of a robot in the plane, always in the same order."""
    here, goal, limit = question.position, question.goal, question.mission.max_step
    course = math.atan2(goal[1] - here[1], goal[0] - here[0])
    full, turn = min(limit, math.dist(here, goal)), math.radians(ROUND_DEGREES)
    ends: tuple[tuple[WayName, float, float], ...] = (
        ("straight on", full, 0.0),
        ("straight on, half as far", full / 2, 0.0),
        ("round to the left", full, turn),
        ("round to the right", full, -turn),
        ("wait", 0.0, 0.0),
    )
    ways: list[LetterWay] = []
    for name, length, angle in ends:
        end = here[0] + length * math.cos(course + angle), here[1] + length * math.sin(course + angle)
        gaps = [_distance(other, here, end) / question.mission.safe_distance for other in question.neighbors]
        progress = (math.dist(here, goal) - math.dist(end, goal)) / limit
        ways.append(LetterWay(name=name, waypoint=end, progress=progress, gap=min(gaps, default=math.inf)))
    return tuple(ways)


def right_way(ways: Sequence[LetterWay], wish: Wish) -> LetterWay | None:
    """The way that fulfils the wish where that is safe, else the safe one that gets farthest; None if unclear."""
    safe = [way for way in ways if way.safe]
    wished = {"left": "round to the left", "right": "round to the right", "yield": "wait"}.get(wish)
    for way in safe:
        if way.name == wished:
            return way
    if wish == "clear":
        return _leader([way for way in safe if way.name != "wait"], lambda way: min(way.gap, 99.0))
    return _leader(safe, lambda way: way.progress)


def draw_choices(seed: int, split: Split) -> Iterator[Choice]:
    """Draw questions without end; wishes come equally often before unclear questions are left out."""
    rng = np.random.default_rng([seed, split == "train", 4])
    teams = TEAMS if split == "train" else HELD_OUT_TEAMS
    wishes = tuple(WORDINGS)
    while True:
        question = _draw_question(rng, split, teams)
        wish = wishes[int(rng.integers(len(wishes)))]
        words = WORDINGS[wish][split]
        said = words[int(rng.integers(len(words)))]
        ways = ways_of(question)
        right = right_way(ways, wish)
        order: list[int] = rng.permutation(len(ways)).tolist()
        if right is not None:
            shuffled = tuple(ways[i] for i in order)
            yield Choice(question=question, wish=wish, words=said, ways=shuffled, right=LETTERS[shuffled.index(right)])


def choice_examples(seed: int, count: int, split: Split) -> Iterator[Example]:
    """Make `count` examples of questions for a letter."""
    return (choice.example() for choice in itertools.islice(draw_choices(seed, split), count))


@lru_cache(maxsize=1)
def taught_choices() -> frozenset[str]:
    """The question of every example of the recipe."""
    return frozenset(example.user for example in choice_examples(0, CHOICES, "train"))


def read_letter(text: str) -> str | None:
    """The letter that an answer begins with, None without one."""
    found = re.match(rf"\s*([{LETTERS}])\b", text)
    return found and found[1]


def choice_figures(choices: Sequence[Choice], letters: Sequence[str | None]) -> ChoiceFigures:
    """Compare the letters that were read with the right ones."""
    n, prompts = len(choices), frozenset(choice.user for choice in choices)
    pairs = list(zip(choices, letters, strict=True))
    by_wish: dict[str, float] = {}
    for wish in WORDINGS:
        hits = [choice.right == letter for choice, letter in pairs if choice.wish == wish]
        if hits:
            by_wish[wish] = sum(hits) / len(hits)
    return ChoiceFigures(
        asked=n,
        distinct=len(prompts),
        taught=len(prompts & taught_choices()),
        parsed=sum(letter is not None for letter in letters) / n,
        right=sum(choice.right == letter for choice, letter in pairs) / n,
        safe=sum(letter is not None and choice.ways[LETTERS.index(letter)].safe for choice, letter in pairs) / n,
        by_wish=by_wish,
    )


def measure_choices(model: str, count: int, seed: int = 0) -> dict[str, ChoiceFigures]:
    """Ask a model `count` held-out questions, without a grammar; beside it, programs that read no wish."""
    choices = list(itertools.islice(draw_choices(seed, "held-out"), count))
    rng = np.random.default_rng([seed, 5])
    random = [LETTERS[int(i)] for i in rng.integers(len(LETTERS), size=count)]
    default: list[str | None] = []
    for choice in choices:
        farthest = max((way for way in choice.ways if way.safe), key=lambda way: way.progress)
        default.append(LETTERS[choice.ways.index(farthest)])
    return {
        "choice": choice_figures(choices, asyncio.run(_ask(model, choices, seed))),
        "first_letter": choice_figures(choices, [LETTERS[0]] * count),
        "random_letter": choice_figures(choices, random),
        "farthest_safe": choice_figures(choices, default),
    }


async def _ask(model: str, choices: Sequence[Choice], seed: int) -> list[str | None]:
    gate = asyncio.Semaphore(AT_ONCE)

    async def one(asked: LanguageModel, choice: Choice) -> str | None:
        messages = ChatMessage("system", SYSTEM), ChatMessage("user", choice.user)
        async with gate:
            try:
                reply = await asked.ask(
                    Call(robot=choice.question.robot, round=1, kind="step", attempt=0, messages=messages)
                )
            except ModelError:
                return None
        return read_letter(reply.text)

    async with ModelPool() as pool:
        settings = CallSettings(max_tokens=MOST_TOKENS)
        asked = pool.model(model, robot=0, rng=np.random.default_rng(seed), settings=settings)
        return list(await asyncio.gather(*(one(asked, choice) for choice in choices)))


def _draw_question(
    rng: np.random.Generator, split: Split, teams: Sequence[tuple[str, tuple[int, ...]]]
) -> StepQuestion:
    """A robot on its way, mostly with others ahead of it, none of them within the safe distance."""
    question = draw_step(rng, draw_mission(rng, split, teams))
    mission, goal = question.mission, question.goal
    course, far = rng.uniform(0.0, 2 * math.pi), rng.uniform(*DISTANCES[split]) * mission.max_step
    here = goal[0] - far * math.cos(course), goal[1] - far * math.sin(course)
    others: list[Point] = []
    for _ in range(int(rng.choice(NEIGHBORS[split]))):
        away = rng.uniform(1.05 * mission.safe_distance, mission.max_step + 3 * mission.safe_distance)
        angle = course + rng.normal(0.0, 0.9)
        others.append((here[0] + away * math.cos(angle), here[1] + away * math.sin(angle)))
    return replace(question, position=here, neighbors=tuple(others), horizon=1)


def _leader(ways: Sequence[LetterWay], worth: Callable[[LetterWay], float]) -> LetterWay | None:
    """The way that is worth most, None where another is nearly as good."""
    ranked = sorted(ways, key=worth, reverse=True)
    if not ranked or (len(ranked) > 1 and worth(ranked[0]) - worth(ranked[1]) < MARGIN):
        return None
    return ranked[0]


def _way_text(way: LetterWay) -> str:
    """A way in words; judgements stand beside numbers, so that none needs to be compared with a limit."""
    if way.gap == math.inf:
        room = "nobody near"
    else:
        judged = "too close" if not way.safe else "near" if way.gap < 1.5 else "clear"
        room = f"{judged}, gap {math.floor(100 * way.gap) / 100:.2f}"
    return f"{way.name}, {way.progress:.2f} nearer, {room}"


def _distance(point: Point, start: Point, end: Point) -> float:
    """Distance of a point to a segment in the plane [units]."""
    along = end[0] - start[0], end[1] - start[1]
    square = along[0] ** 2 + along[1] ** 2
    share = ((point[0] - start[0]) * along[0] + (point[1] - start[1]) * along[1]) / square if square else 0.0
    share = max(0.0, min(1.0, share))
    return math.dist(point, (start[0] + share * along[0], start[1] + share * along[1]))
