"""Conformance tests for shapes, prompt sets and models."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from llm_flock import shapes as formations
from llm_flock.errors import InputError
from llm_flock.llm._port import Answers
from llm_flock.llm._prompt_values import number_text, place_text
from llm_flock.llm._prompting import PromptSet
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanQuestion, StepQuestion
from llm_flock.runtime._api import run
from llm_flock.runtime._config import load_config


def check_shape(shape: str, sizes: Iterable[int] = (), *, fly: bool = True) -> None:
    """Check that a named shape, or `points:FILE`, can be flown and measured.

    For every team size: as many places as robots, all different, around the centre, neighbours at the spacing (a shape
    of points keeps its own distances, none below the safe distance); it grows with the spacing; it has words for the
    prompts; and, unless `fly` is off, a team of stand-ins builds it.

    Args:
        shape: as on the command line: `circle`, `polygon:5`, `points:my-shape.csv`.
        sizes: team sizes; the shape's own examples if left out. Points have one size.
        fly: whether to fly a mission with each size.
    """
    custom = shape.startswith("points:")
    for n in _sizes(shape, sizes):
        given: dict[str, Any] = {"shape": shape} if n is None else {"shape": shape, "n_robots": n}
        dim = 3 if not formations.names_file(shape) and formations.in_space(shape) else 2
        try:
            mission = load_config(
                None, **given, arena=((0.0,) * dim, (1000.0,) * dim), center=(500.0,) * dim, comm_range=1000.0
            ).mission
        except InputError as error:
            team = shape if n is None else f"{shape} with {n} robots"
            raise AssertionError(f"{team} is refused: {error}") from None
        assert mission.ideal is not None, f"{shape} has no ideal places: its error cannot be measured"
        points = np.array(mission.ideal)
        assert points.shape == (mission.n_robots, mission.dim), f"{shape}: {len(points)} places for {n} robots"
        assert np.isfinite(points).all(), f"{shape} has a place that is not finite"
        middle = points.mean(axis=0)
        assert np.allclose(middle, mission.center, atol=1e-6), f"{shape} of {n} is centred at {middle.tolist()}"
        _check_distances(shape, mission, points, custom=custom)
        words = formations.describe(mission.shape)
        assert words and words == words.strip(), f"{shape} has no words for the prompts"
        if fly:
            flown = run(config=load_config(None, **given, model="simulated:ideal", seed=1, rounds=100))
            assert flown.formed, f"a team of {n} stand-ins did not form {shape}: {flown.summary.stopped}"


def check_prompts(folder: Path | str) -> None:
    """Check that a folder of templates gives a model all that it needs.

    The templates compile and use known variables; in both answer formats the prompts hold the numbers of the
    mission, the plan message has the robot's id, the position update has position, neighbours, plan and goal,
    and the reason of a rejected answer goes back.
    """
    for json in (False, True):
        try:
            prompts = PromptSet.load(Path(folder), json=json)
        except InputError as error:
            raise AssertionError(f"the templates are refused: {error}") from None
        mission = Mission(
            shape="circle", n_robots=7, spacing=11.5, safe_distance=2.75, max_step=5.25, center=(43.5, 61.25)
        )
        assert mission.ideal is not None, "a circle has one"
        position, neighbor = (12.625, 88.375), (17.125, 90.875)
        asked = PlanQuestion(round=1, robot=5, mission=mission, position=position, neighbors=(neighbor,))
        plan = Plan.of([[round(x, 3) for x in row] for row in mission.ideal])
        texts = prompts.system(mission) + prompts.plan(asked)
        for name in ("n_robots", "spacing", "safe_distance", "max_step"):
            _expect(texts, number_text(float(getattr(mission, name))), f"{name} of the mission", "plan")
        for value in mission.center:
            _expect(texts, number_text(value), "the centre", "plan")
        _expect(texts, formations.describe(mission.shape), "the shape", "plan")
        _expect(prompts.plan(asked), "5", "the robot's own id", "plan")
        step = StepQuestion(
            round=2, robot=5, mission=mission, position=position, neighbors=(neighbor,), plan=plan, slot=3
        )
        update = prompts.step(step)
        for value in (*position, *neighbor):
            _expect(update, f"{value:.3f}", "own and observed positions", "step")
        _expect(update, place_text(step.goal), "the goal", "step")
        reason = "the plan holds 6 points, 7 are required."
        _expect(prompts.retry(reason, asked), reason, "the reason", "retry")


def check_model(model: str | Answers, **options: Any) -> None:
    """Check that a model can take part: it answers, and its answers can be read and used.

    A triangle of three flies three rounds: about a dozen calls, which a provider may charge for.

    Args:
        model: `provider:model` or `package.module:Class` to ask, or an object with `ask`.
        options: any other field of the configuration: base_url, answers, temperature, prompts, ...
    """
    settings: dict[str, Any] = {"shape": "triangle", "n_robots": 3, "rounds": 3, **options}
    try:
        result = run(**settings, model=model)
    except InputError as error:
        raise AssertionError(f"{model} is refused: {error}") from None
    summary = result.summary
    model = summary.models[0]
    assert summary.model_calls > 0, f"{model} was never asked"
    assert summary.calls_failed == 0, (
        f"{model} gave no answer to {summary.calls_failed} of {summary.model_calls} calls: {summary.reason}"
    )
    answered = summary.model_calls - summary.calls_failed
    assert summary.calls_rejected < answered, f"none of the {answered} answers of {model} could be used"
    assert summary.robots_without_plan == 0, f"{summary.robots_without_plan} of 3 robots never got a plan of {model}"
    assert summary.waypoints.get("model", 0) > 0, f"no robot ever moved where {model} told it to"
    assert summary.tokens > 0, f"{model} reports no tokens: its use cannot be compared"


def _sizes(shape: str, sizes: Iterable[int]) -> list[int | None]:
    chosen: list[int | None] = list(sizes)
    if chosen or shape.startswith("points:"):
        return chosen or [None]
    name = shape.partition(":")[0]
    info = next(
        (one for one in (*formations.shapes(), *formations.drawn_shapes()) if one.name.partition(":")[0] == name), None
    )
    assert info is not None, f"there is no shape {name!r}: add it to llm_flock.shapes"
    assert info.description and info.legal, f"{name} says in no words what it is, or which sizes it takes"
    return list(info.examples)


def _check_distances(shape: str, mission: Mission, points: np.ndarray[Any, Any], *, custom: bool) -> None:
    n = len(points)
    if n == 1:
        return
    closest = formations.smallest_distance(points)
    if custom:
        assert closest >= mission.safe_distance, f"{shape} has places {closest:g} apart, nearer than the safe distance"
        return
    assert math.isclose(closest, mission.spacing, rel_tol=1e-6), (
        f"{shape} of {n}: nearest places are {closest:g} apart, the spacing is {mission.spacing:g}"
    )
    twice = np.array(formations.ideal_points(mission.shape, n, mission.center, 2 * mission.spacing))
    assert np.allclose(twice - mission.center, 2 * (points - mission.center), atol=1e-6), (
        f"{shape} of {n} does not grow with the spacing"
    )


def _expect(text: str, wanted: str, what: str, kind: str) -> None:
    assert wanted in text, f"{what} ({wanted}) is not in what a model is told for its {kind}"
