"""Questions that are answered with one letter: code computes ways to go, a model chooses one by the mission's wish.

For each way, code computes the room to robots, obstacles and walls. It lists the way that gets farthest first. A model
computes no number: it reads the wish and at most five ways, and its letter stands for a waypoint.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from llm_flock.arrays import Point
from llm_flock.errors import AnswerError, InputError
from llm_flock.obstacles import segment_clearance
from llm_flock.planner import StepQuestion
from llm_flock.protocol._verification.steps import blocked, passing, step_faults

Letter: TypeAlias = Literal["S", "H", "L", "R", "W"]
"""Straight on, straight on by half, round to the left, round to the right, wait."""

Room: TypeAlias = Literal["tight", "wide", "free"]

ROOMS: tuple[tuple[float, Room], ...] = ((1.5, "tight"), (2.5, "wide"), (math.inf, "free"))
"""Words for room, each with the gap at which the next word begins [least allowed distances]."""

NO_WISH = "None."  # the wish of a mission that has none
MAX_WISH_LENGTH = 200  # longest wish [characters]: it is part of every question

_LETTER = re.compile(rf"\s*([{''.join(get_args(Letter))}])\b")


@dataclass(frozen=True, slots=True, kw_only=True)
class LetterWay:
    """One way to go."""

    letter: Letter
    waypoint: Point  #: Where it ends [units; frame of the question].
    progress: float  #: How much nearer the goal its end is [step limits].
    #: Smallest distance on the way to anything, as a multiple of the allowed distance; infinite if there is none.
    gap: float

    @property
    def room(self) -> Room:
        """The gap as a word."""
        return next(word for end, word in ROOMS if self.gap < end or end == math.inf)


def ways_of(question: StepQuestion, *, wait: bool | None = None) -> tuple[LetterWay, ...]:
    """The open ways, farthest first: those that the checks of a step accept, and that keep clear all the way.

    Standing still is open only while a robot blocks the straight way, and only in every other round, so that no two
    robots wait for each other without end. `wait` is whether this is such a round; None derives it from robot and
    round. In 3D, ways round turn about the vertical axis. The question is in world coordinates, as the checks are.
    """
    mission, here, goal = question.mission, question.position, question.goal
    distance = math.dist(here, goal)
    share = min(1.0, mission.max_step * (1 - 1e-9) / distance) if distance else 0.0
    course = [share * (g - x) for x, g in zip(here, goal, strict=True)]
    turn = math.radians(50.0)  # between a way round and the way to the goal
    ends: dict[Letter, Point] = {
        "S": goal if share == 1.0 else _from(here, course, 1.0, 0.0),
        "H": _from(here, course, 0.5, 0.0),
        "L": _from(here, course, 1.0, turn),
        "R": _from(here, course, 1.0, -turn),
    }
    may_wait = (question.robot + question.round) % 2 == 0 if wait is None else wait
    if may_wait and blocked(question):
        ends["W"] = here
    ways: list[LetterWay] = []
    for letter, end in ends.items():
        gap = 0.0 if step_faults(question, end) else _gap(question, end)
        if gap >= 1.0:
            progress = (distance - math.dist(end, goal)) / mission.max_step
            ways.append(LetterWay(letter=letter, waypoint=end, progress=progress, gap=gap))
    return tuple(sorted(ways, key=lambda way: -round(way.progress, 9)))


def ways_text(ways: Sequence[LetterWay]) -> str:
    """Ways as a prompt lists them: `S tight, L free`."""
    return ", ".join(f"{way.letter} {way.room}" for way in ways)


def check_wish(wish: str) -> str:
    """A wish without spaces around it; InputError for field `wish` if it is too long or has several lines."""
    short = wish.strip()
    if len(short) > MAX_WISH_LENGTH or not short.isprintable():
        raise InputError("wish", wish, f"one line of at most {MAX_WISH_LENGTH} characters")
    return short


def read_letter(text: str) -> Letter | None:
    """The letter that an answer begins with, None without one."""
    match = _LETTER.match(text)
    return next((letter for letter in get_args(Letter) if match and letter == match[1]), None)


def read_way(text: str, ways: Sequence[LetterWay]) -> LetterWay:
    """The way that an answer chooses; AnswerError, a sentence for the model, if it chooses none of them."""
    letter, letters = read_letter(text), ", ".join(way.letter for way in ways)
    chosen = next((way for way in ways if way.letter == letter), None)
    if chosen is None:
        fault = "it does not begin with a letter" if letter is None else f"{letter} is not among the ways"
        raise AnswerError(f"{fault}; one of {letters} is required.")
    return chosen


def _from(here: Point, course: Sequence[float], length: float, turn: float) -> Point:
    dx, dy, *rest = (length * value for value in course)
    cos, sin = math.cos(turn), math.sin(turn)
    moved = (dx * cos - dy * sin, dx * sin + dy * cos, *rest)
    return tuple(x + d for x, d in zip(here, moved, strict=True))


def _gap(question: StepQuestion, end: Point) -> float:
    """The least of: distance to robots / safe distance, to obstacles / body radius, and 1 + to walls / safe distance.

    A robot that is too near already counts as just far enough, because the checks reject a step towards it.
    """
    mission, here = question.mission, question.position
    low, high = mission.arena
    edge = min(min(x - a, b - x) for a, x, b in zip(low, end, high, strict=True))
    gaps = [1.0 + max(0.0, edge) / mission.safe_distance]
    for other in question.neighbors:
        gap = passing(mission, other, here, end) / mission.safe_distance
        gaps.append(max(gap, 1.0) if mission.separation(other, here) < mission.safe_distance else gap)
    gaps.append(segment_clearance(here, end, mission.obstacles) / mission.body_radius)
    return min(gaps)
