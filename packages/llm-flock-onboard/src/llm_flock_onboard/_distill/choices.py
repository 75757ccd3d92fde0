"""Questions for one letter, to teach and to measure (`llm.letters`). A rule derives the right answer from the wish."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, get_args

import numpy as np

from llm_flock.arrays import Point
from llm_flock.errors import ModelError
from llm_flock.llm import (
    LETTER_TOKENS,
    Call,
    CallSettings,
    ChatMessage,
    LanguageModel,
    Letter,
    LetterWay,
    ModelPool,
    PromptSet,
    Room,
    read_letter,
    ways_of,
    ways_text,
)
from llm_flock.mission import Mission, build_mission
from llm_flock.obstacles import Obstacle
from llm_flock.planner import StepQuestion
from llm_flock_onboard._distill.examples import HELD_OUT_TEAMS, TEAMS, Example, draw_mission, draw_step
from llm_flock_onboard._distill.wishes import BESIDE, BESIDE_SHARE, WORDINGS, Split, Wish

NEIGHBORS: Mapping[Split, tuple[int, ...]] = {"train": (0, 1, 2, 2, 4), "held-out": (3, 5)}
"""Numbers of robots around."""

DISTANCES: Mapping[Split, tuple[float, float]] = {"train": (0.3, 60.0), "held-out": (60.0, 100.0)}
"""How far away goals are [step limits]."""

OBSTACLES = 0.3
"""Share of questions with an obstacle near: a disc is taught, a square is held out."""

DROPPED = 0.15
"""Share of questions from which one way is taken, as a run takes one that the checks refused."""

DECIDED = 0.3
"""Share that is kept of the questions whose wish changes nothing: most say nothing about reading."""

WAYS: Mapping[Wish, Letter] = {"slow": "H", "left": "L", "right": "R", "yield": "W"}
"""The way that a wish asks for, where it asks for one."""

LETTERS: tuple[Letter, ...] = get_args(Letter)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A question with its ways in the order in which they are shown; `right` is the letter to answer."""

    question: StepQuestion
    wish: Wish
    words: str
    ways: tuple[LetterWay, ...]
    right: Letter

    @property
    def user(self) -> str:
        """The question as a run with the prompts `letters` asks it, of these ways."""
        return f"Wish: {self.words}\n{ways_text(self.ways)}"

    def example(self) -> Example:
        """The question with its answer, to learn from."""
        mission = self.question.mission
        team = f"{mission.shape} {mission.n_places}"
        messages = ("system", system_message()), ("user", self.user)
        return Example(kind="choice", messages=messages, answer=self.right, topic=team)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChoiceFigures:
    """Results of questions for a letter: shares of answers that begin with a letter and of right ones, also by wish."""

    asked: int
    parsed: float
    right: float
    by_wish: Mapping[str, float]


def right_letter(ways: Sequence[LetterWay], wish: Wish) -> Letter:
    """The right answer: the way that the wish asks for if it is open, else the first.

    To keep clear is to take the way with most room, the first of them; standing still is no way.
    """
    if wish == "clear":
        moving = [way for way in ways if way.letter != "W"] or ways
        return max(moving, key=lambda way: get_args(Room).index(way.room)).letter
    asked = WAYS.get(wish)
    open_to_it = [way for way in ways if way.letter == asked]
    return open_to_it[0].letter if open_to_it else ways[0].letter


def draw_choices(seed: int, split: Split) -> Iterator[Choice]:
    """Draw questions without end; wishes come equally often before some are left out."""
    rng = np.random.default_rng([seed, split == "train", 4])
    teams, wishes = TEAMS if split == "train" else HELD_OUT_TEAMS, tuple(WORDINGS)
    while True:
        ways = list(ways_of(question := _draw_question(rng, split, teams), wait=rng.random() > 0.2))
        if len(ways) > 2 and rng.random() < DROPPED:
            del ways[int(rng.integers(len(ways)))]
        if len(ways) < 2:
            continue
        wish = wishes[int(rng.integers(len(wishes)))]
        sentence = _draw(rng, WORDINGS[wish][split])
        if rng.random() < BESIDE_SHARE:
            both = [sentence, _draw(rng, BESIDE[split])]
            sentence = " ".join(both if rng.random() < 0.5 else both[::-1])
        right = right_letter(ways, wish)
        if wish == "far" or right != right_letter(ways, "far") or rng.random() < DECIDED:
            yield Choice(question=question, wish=wish, words=sentence, ways=tuple(ways), right=right)


def choice_examples(seed: int, count: int, split: Split) -> Iterator[Example]:
    """Make `count` examples of questions for a letter."""
    return (choice.example() for choice in itertools.islice(draw_choices(seed, split), count))


@lru_cache(maxsize=1)
def system_message() -> str:
    """The system message of the prompts `letters`: the same for all missions."""
    return PromptSet.load("letters").system(build_mission())


def measure_choices(model: str, count: int, seed: int = 0) -> ChoiceFigures:
    """Ask a model `count` held-out questions, without a grammar."""
    choices = list(itertools.islice(draw_choices(seed, "held-out"), count))
    letters = asyncio.run(_ask(model, choices, seed))
    hits: dict[str, list[bool]] = {wish: [] for wish in WORDINGS}
    for choice, letter in zip(choices, letters, strict=True):
        hits[choice.wish].append(choice.right == letter)
    return ChoiceFigures(
        asked=count,
        parsed=sum(letter is not None for letter in letters) / count,
        right=sum(map(sum, hits.values())) / count,
        by_wish={wish: sum(found) / len(found) for wish, found in hits.items() if found},
    )


async def _ask(model: str, choices: Sequence[Choice], seed: int) -> list[str | None]:
    gate = asyncio.Semaphore(4)

    async def one(asked: LanguageModel, choice: Choice) -> str | None:
        messages = ChatMessage("system", system_message()), ChatMessage("user", choice.user)
        async with gate:
            try:
                reply = await asked.ask(
                    Call(robot=choice.question.robot, round=1, kind="step", attempt=0, messages=messages)
                )
            except ModelError:
                return None
        return read_letter(reply.text)

    async with ModelPool() as pool:
        settings = CallSettings(max_tokens=LETTER_TOKENS)
        asked = pool.model(model, rng=np.random.default_rng(seed), settings=settings)
        return list(await asyncio.gather(*(one(asked, choice) for choice in choices)))


def _draw(rng: np.random.Generator, texts: Sequence[str]) -> str:
    return texts[int(rng.integers(len(texts)))]


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
    arena = ((-2000.0, -2000.0), (2000.0, 2000.0))
    obstacles = (_draw_obstacle(rng, split, here, course, mission.safe_distance),) if rng.random() < OBSTACLES else ()
    # Valid in all that ways look at; the whole mission, with a way round every obstacle, is not needed.
    fields: dict[str, Any] = {name: getattr(mission, name) for name in Mission.model_fields}
    fields |= {"obstacles": obstacles, "arena": arena}
    mission = Mission.model_construct(**fields)
    return replace(question, mission=mission, position=here, neighbors=tuple(others), horizon=1)


def _draw_obstacle(rng: np.random.Generator, split: Split, here: Point, course: float, safe: float) -> Obstacle:
    """A disc or a square beside the way, its edge at least a body radius away from the robot."""
    radius, angle = rng.uniform(0.5, 2.0) * safe, course + rng.normal(0.0, 1.0)
    away = radius * (1.0 if split == "train" else math.sqrt(2)) + rng.uniform(0.6, 2.5) * safe
    x, y = here[0] + away * math.cos(angle), here[1] + away * math.sin(angle)
    if split == "train":
        return Obstacle(center=(x, y), radius=radius)
    corners = ((x - radius, y - radius), (x + radius, y - radius), (x + radius, y + radius), (x - radius, y + radius))
    return Obstacle(polygon=corners)
