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


def test_a_step_is_asked_for_from_the_origin_in_step_limits() -> None:
    told = frame_step(STEP, "own").framed
    goal = STEP.goal
    assert told.position == (0.0, 0.0) and told.mission.max_step == 1.0
    assert told.neighbors == ((0.29, 0.16),)
    assert told.goal == (round((goal[0] - 31.237) / 6, 2), round((goal[1] - 60.018) / 6, 2))
    away = replace(STEP, target=(1.0, 2.0), slot=None)
    assert frame_step(away, "own").framed.goal == (round((1 - 31.237) / 6, 2), round((2 - 60.018) / 6, 2))
    prompts = PromptSet.load("brief")
    told = frame_step(replace(STEP, mission=build_mission(shape="circle", n_robots=5)), "own").framed
    assert prompts.step(told).endswith(f"1 a step from [0, 0].\nKeep 0.5 from [0.29, 0.16].\nGoal: {list(told.goal)}")


def test_coarse_numbers_near_safe_distance_get_more_decimals() -> None:
    fine = build_mission(shape="circle", n_robots=5, spacing=10.0, safe_distance=0.1, max_step=6.0)
    assert frame_step(replace(STEP, mission=fine), "own").framed.neighbors == ((0.294, 0.164),)


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
    way = [round(0.99 * x / math.hypot(*g), 2) for x in g]
    made, _ = planner(f"Path: [{way}, {list(g)}]", heard=heard)
    answer = asyncio.run(made.step(replace(far, horizon=2)))
    expected = [x + 6 * w for x, w in zip(far.position, way, strict=True)]
    assert isinstance(answer, StepAnswer), answer
    assert close(answer.waypoint, expected) and answer.path == (far.goal,)
    assert heard[0].reply is not None and str(way) in heard[0].reply.text
    assert heard[0].parsed == {"waypoint": list(answer.waypoint), "path": [list(far.goal)]}


def test_reasons_use_the_coordinates_of_the_prompt() -> None:
    made, model = planner("Position: [2, 0]", "Position: [2, 0]", "Position: [2, 0]")
    answer = asyncio.run(made.step(replace(STEP, neighbors=())))
    said = model.asked[1].messages[-1].text
    assert "the position is 2 from yours, 1 is the step limit" in said
    assert isinstance(answer, NoAnswer) and answer.waypoint is not None
    assert close(answer.waypoint, (31.237 + 12, 60.018)), "what could not be used is told in the world"
    rows = [[round((x - 40) / 5, 3), round((y - 55) / 5, 3)] for x, y in PLAN.points]
    made, model = planner(*[f"Plan: {rows}\nmy plan: 1"] * 3)
    assert isinstance(asyncio.run(made.plan(ASK)), NoAnswer)
    assert "from 0.9 to 1.1 is required" in model.asked[1].messages[-1].text


def test_a_reason_that_only_the_world_has_says_so() -> None:
    verdicts = iter(Verdict(reason=reason, fit=None) for reason in ("the world objects.", None, None))
    model = Scripted("Position: [0.1, 0]", "Position: [0.1, 0]")
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
