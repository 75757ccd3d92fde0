"""A shape that nobody can check: which consensus rule finds a right drawing, and does the team fly it?

    python -m benchmarks.words [--seeds N] [--jobs J] [--write]

The word is the name of a single-colour icon of `fontawesomefree` (`pip install fontawesomefree==6.6.0`), drawn by the
seed. *Simulated* readers answer with a formation program. A right one draws the word's icon; each simplifies, turns,
stretches and skews it on its own, so no two programs are equal. A wrong one draws another icon: each its own, or all
the same one (`alike`). Ten robots fly. Right: the team forms, on one plan, whose program a right reader wrote.

All drawings can be flown by this team, for a reader has no other answer to give if its plan is refused. The likeness of
shapes was tuned on the half of the icons, by a hash of their names, that is left out here.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from benchmarks import figures

import llm_flock
from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.formation import parse_program
from llm_flock.formation._paths import strokes_of
from llm_flock.llm._port import Call
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.llm._simulated.prompt_reader import PLAN_MARK, read_plan
from llm_flock.plan import Drawing, Plan
from llm_flock.protocol._verification.plans import check_plan

ROBOTS = 10
MISSION = llm_flock.Mission(shape="text:the word", n_robots=ROBOTS, spacing=6.0, comm_range=30.0)
SHARES = (20, 40, 60, 80)  # wrong models of ten robots [per cent]
RULES = ("medoid", "provenance", "influence")
BLOCK = 5  # seeds after which the table is shown
MOST_CORNERS = 150  # of a drawing, so that its program is short enough
CASES: dict[str, dict[str, Any]] = {
    "": {},
    "a third of messages lost": {"loss": 0.3},
    "two robots join in round 5": {"join": "2@5,7@5"},
}


@lru_cache(maxsize=1)
def icons() -> dict[str, list[Points]]:
    """The outlines of half of the solid icons that ten robots can show, by name; y upwards."""
    spec = find_spec("fontawesomefree")
    if spec is None or spec.origin is None:
        raise SystemExit("icons are missing: pip install fontawesomefree==6.6.0")
    folder = Path(spec.origin).parent / "static" / "fontawesomefree" / "svgs" / "solid"
    found: dict[str, list[Points]] = {}
    for path in sorted(folder.glob("*.svg")):
        if hashlib.blake2b(path.stem.encode(), digest_size=1).digest()[0] % 2 == 0:
            continue
        data = path.read_text(encoding="utf-8").partition(' d="')[2].partition('"')[0]
        strokes = [np.array([(z.real, -z.imag) for z in stroke]) for stroke in strokes_of(data) if len(stroke) > 1]
        if strokes and sum(map(len, strokes)) <= 8 * MOST_CORNERS:
            found[path.stem] = strokes
    return found


def drawing(name: str, rng: np.random.Generator) -> str | None:
    """The program of one reader for an icon; None if ten robots cannot show it."""
    strokes = icons()[name]
    width = max(float(np.ptp(np.concatenate(strokes), axis=0).max()), 1e-9)
    angle, (wide, high), skew = math.radians(rng.uniform(-12, 12)), rng.uniform(0.88, 1.12, 2), rng.uniform(-0.1, 0.1)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    tolerance = width * rng.uniform(0.004, 0.015)
    rows: list[list[list[int]]] = []
    for stroke in strokes:
        plain = shapely.get_coordinates(shapely.LineString(stroke).simplify(tolerance))
        moved = plain / width * 200 @ np.array([[wide, 0.0], [skew, high]]) @ turn
        rows.append(moved.round().astype(int).tolist())
    if sum(map(len, rows)) > MOST_CORNERS:
        return None
    try:
        program = parse_program({"draw": [{"points": row} for row in rows]})
        plan = Plan(drawing=Drawing(program.text, ROBOTS, MISSION.spacing, MISSION.center))
        return None if check_plan(MISSION, plan) else program.text
    except InputError:
        return None


class Reader:
    """A *simulated* model that answers a word with a program it was given; its steps are good."""

    simulated = True

    def __init__(self, program: str, seed: int) -> None:
        self._program = program
        self._good = SimulatedModel(parse_profile("ideal"), np.random.default_rng(seed))

    async def ask(self, call: Call) -> Any:
        text = next(message.text for message in reversed(call.messages) if message.role == "user")
        if PLAN_MARK not in text:
            return await self._good.ask(call)
        robot, _ = read_plan(text)
        return json.dumps(
            {"reasoning": "That is how I see it.", "program": json.loads(self._program), "my_plan": robot}
        )


@dataclass(frozen=True, kw_only=True)
class Flown:
    """Whether a team formed one plan, whether a right reader wrote it, and after how many rounds."""

    formed: bool
    right: bool
    rounds: int | None


def readers(seed: int, wrong: int, *, alike: bool) -> tuple[list[str], list[bool]]:
    """A program for each robot, and which of them are right. No two are equal."""
    rng = np.random.default_rng([46, seed])
    names, programs = iter(rng.permutation([*icons()]).tolist()), list[str]()
    word = other = ""
    while len(programs) < ROBOTS - wrong:
        if not programs:
            word = next(names)
        one = drawing(word, rng)
        programs = [*programs, one] if one and one not in programs else programs if one else []
    right = len(programs)
    while len(programs) < ROBOTS:
        other = other if alike and other else next(names)
        one = drawing(other, rng)
        if one and one not in programs:
            programs.append(one)
        elif not one:
            other, programs = "", programs[:right] if alike else programs
    order = rng.permutation(ROBOTS)
    return [programs[k] for k in order], [bool(k < right) for k in order]


def fly(wrong: int, alike: bool, options: dict[str, Any], seed: int) -> list[Flown]:
    """One team by each rule."""
    programs, right = readers(seed, wrong, alike=alike)
    found: list[Flown] = []
    for rule in RULES:
        flown = llm_flock.run(
            MISSION,
            consensus=rule,
            prompts="program",
            start="separated",
            model=[Reader(program, 100 * seed + j) for j, program in enumerate(programs)],
            seed=seed,
            rounds=60,
            trace=False,
            **options,
        )
        followed = {plan.program for plan in flown.plans if plan is not None}
        written = [good for program, good in zip(programs, right, strict=True) if program in followed]
        formed, rounds = flown.summary.formed, flown.summary.rounds_to_formed
        found.append(Flown(formed=formed, right=formed and all(written), rounds=rounds))
    return found


def table(seen: Mapping[tuple[int, bool, str], list[list[Flown]]]) -> list[list[str]]:
    rows = [["Wrong models", "Wrong ones", "Case", *(f"{rule}: right %" for rule in RULES), "medoid: rounds", "Seeds"]]
    for (share, alike, case), flights in seen.items():
        right = [sum(one[k].right for one in flights) for k in range(len(RULES))]
        rounds = sorted(one[0].rounds for one in flights if one[0].rounds is not None)
        row = [f"{share} %", "alike" if alike else "unlike", case, *(f"{100 * k / len(flights):.0f}" for k in right)]
        rows.append([*row, str(rounds[len(rounds) // 2]) if rounds else "never", str(len(flights))])
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--write", action="store_true", help="write docs/data/words.csv as it grows")
    given = parser.parse_args(arguments)
    kinds = [(share, alike, "") for alike in (False, True) for share in SHARES]
    kinds += [(share, False, case) for case in CASES if case for share in (60, 80)]
    seen: dict[tuple[int, bool, str], list[list[Flown]]] = {kind: [] for kind in kinds}
    with ProcessPoolExecutor(given.jobs) as pool:
        for first in range(given.first, given.first + given.seeds, BLOCK):
            for share, alike, case in kinds:
                job = partial(fly, share * ROBOTS // 100, alike, CASES[case])
                seeds = range(first, min(first + BLOCK, given.first + given.seeds))
                seen[share, alike, case] += pool.map(job, seeds)
            rows = table(seen)
            print(*(" | ".join(row) for row in rows), sep="\n", end="\n\n", flush=True)
            if given.write:
                figures.write("words.csv", rows)


if __name__ == "__main__":
    main()
