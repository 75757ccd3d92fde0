"""Questions in a model's own frame: what it is told, and what its answers mean in the world."""

import asyncio
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import llm_flock
from llm_flock.errors import InputError
from llm_flock.llm._frame import frame_plan, frame_step
from llm_flock.llm._planner import LanguagePlanner
from llm_flock.llm._port import Attempt, Call, Reply
from llm_flock.llm._prompting import PromptSet
from llm_flock.mission import build_mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._verification.plans import check_plan
from llm_flock.protocol._verification.steps import Verdict, judge

MISSION = build_mission(shape="circle", n_robots=5, center=(40.0, 55.0), velocity=(1.0, -0.5), obstacles=[
    {"center": [10.0, 10.0], "radius": 2.0}, {"polygon": [[90.0, 90.0], [95.0, 90.0], [90.0, 95.0]]}
])  # fmt: skip
PLAN = Plan.of(MISSION.ideal or ())
STEP = StepQuestion(
    mission=MISSION, robot=1, round=3, position=(31.237, 60.018), neighbors=((33.0, 61.0),), plan=PLAN, slot=2
)
ASK = PlanQuestion(mission=MISSION, robot=1, round=3, position=(31.0, 60.0), neighbors=(), still=((38.0, 55.0),))


class Scripted:
    """Says what it is given to say, and keeps what it was asked."""

    name = "test:scripted"

    def __init__(self, *texts: str) -> None:
        self.texts = list(texts)
        self.asked: list[Call] = []

    async def ask(self, call: Call) -> Reply:
        self.asked.append(call)
        return Reply(text=self.texts.pop(0), model=self.name)


def planner(*texts: str, heard: list[Attempt] | None = None, **options: object) -> tuple[LanguagePlanner, Scripted]:
    model = Scripted(*texts)
    sink = [] if heard is None else heard
    made = LanguagePlanner(
        1,
        model,
        PromptSet.load("brief"),
        frame="own",
        on_attempt=sink.append,
        check_plan=lambda question, answer: check_plan(question.mission, answer.plan),
        judge=lambda question, answer: judge(question, answer, shield_on=True),
        **options,  # type: ignore[arg-type]
    )
    return made, model


def close(a: Sequence[float], b: Sequence[float], tolerance: float = 1e-9) -> bool:
    return math.dist(a, b) <= tolerance


def test_mission_in_own_frame_is_the_mission_moved_and_scaled() -> None:
    told = frame_plan(ASK, "own").framed.mission
    assert told.center == (0.0, 0.0) and told.spacing == 1.0
    assert (told.safe_distance, told.max_step, told.comm_range) == (0.3, 0.6, 1.5)
    assert told.velocity == (0.1, -0.05) and told.arena == ((-4.0, -5.5), (6.0, 4.5))
    disc, corners = told.obstacles
    assert (
        disc.center == (-3.0, -4.5) and disc.radius == 0.2 and corners.polygon == ((5.0, 3.5), (5.5, 3.5), (5.0, 4.0))
    )
    assert told.ideal is not None
    for mine, theirs in zip(told.ideal, PLAN.points, strict=True):
        assert close([40 + 10 * mine[0], 55 + 10 * mine[1]], theirs, 1e-5)


def test_custom_points_and_the_sensor_range_are_scaled() -> None:
    mission = build_mission(points=[[0.0, 0.0], [8.0, 0.0], [0.0, 6.0]], sense_range=30.0, max_step=4.0)
    told = frame_plan(replace(ASK, mission=mission, still=()), "own").framed.mission
    assert told.points == ((0.0, 0.0), (0.8, 0.0), (0.0, 0.6)) and told.sense_range == 3.0
    assert told.ideal is not None and mission.ideal is not None
    assert math.dist(*told.ideal[:2]) == pytest.approx(math.dist(*mission.ideal[:2]) / 10)


def test_a_step_is_asked_for_from_the_origin_with_the_goal_ahead() -> None:
    told, goal = frame_step(STEP, "own").framed, STEP.goal
    assert told.position == (0.0, 0.0) and told.mission.max_step == pytest.approx(100)
    assert told.goal == (round(math.dist(goal, STEP.position) / 0.06), 0)
    away = replace(STEP, target=(1.0, 2.0), slot=None)
    assert frame_step(away, "own").framed.goal == (round(math.dist((1.0, 2.0), STEP.position) / 0.06), 0)
    prompts = PromptSet.load("brief")
    told = frame_step(replace(STEP, mission=build_mission(shape="circle", n_robots=5)), "own").framed
    near = ", ".join(f"{x:g}" for x in told.neighbors[0])
    assert prompts.step(told).endswith(
        f"100 a step from [0, 0].\nKeep 50 from [{near}].\nGoal: {list(map(int, told.goal))}"
    )


@pytest.mark.parametrize("to", [(31.237, 90.0), (1.0, 60.018), (31.237, 2.0), (55.0, 60.018), (31.237, 60.018)])
def test_a_turned_frame_keeps_distances_and_turns_back(to: tuple[float, float]) -> None:
    asked = frame_step(replace(STEP, target=to, slot=None), "own")
    assert asked.frame is not None and asked.framed.goal == (round(math.dist(to, STEP.position) / 0.06), 0)
    for point in ((33.0, 61.0), (10.0, 10.0), (90.0, 95.0)):
        mine = asked.frame.exact(point)
        assert math.hypot(*mine) == pytest.approx(math.dist(point, STEP.position) / 0.06)
        assert close(asked.frame.world(mine), point)
    moved = asked.framed.mission.velocity or ()
    back = asked.frame.world(moved)
    assert close([x - here for x, here in zip(back, STEP.position, strict=True)], MISSION.velocity or ())
    low, high = asked.framed.mission.arena
    inside = [asked.frame.exact(corner) for corner in ((0.0, 0.0), (0.0, 100.0), (100.0, 0.0), (100.0, 100.0))]
    assert all(a - 1e-9 <= x <= b + 1e-9 for point in inside for a, x, b in zip(low, point, high, strict=True))


def test_coarse_numbers_near_safe_distance_get_more_decimals() -> None:
    fine = build_mission(shape="circle", n_robots=5, spacing=10.0, safe_distance=0.1, max_step=6.0)
    near = replace(STEP, mission=fine, target=(99.0, 60.018), slot=None)
    assert frame_step(near, "own").framed.neighbors == ((29.4, 16.4),)


def test_a_told_safe_distance_is_never_too_short() -> None:
    odd = build_mission(shape="circle", n_robots=5, safe_distance=5.164, max_step=6.0)
    assert frame_step(replace(STEP, mission=odd), "own").framed.mission.safe_distance == 87


def test_the_worlds_frame_changes_nothing() -> None:
    answer = StepAnswer(waypoint=(32.0, 61.0), path=((33.0, 62.0),))
    asked = frame_step(STEP, "world")
    assert asked.framed is STEP and asked.to_world(answer) is answer
    assert frame_plan(ASK, "world").framed is ASK


def test_described_shape_is_planned_in_world_coordinates() -> None:
    words = build_mission(shape="text:a line 40 units long", n_robots=3)
    assert frame_plan(replace(ASK, mission=words), "own").frame is None
    assert frame_step(replace(STEP, mission=words), "own").frame is not None


def test_a_repeated_goal_is_the_goal_to_the_last_digit() -> None:
    near = replace(STEP, position=(PLAN.points[2][0] + 1.2345, PLAN.points[2][1] - 2.3456), neighbors=())
    told = frame_step(near, "own").framed
    made, _ = planner(f"Position: {list(told.goal)}")
    answer = asyncio.run(made.step(near))
    assert isinstance(answer, StepAnswer) and answer.waypoint == near.goal


def test_answers_are_judged_in_world_and_recorded_as_given() -> None:
    heard: list[Attempt] = []
    far = replace(STEP, position=(23.456, 63.21), neighbors=())
    g = frame_step(far, "own").framed.goal
    assert g[1] == 0.0
    way = [96, 20]
    made, _ = planner(f"Path: [{way}, {list(g)}]", heard=heard)
    answer = asyncio.run(made.step(replace(far, horizon=2)))
    (dx, dy), (ahead, aside) = ((b - a for a, b in zip(far.position, far.goal, strict=True)), way)
    unit = 0.06 / math.hypot(dx, dy)
    expected = [23.456 + unit * (ahead * dx - aside * dy), 63.21 + unit * (ahead * dy + aside * dx)]
    assert isinstance(answer, StepAnswer), answer
    assert close(answer.waypoint, expected) and answer.path == (far.goal,)
    assert heard[0].reply is not None and str(way) in heard[0].reply.text
    assert heard[0].parsed == {"waypoint": list(answer.waypoint), "path": [list(far.goal)]}


def test_reasons_use_the_coordinates_of_the_prompt() -> None:
    made, model = planner("Position: [200, 0]", "Position: [200, 0]", "Position: [200, 0]")
    answer = asyncio.run(made.step(replace(STEP, neighbors=(), target=(71.237, 60.018), slot=None)))
    said = model.asked[1].messages[-1].text
    assert "the position is 200 from yours, 100 is the step limit" in said
    assert isinstance(answer, NoAnswer) and answer.waypoint is not None
    assert close(answer.waypoint, (31.237 + 12, 60.018)), "what could not be used is told in the world"
    rows = [[round((x - 40) / 5, 3), round((y - 55) / 5, 3)] for x, y in PLAN.points]
    made, model = planner(*[f"Plan: {rows}\nmy plan: 1"] * 3)
    assert isinstance(asyncio.run(made.plan(ASK)), NoAnswer)
    assert "from 0.9 to 1.1 is required" in model.asked[1].messages[-1].text


def test_a_reason_that_only_the_world_has_says_so() -> None:
    verdicts = iter(Verdict(reason=reason, fit=None) for reason in ("the world objects.", None, None))
    model = Scripted("Position: [10, 0]", "Position: [10, 0]")
    made = LanguagePlanner(
        1,
        model,
        PromptSet.load("brief"),
        frame="own",
        judge=lambda question, answer: next(verdicts),
    )
    assert isinstance(asyncio.run(made.step(STEP)), StepAnswer)
    assert "in the team's coordinates, which are not yours, the world objects." in model.asked[1].messages[-1].text


def test_a_plan_comes_back_to_its_place() -> None:
    rows = [[round((x - 40) / 10, 2), round((y - 55) / 10, 2)] for x, y in PLAN.points]
    made, _ = planner(f"Plan: {rows}\nmy plan: 3")
    answer = asyncio.run(made.plan(ASK))
    assert isinstance(answer, PlanAnswer) and answer.slot == 3
    assert np.abs(answer.plan.array - PLAN.array).max() <= 0.05 + 1e-6


def test_history_and_an_own_frame_do_not_go_together() -> None:
    with pytest.raises(InputError, match="frame"):
        planner(history=1)


@pytest.mark.parametrize("fields", [
    {"shape": "triangle", "n_robots": 3},
    {"shape": "circle", "n_robots": 6, "velocity": (1.0, 0.5), "center": (40.0, 40.0)},
    {"shape": "cross", "n_robots": 5, "decide": "on-event", "answers": "json"},
])  # fmt: skip
def test_stand_ins_form_in_their_own_frame_as_in_the_worlds(fields: dict[str, object]) -> None:
    own, world = (llm_flock.run(seed=3, frame=frame, **fields) for frame in ("own", "world"))  # type: ignore[arg-type]
    assert own.formed and world.formed and (own.summary.min_separation or 0.0) >= 3.0 - 1e-9
    assert own.summary.rounds_to_formed is not None and world.summary.rounds_to_formed is not None
    assert abs(own.summary.rounds_to_formed - world.summary.rounds_to_formed) <= 4
