"""What the model on board is taught: plans as formation programs, steps, paths, ways round others, retries, judgements.

python -m benchmarks lessons FILE [COUNT] [SEED] [KIND,KIND,...]

Every question goes through the planner of a run, with its prompts, frame, parsers and checks, and only answers that
these accept at once are taught. What is held out stands in `curriculum.toml`.
"""

from __future__ import annotations

import asyncio
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np

from llm_flock.arrays import Point, between, towards
from llm_flock.llm import Call, LanguagePlanner, PromptSet, Reply, frame_step, place_text
from llm_flock.mission import build_mission
from llm_flock.obstacles import Obstacle, nearest_on_segment
from llm_flock.planner import (
    AIMS,
    JudgementOption,
    JudgementQuestion,
    NoAnswer,
    PlanQuestion,
    StepQuestion,
    best_option,
)
from llm_flock.protocol import HORIZON, check_proposal, judge, step_faults
from llm_flock.record import check_new
from llm_flock_onboard._distill.curriculum import CURRICULUM, plan_mission, taught_teams
from llm_flock_onboard._distill.examples import TEAMS, Example, Kind, away, draw_mission, draw_step, write_examples

REACH = 0.92
"""Length of a full step in step limits: an error of one or two in the last digit stays within the limit."""

SPARE = 1.15
"""Distance to others that a taught step keeps, in safe distances."""

ASIDE = 75
"""Turn of a step round a robot that is near [degrees]."""

HELD_OUT: Sequence[int] = CURRICULUM["plans"]["held_out_sizes"]
"""Numbers of places that no plan has."""

TURNS = (0, 45, 90, 30, 60, 180, 20, 36, 15, 75, 120)
"""Turns of a drawing that are tried, in this order, where a robot stands on a place [degrees]."""

SHARES: Mapping[Kind, float] = {
    "plan": 0.15,
    "step": 0.14,
    "path": 0.02,
    "judgement": 0.14,
    "mission": 0.32,
    "edit": 0.23,
}
"""Kinds of examples."""

PART = 5000
"""Examples that one process draws at a time."""

RETRIED = 0.15
"""Share of questions for plans and steps that are asked after an answer that was refused."""

PROMPTS = PromptSet.load("brief-program")


class _Teacher:
    """A model that gives these answers, and keeps the questions."""

    name = "teacher"

    def __init__(self, texts: Sequence[str]) -> None:
        self.texts, self.calls = texts, list[Call]()

    async def ask(self, call: Call) -> Reply:
        self.calls.append(call)
        return Reply(text=self.texts[min(len(self.calls), len(self.texts)) - 1], model=self.name, cost_usd=0.0)


def taught(
    kind: Kind, asked: PlanQuestion | StepQuestion | JudgementQuestion, *texts: str, wish: str = ""
) -> Example | None:
    """The conversation in which the last of some answers is accepted, and those before are refused; else None."""
    teacher = _Teacher(texts)
    planner = LanguagePlanner(
        asked.robot,
        teacher,
        replace(PROMPTS, wish=wish),
        max_retries=len(texts) - 1,
        check_plan=lambda given, answer: check_proposal(given.mission, answer.plan, given.still, given.position),
        judge=lambda given, answer: judge(given, answer, shield_on=True),
        frame="own",
    )
    if isinstance(asked, JudgementQuestion):
        work: Any = planner.judge(asked)
    else:
        work = planner.plan(asked) if isinstance(asked, PlanQuestion) else planner.step(asked)
    answer = asyncio.run(work)
    if isinstance(answer, NoAnswer) or len(teacher.calls) != len(texts):
        return None
    messages = tuple((message.role, message.text) for message in teacher.calls[-1].messages)
    topic = f"{asked.mission.shape[:40]} {asked.mission.n_places}"
    return Example(kind=kind, messages=messages, answer=texts[-1], topic=topic)


def drawing(shape: str) -> list[dict[str, Any]]:
    """The elements of a program that draws a shape with a name."""
    name, _, sides = shape.partition(":")
    return [{"shape": name, **({"sides": int(sides)} if sides else {})}]


def draw_plan(rng: np.random.Generator) -> Example | None:
    """A plan: of a team with a name, of points, or of a shape in words; some with a robot that stands in the way."""
    share, still = rng.random(), tuple[Point, ...]()
    draw: list[dict[str, Any]]
    if share < 0.25:  # to be copied, digit by digit
        dim = 2 if share < 0.19 else 3
        n = pick(rng, [k for k in range(3, 24 if share < 0.03 else 12 if dim == 2 else 8) if k not in HELD_OUT])
        rows = np.array(_lattice(rng, n, dim)) + rng.choice([0.0, 0.3]) * rng.random((n, dim))
        apart = min(math.dist(a, b) for a, b in combinations(rows.tolist(), 2))
        points = [tuple(10 * float(x) / apart for x in row) for row in rows]
        mission = plan_mission("points", n, points=points, turn=0.0 if rng.random() < 0.3 else None)
        draw = [{"points": [[round(x / mission.spacing, 6) + 0.0 for x in row]]} for row in mission.ideal or ()]
    elif share < 0.6:
        if rng.random() < 0.5:
            text, draw = described(rng)
            n = pick(rng, [k for k in range(4, 31) if k not in HELD_OUT])
        else:
            given = pick(rng, CURRICULUM["texts"]["train"])
            text, draw, n = pick(rng, given["say"]), given["draw"], int(rng.choice(given["sizes"]))
        text += pick(rng, CURRICULUM["beside"]["train"]) if rng.random() < 0.6 else ""
        mission = plan_mission("text:" + text, n)
    else:
        shape, n = pick(rng, taught_teams())
        mission, draw = plan_mission(shape, n), drawing(shape)
        if share > 0.85 and n <= 15:
            assert mission.ideal is not None, "a shape with a name has points"
            still = (tuple(round(x, 2) for x in pick(rng, mission.ideal)),)
    robot = int(rng.integers(n))
    asked = PlanQuestion(
        mission=mission, robot=robot, round=1, position=(0.0,) * mission.dim, neighbors=(), still=still
    )
    wrong = _refused_plan(rng, draw, n) if rng.random() < RETRIED else ()
    for turn in TURNS if still else (0,):
        turned = draw
        if turn:
            turned = [{**draw[0], "turn": turn}] if len(draw) == 1 else [{"union": draw, "turn": turn}]
        said = json.dumps(turned)
        if mission.points:  # as the prompt writes them
            said = re.sub(r"-?\d+\.\d+", lambda found: f"{float(found[0]):.3f}", said)
        right = f'{{"program": {{"draw": {said}}}, "my_plan": {robot}}}'
        found = taught("plan", asked, *wrong, right)
        if found is not None:
            return found
    return None


def described(rng: np.random.Generator) -> tuple[str, list[dict[str, Any]]]:
    """Words for a drawing put together at random, and its elements."""
    names, words = ["circle", "square", "triangle", "polygon:5", "polygon:8", "cross"], CURRICULUM["missions"]["shapes"]
    (one, first), (two, second) = ((name, pick(rng, words[name])) for name in rng.choice(names, 2).tolist())
    (a,), (b,), v = drawing(one), drawing(two), int(rng.integers(2, 5))
    number, size = pick(rng, [("two", 2), ("three", 3), ("four", 4)]), pick(rng, [("twice", 2), ("three times", 3)])
    return pick(
        rng,
        [
            (f"a {first} inside a {second}", [b, {**a, "scale": 0.5}]),
            (f"a {first} around a {second}", [a, {**b, "scale": 0.5}]),
            (f"a {first} above a {second}", [{**a, "move": [0, 1.5]}, {**b, "move": [0, -1.5]}]),
            (f"a {first} below a {second}", [{**a, "move": [0, -1.5]}, {**b, "move": [0, 1.5]}]),
            (f"a {first} on the left, a {second} on the right", [{**a, "move": [-1.5, 0]}, {**b, "move": [1.5, 0]}]),
            (f"a {first} {size[0]} as wide as high", [{**a, "scale": [size[1], 1]}]),
            (f"a {first}, {size[0]} as high as wide", [{**a, "scale": [1, size[1]]}]),
            (f"a {first} turned by {15 * v} degrees", [{**a, "turn": 15 * v}]),
            (f"a {first} filled with robots", [{**a, "fill": True}]),
            (f"{number[0]} of these in a row: a {first}", [{**a, "repeat": {"times": number[1], "move": [3, 0]}}]),
            (f"{number[0]} of these in a column: a {first}", [{**a, "repeat": {"times": number[1], "move": [0, 3]}}]),
            (f"a polygon of {2 * v + 5} sides", [{"shape": "polygon", "sides": 2 * v + 5}]),
        ],
    )


def _refused_plan(rng: np.random.Generator, draw: list[dict[str, Any]], n: int) -> tuple[str]:
    """An answer that no check accepts: coordinates, a place too many, a broken program, or words."""
    kind = rng.random()
    if kind < 0.4:
        rows = [place_text(tuple(map(float, row))) for row in rng.normal(0, 1.5, (min(n, 10), 2)).round(2)]
        return (f"Plan: [{', '.join(rows)}]\nmy plan: {int(rng.integers(n))}",)
    if kind < 0.6:
        return (json.dumps({"program": {"draw": draw}, "my_plan": n}),)
    if kind < 0.8:
        return (json.dumps({"program": {"draw": [{"shape": "blob"}]}, "my_plan": 0}),)
    return (pick(rng, CURRICULUM["unreadable"]["train"]),)


def draw_motion(rng: np.random.Generator, kind: Kind) -> Example | None:
    """A step or a path of one position: straight, or round a robot in the way, also among obstacles and in space."""
    base = draw_mission(rng, "train", TEAMS)
    limit = float(rng.uniform(0.3, 0.8)) * base.spacing
    base = base.change(max_step=round(limit, 2), safe_distance=round(0.3 * base.spacing, 2))
    if rng.random() < 0.08:
        center, arena = (50.0, 50.0, 50.0), ((-300.0,) * 3, (400.0,) * 3)
        base = build_mission(shape="sphere", n_robots=6, center=center, arena=arena, max_step=limit, comm_range=60.0)
    asked = draw_step(rng, base)
    mission, here, goal, safe = base, asked.position, asked.goal, base.safe_distance
    if mission.dim == 3:
        here = (*here[:2], round(goal[2] + float(rng.normal(0.0, 1.5)) * mission.max_step, 2))
    elif rng.random() < 0.08:
        disc = Obstacle(center=away(here, float(rng.uniform(1.0, 3.0)) * limit, rng.uniform(0, 6.28)), radius=safe)
        mission = mission.model_copy(update={"obstacles": (disc,)})
    end, share = towards(here, goal, REACH * mission.max_step), rng.random()
    others = list[Point]()
    if share < 0.6 and kind == "step" and mission.dim == 2:  # in the way
        others = [away(end, float(rng.uniform(0.0, 0.7)) * safe, rng.uniform(0.0, 2 * math.pi))]
    elif share < 0.8:
        for _ in range(int(rng.integers(1, 4))):
            on = tuple(h + float(x) * (e - h) for h, e, x in zip(here, end, [rng.uniform()] * len(end), strict=True))
            other = away(on, float(rng.uniform(1.12, 3.0)) * safe, rng.uniform(0.0, 2 * math.pi))
            if math.dist(nearest_on_segment(other, here, end), other) > 1.1 * safe:
                others.append(other)
    horizon = HORIZON if kind == "path" else 1
    asked = replace(asked, mission=mission, position=here, neighbors=tuple(others), horizon=horizon)
    framed = frame_step(asked, "own")
    assert framed.frame is not None, "the own frame is asked for"
    waypoint = way_round(asked)
    if waypoint is None:
        return None
    text = place_text(framed.frame.rounded(waypoint))
    wrong = tuple[str, ...]()
    if rng.random() < RETRIED:
        far = between(here, end, float(rng.choice([-0.8, 1.4, 2.0, 2.5, 3.0])))
        said = (
            pick(rng, CURRICULUM["unreadable"]["train"])
            if rng.random() < 0.3
            else f"Position: {place_text(framed.frame.rounded(far))}"
        )
        wrong = (said,)
    return taught(kind, asked, *wrong, f"Position: {text}" if horizon == 1 else f"Path: [{text}]")


def way_round(asked: StepQuestion) -> Point | None:
    """The straight step if it is clear with room to spare, else half or a quarter of it, or a turned one; or None.

    Room to spare makes a model's errors harmless: a step that it takes for blocked, or for free, passes either way.
    """
    here, goal, mission = asked.position, asked.goal, asked.mission
    full, course = towards(here, goal, REACH * mission.max_step), math.atan2(goal[1] - here[1], goal[0] - here[0])
    for straight in (full, between(here, full, 0.5)):
        gaps = [math.dist(nearest_on_segment(other, here, straight), other) for other in asked.neighbors]
        if min(gaps, default=math.inf) > SPARE * mission.safe_distance and not step_faults(asked, straight):
            return straight
    quarter = min(mission.max_step, math.dist(here, goal)) / 4
    near = min(asked.neighbors, key=lambda other: math.dist(other, here), default=goal)
    left = (goal[0] - here[0]) * (near[1] - here[1]) - (goal[1] - here[1]) * (near[0] - here[0]) > 0
    for turn in (0, -ASIDE if left else ASIDE, ASIDE if left else -ASIDE):
        waypoint = away(here, quarter, course + math.radians(turn))
        room = min((math.dist(waypoint, other) for other in asked.neighbors), default=math.inf)
        enough = room > (SPARE if turn == 0 else 1.0) * mission.safe_distance
        if enough and math.dist(waypoint, goal) < math.dist(here, goal) and not step_faults(asked, waypoint):
            return waypoint
    return None


def draw_judgement(rng: np.random.Generator) -> Example | None:
    """An event with options of random figures; the right one by an aim of the product, or by a wish in other words."""
    n, robot, spare, share = int(rng.integers(4, 21)), int(rng.integers(10)), int(rng.integers(21)), rng.random()
    replan = f"Make a new plan of {n} places for the robots that are left."
    close = f"Close up: robot {(robot + 1) % 10} leaves its place at the edge and fills the gap."
    if share < 0.4:
        event = f"Robot {robot} has failed, and nobody fills its place."
        says = {"leave": "Leave the place empty.", "close": close, "replan": replan}
    elif share < 0.6:
        left = rng.choice([0.0, rng.uniform(1, 30)])
        event = f"The battery of robot {robot} is weak: it can fly {left:.1f} units at most."
        says = {
            "continue": f"Robot {robot} goes on to its place.",
            "swap": f"Robot {robot} exchanges its place with robot {(robot + 3) % 10}.",
            "spare": f"Robot {robot} gets out of the way, and spare robot {spare} takes its place.",
        }
    elif share < 0.8:
        event = f"An obstacle has come to rest in the way of robot {robot} to its place."
        says = {
            "wait": f"Robot {robot} waits where it is, and its place stays empty.",
            "round": f"Robot {robot} goes round the obstacle to its place.",
            "spare": f"Robot {robot} gives its place to spare robot {spare}.",
            "replan": "Make a new plan of as many places, clear of the obstacle.",
        }
    else:
        event = "The operator has given the team an order in words. It says what counts."
        says = {
            "continue": "Go on as planned.",
            "wait": "All robots wait where they are, until another order.",
            "close": close,
            "replan": replan,
            "spare": f"Robot {robot} gets out of the way, and spare robot {spare} takes its place.",
        }
    options, size = list[JudgementOption](), float(rng.uniform(3, 100))
    ordered, first = share >= 0.8, next(iter(says))  # who waits, or is in place, flies nothing
    for name, does in says.items():
        if name != first and rng.random() > (0.8 if len(says) < 4 else 0.55):
            continue
        moves = name != "wait" and rng.random() < (0.75 if name in ("leave", "continue") else 0.95)
        lost = int(name in ("continue", "swap") and not ordered and rng.random() < 0.6)
        rounds = int(rng.integers(1, 17)) if moves else 0
        flown = round(size * float(rng.uniform(0.4, 2.0)), 1) if moves else 0.0
        gaps = lost
        if name in ("wait", "leave"):
            gaps = int(rng.integers(1, 9)) if ordered else int(name == "wait" or rng.random() < 0.9)
        elif name == "continue" and ordered:
            gaps = int(rng.random() < 0.5)
        fields: Any = {"choice": name, "rounds": rounds, "distance": flown, "gaps": gaps, "lost": lost}
        options.append(JudgementOption(does=does, **fields))
    if len(options) < 2:
        return None
    aim = pick(rng, list(AIMS))
    right, key = best_option(options, aim), AIMS[aim][0]
    wish = aim
    if ordered and rng.random() < 0.3:
        right = pick(rng, options).choice
        wish = pick(rng, CURRICULUM["orders"][right]["train"]).format(i=robot)
    elif rng.random() < 0.6:
        best = min((one.lost, getattr(one, key)) for one in options)
        if sum((one.lost, getattr(one, key)) == best for one in options) > 1:
            return None
        wish = pick(rng, CURRICULUM["wishes"][key]["train"])
    asked = JudgementQuestion(mission=build_mission(), robot=robot % 10, round=1, event=event, options=tuple(options))
    return taught("judgement", asked, f"Choice: {right}", wish=wish)


def lessons(seed: int, count: int, kinds: Sequence[Kind] = tuple(SHARES), part: int = 0) -> Iterator[Example]:
    """Draw `count` examples of some kinds; those of missions and edits are in `lessons_in_words`."""
    from benchmarks.lessons_in_words import draw_edit, draw_request

    rng, made, shares = np.random.default_rng([seed, 7, part]), 0, np.array([SHARES[kind] for kind in kinds])
    draws: Mapping[Kind, Callable[[np.random.Generator], Example | None]] = {
        "plan": draw_plan,
        "step": lambda rng: draw_motion(rng, "step"),
        "path": lambda rng: draw_motion(rng, "path"),
        "judgement": draw_judgement,
        "mission": draw_request,
        "edit": draw_edit,
    }
    while made < count:
        kind = kinds[int(rng.choice(len(kinds), p=shares / shares.sum()))]
        found: Example | None = None
        while found is None:
            found = draws[kind](rng)
        made += 1
        yield found


def pick(rng: np.random.Generator, values: Sequence[Any]) -> Any:
    """One of some values."""
    return values[int(rng.integers(len(values)))]


def _lattice(rng: np.random.Generator, n: int, dim: int) -> list[tuple[float, ...]]:
    """A random connected piece of a lattice: n points, each one spacing from another [spacings]."""
    found: list[tuple[float, ...]] = [(0.0,) * dim]
    while len(found) < n:
        at = list(pick(rng, found))
        at[int(rng.integers(dim))] += float(rng.choice([-1, 1]))
        if tuple(at) not in found:
            found.append(tuple(at))
    return found


def _part(seed: int, count: int, kinds: Sequence[Kind], part: int) -> list[Example]:
    return list(lessons(seed, min(PART, count - part * PART), kinds, part))


def main(arguments: Sequence[str]) -> None:
    """Write a file of examples for `llm-flock distill train`, drawn on all cores; the same on any number of them."""
    if not arguments:
        raise SystemExit("lessons FILE [COUNT] [SEED] [KIND,KIND,...]: the new file is missing")
    count, seed, kinds = (*arguments[1:], *("6000", "1", ",".join(SHARES))[len(arguments) - 1 :])
    chosen: list[Kind] = [kind for kind in SHARES if kind in kinds.split(",")]
    if wrong := {*kinds.split(",")} - {*SHARES}:
        raise SystemExit(f"lessons: {', '.join(sorted(wrong))}: expected some of {', '.join(SHARES)}")
    out, draw = Path(arguments[0]), partial(_part, int(seed), int(count), chosen)
    check_new(out)
    with ProcessPoolExecutor() as pool:
        examples = list(chain(*pool.map(draw, range(-(-int(count) // PART)))))
    write_examples(out, examples)
    for kind in chosen:
        prompts = [example.prompt for example in examples if example.kind == kind]
        print(f"{kind}: {len(prompts)} examples, {len(set(prompts))} prompts")
