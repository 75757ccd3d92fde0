"""Examples for a small model: conversations as a robot has them, each with the answer to learn; and their file."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from llm_flock.arrays import Point
from llm_flock.errors import InputError
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.planner import StepQuestion
from llm_flock_onboard._distill.wishes import Split

Kind: TypeAlias = Literal["plan", "step", "path", "judgement", "mission", "edit", "choice"]

TEAMS: tuple[tuple[str, tuple[int, ...]], ...] = (
    ("triangle", (3,)),
    ("square", (4,)),
    ("cross", (5,)),
    ("circle", (5, 10)),
)
"""Shapes and numbers of places of the teams whose steps are taught; the prompt of a step does not name them."""

HELD_OUT_TEAMS: tuple[tuple[str, tuple[int, ...]], ...] = (("star", (10,)), ("wedge", (3, 5, 7, 8)))
"""Teams of held-out questions for letters, whose centres and spacings differ too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A conversation as the model sees it, pairs of a role and a text, and the answer to learn."""

    kind: Kind
    messages: tuple[tuple[str, str], ...]
    answer: str
    topic: str  #: What it is about, such as the team, `circle 5`.

    @property
    def prompt(self) -> str:
        """All that the model sees."""
        return "\n".join(text for _, text in self.messages)


def draw_mission(rng: np.random.Generator, split: Split, teams: Sequence[tuple[str, tuple[int, ...]]]) -> Mission:
    """Draw a mission; centres and spacings of the two splits come from disjoint intervals."""
    shape, sizes = teams[int(rng.integers(len(teams)))]
    n = int(rng.choice(sizes))
    if split == "train":
        spacing, center = rng.uniform(9.0, 14.0), rng.uniform(30.0, 70.0, 2)
    else:
        spacing, center = rng.uniform(14.5, 18.0), rng.uniform(75.0, 90.0, 2)
    return build_mission(
        shape=shape,
        n_robots=n,
        center=tuple(map(float, center.round(2))),
        spacing=round(float(spacing), 2),
        max_step=float(rng.choice([4.0, 5.0, 6.0, 6.0, 6.0, 7.0])),
        arena=((-200.0, -200.0), (300.0, 300.0)),
    )


def draw_step(rng: np.random.Generator, mission: Mission) -> StepQuestion:
    """Draw a robot heading for its place, with or without others around it."""
    assert mission.ideal is not None, "only shapes whose points are known are drawn"
    slot = int(rng.integers(mission.n_places))
    goal = mission.ideal[slot]
    # A third of the robots can reach their place, as in a run; the others are near or far.
    share = rng.random()
    distance = (
        rng.uniform(0.0, 1.0) if share < 0.3 else rng.uniform(1.0, 3.0) if share < 0.65 else rng.uniform(3.0, 14.0)
    )
    here = away(goal, distance * mission.max_step, rng.uniform(0.0, 2 * math.pi))
    crowd = int(rng.choice([0, 0, 0, 0, 0, 0, 0, 1, 2, 3]))
    reach = mission.safe_distance, mission.comm_range
    neighbors = tuple(away(here, rng.uniform(*reach), rng.uniform(0.0, 2 * math.pi)) for _ in range(crowd))
    return StepQuestion(
        mission=mission,
        robot=slot,
        round=1,
        position=here,
        neighbors=neighbors,
        plan=Plan.of(mission.ideal),
        slot=slot,
    )


def write_examples(path: Path, examples: Iterable[Example]) -> int:
    """Write examples as JSON lines and return their number; InputError if the file cannot be written."""
    lines = [json.dumps(asdict(example)) + "\n" for example in examples]
    try:
        path.write_text("".join(lines), encoding="utf-8")
    except OSError as error:
        raise InputError("out", str(path), f"a file that can be written ({error.strerror})") from None
    return len(lines)


def read_examples(path: Path) -> list[Example]:
    """Read what `write_examples` wrote; InputError for field `data` if a line is not an example."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("data", str(path), f"a file of examples that can be read ({error})") from None
    examples: list[Example] = []
    for number, line in enumerate(lines, start=1):
        try:
            given = json.loads(line)
            messages = tuple((str(role), str(text)) for role, text in given.pop("messages"))
            examples.append(Example(messages=messages, **given))
        except (TypeError, ValueError, AttributeError, KeyError, RecursionError) as error:
            allowed = f"an example as `distill data` writes it ({error})"
            raise InputError("data", f"{path}, line {number}", allowed) from None
    if not examples:
        raise InputError("data", str(path), "a file with at least one example")
    return examples


def away(point: Point, distance: float, angle_rad: float) -> Point:
    """The point at a distance in a direction of the plane [units]; other coordinates stay."""
    return point[0] + distance * math.cos(angle_rad), point[1] + distance * math.sin(angle_rad), *point[2:]
