"""Prompts: every field of the paper is told, files replace the packaged ones, and a bad template says where."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from llm_flock.errors import InputError
from llm_flock.llm._prompt_values import nearest_text, number_text, position_decimals, short_text
from llm_flock.llm._prompting import VARIABLES, PromptSet
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanQuestion, StepQuestion

ROOT = Path(__file__).parents[4]
MISSION = build_mission(
    shape="triangle", n_robots=3, center=(41.5, 52), spacing=11, safe_distance=2.5, max_step=7, comm_range=17
)
PLAN = Plan.of([[41.5, 58.350853], [36, 48.824573], [47, 48.824573]])
SEEN = ((1.0, 2.0), (-3.14159, 4.00004))


ASKED: dict[str, Any] = {
    "mission": MISSION,
    "robot": 2,
    "round": 4,
    "position": (12.3456, 7.0),
    "neighbors": SEEN,
}


def plan_question(**changes: Any) -> PlanQuestion:
    return PlanQuestion(**ASKED | changes)


def step_question(**changes: Any) -> StepQuestion:
    return StepQuestion(**ASKED | {"plan": PLAN, "slot": 1} | changes)


def test_the_system_message_holds_every_field_of_the_paper() -> None:
    text = PromptSet.load().system(MISSION)
    for field in (
        "team of 3",
        "an equilateral triangle",
        "[41.5, 52]",
        "Spacing: 11 ",
        "than 2.5\n",
        "moves 7 ",
        "17;",
    ):
        assert field in text, field


def test_the_plan_message_gives_id_centre_and_form() -> None:
    text = PromptSet.load().plan(plan_question())
    assert "You are robot 2." in text and "[41.5, 52]" in text and "exactly 3 places" in text
    assert text.endswith("Plan: [[x, y], [x, y], ...]\nmy plan: a")


def test_step_message_gives_position_neighbours_plan_goal_form() -> None:
    text = PromptSet.load().step(step_question())
    assert "Your position: [12.346, 7.000]\n" in text
    assert "[[1.000, 2.000], [-3.142, 4.000]]\n" in text
    assert "[[41.5, 58.350853], [36.0, 48.824573], [47.0, 48.824573]]\n" in text
    assert "place 1 of the plan: [36.0, 48.824573]\n" in text
    assert text.endswith("Position: [x, y]")
    assert ": none\n" in PromptSet.load().step(step_question(neighbors=()))


BEFORE = """Your position: [12.346, 7.000]
Robots near you, moving as well: [[1.000, 2.000], [-3.142, 4.000]]
Plan of the team: [[41.5, 58.350853], [36.0, 48.824573], [47.0, 48.824573]]
Your goal, place 1 of the plan: [36.0, 48.824573]

"""
ONE = """Where do you go in this round? Head for your goal, at most 7 from your position, \
and stay 2.5 or more away from every other robot. If the goal is within 7, go to it exactly and not beyond.

Give your reason in a sentence or two, and finish with this line, numbers only:
Position: [x, y]"""
SEVERAL = """Which way do you go from here? Give a path of at most 9 positions, one for each round, this one first. \
Head for your goal with each of them, at most 7 from the position before it (the first: from where you are), \
and stay 2.5 or more away from every other robot. As soon as the goal is within 7, go to it exactly and not beyond: \
the path ends there. \
You will be asked again before the path is over only if something comes up that it does not allow for.

Give your reason in a sentence or two, and finish with this line, numbers only:
Path: [[x, y], [x, y], ...]"""


@pytest.mark.parametrize(("horizon", "text"), [(1, ONE), (9, SEVERAL)])
def test_the_step_message_word_for_word(horizon: int, text: str) -> None:
    assert PromptSet.load().step(step_question(horizon=horizon)) == BEFORE + text


def test_json_prompts_ask_for_objects_only() -> None:
    prompts = PromptSet.load(json=True)
    plan, step = prompts.plan(plan_question()), prompts.step(step_question())
    assert '{"reasoning": "...", "plan": [[x, y], [x, y], ...], "my_plan": a}' in plan and "my plan:" not in plan
    assert step.endswith('{"reasoning": "...", "position": [x, y]}')
    assert prompts.step(step_question(horizon=2)).endswith('{"reasoning": "...", "path": [[x, y], [x, y], ...]}')
    assert "JSON" in prompts.retry("it is empty.", step_question())
    assert "JSON" not in PromptSet.load().retry("it is empty.", step_question())


def test_a_retry_gives_the_reason() -> None:
    assert "the plan holds 9 points, 10 are required." in PromptSet.load().retry(
        "the plan holds 9 points, 10 are required.", plan_question()
    )


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("json", [False, True])
@pytest.mark.parametrize("words", ["full", "brief"])
def test_a_retry_repeats_the_form_of_the_question(words: str, json: bool, dim: int) -> None:
    prompts = PromptSet.load(words, json=json)
    points = ((0, 0, 0), (9, 9, 9))
    space = build_mission(points=points, center=(20, 20, 20), arena=((0, 0, 0), (40, 40, 40)))
    mission = MISSION if dim == 2 else space
    asked = plan_question(mission=mission)
    lines = prompts.retry("it is empty.", asked).splitlines()
    form = lines[-1:] if json else lines[-2:]
    assert "\n".join(form) in prompts.plan(asked)
    assert form[0].startswith("{" if json else "Plan: [[x, y") and ("z" in form[0]) == (dim == 3)
    for horizon in (1, 4):
        step = step_question(mission=mission, horizon=horizon)
        form = prompts.retry("it is empty.", step).splitlines()[-1:]
        assert form[0] in prompts.step(step).splitlines()
        assert ("ath" in form[0]) == (horizon > 1) and ("osition" in form[0]) == (horizon == 1)


def test_nothing_assumes_a_plane() -> None:
    points = ((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, 10.0))
    mission = build_mission(points=points, center=(20, 20, 20), arena=((0, 0, 0), (40, 40, 40)))
    prompts = PromptSet.load()
    assert "three-dimensional" in prompts.system(mission) and "[20, 20, 20]" in prompts.system(mission)
    question = plan_question(mission=mission, position=(1.0, 2.0, 3.0), neighbors=((4.0, 5.0, 6.0),))
    assert "Plan: [[x, y, z], [x, y, z], ...]" in prompts.plan(question)
    step = prompts.step(
        step_question(mission=mission, position=(1, 2, 3), neighbors=((4, 5, 6),), plan=Plan.of(points))
    )
    assert "[[4.000, 5.000, 6.000]]" in step and step.endswith("Position: [x, y, z]")


def test_prompt_tells_custom_shape_by_points_and_text_by_words() -> None:
    custom = build_mission(points=((10, 10), (20, 10), (30, 10)))
    assert "[[-10.000, 0.000], [0.000, 0.000], [10.000, 0.000]]" in PromptSet.load().system(custom)
    words = build_mission(shape="text:the letter {{ A }}", n_robots=5)
    assert "- Shape: the letter {{ A }}\n" in PromptSet.load().system(words)


def test_a_team_of_one_is_asked_for_one_place() -> None:
    mission = build_mission(shape="circle", n_robots=1)
    assert "Plan: [[x, y]]\n" in PromptSet.load().plan(plan_question(mission=mission, robot=0))


@pytest.mark.parametrize(("value", "text"), [(10.0, "10"), (2.5, "2.5"), (0.1 + 0.2, "0.3"), (1e6, "1000000")])
def test_numbers_are_short(value: float, text: str) -> None:
    assert number_text(value) == text


@pytest.mark.parametrize(("max_step", "decimals"), [(6.0, 3), (60.0, 3), (0.6, 4), (0.06, 5), (1e-6, 6)])
def test_prompt_rounds_positions_to_a_thousandth_of_a_step(max_step: float, decimals: int) -> None:
    assert position_decimals(max_step) == decimals


def test_two_missions_do_not_mix() -> None:
    prompts = PromptSet.load()
    other = MISSION.model_copy(update={"max_step": 5.0})
    first = prompts.system(MISSION)
    assert prompts.system(Mission(**other.model_dump())) == first.replace("moves 7 ", "moves 5 ")
    assert prompts.system(MISSION) == first


def test_files_of_the_operator_replace_packaged_ones(tmp_path: Path) -> None:
    (tmp_path / "step.j2").write_text(
        "{% include 'head.j2' %} {{ robot }} {{ round }} {{ n_robots }}", encoding="utf-8"
    )
    (tmp_path / "head.j2").write_text("I, robot", encoding="utf-8")
    prompts = PromptSet.load(tmp_path)
    assert prompts.step(step_question()) == "I, robot 2 4 3"
    assert prompts.plan(plan_question()) == PromptSet.load().plan(plan_question())


@pytest.mark.parametrize(
    "content",
    [
        "{% include 'more.j2' %}",
        "{% include 'more' ~ '.j2' %}",
        "{% import 'more.j2' as more with context %}{{ more }}",
        "{% block all %}{{ here }} {{ near }}{% endblock %}",
        "{% extends 'more.j2' %}",
    ],
)
def test_a_template_has_its_variables_wherever_it_looks_at_them(tmp_path: Path, content: str) -> None:
    (tmp_path / "step.j2").write_text(content, encoding="utf-8")
    (tmp_path / "more.j2").write_text("{{ here }} {{ near }}{{ range(0) | join }}", encoding="utf-8")
    question = step_question()
    near = nearest_text(question.position, question.neighbors, MISSION)
    assert PromptSet.load(tmp_path).step(question) == f"{short_text(question.position, 3)} {near}"


@pytest.mark.parametrize(
    ("content", "file", "why"),
    [
        ("{{ robot", "step.j2, line 1", "a Jinja template"),
        ("{{ speed }}", "step.j2", "not speed"),
        ("{{ goal | shout }}", "step.j2, line 1", "shout"),
        ("{{ plan.points }}", "step.j2", "has no attribute 'points'"),
        ("{{ 1 // 0 }}", "step.j2", "can be rendered"),
        ("{% include 'missing.j2' %}", "step.j2", "missing.j2"),
        ("{{ shape.__class__.__mro__ }}", "step.j2", "unsafe"),
        (b"\xff\xfe", "step.j2", "UTF-8"),
    ],
)
def test_a_bad_template_is_refused_by_name(tmp_path: Path, content: str | bytes, file: str, why: str) -> None:
    (tmp_path / "step.j2").write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError) as caught:
        PromptSet.load(tmp_path)
    assert caught.value.field == "prompts"
    assert str(caught.value.value).endswith(file) and why in caught.value.says


def test_a_folder_without_templates_is_refused(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(InputError, match=r"system\.j2, plan\.j2, step\.j2, judgement\.j2, retry\.j2"):
            PromptSet.load(folder)


def test_the_documentation_lists_exactly_the_variables() -> None:
    text = (ROOT / "docs" / "reference" / "prompts.md").read_text(encoding="utf-8")
    text = re.sub(r"\| all\b", "| system, plan, step, judgement", text)
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \|", text, re.MULTILINE)
    told = {
        name: {row for row, files in rows if name.removesuffix(".j2") in re.split(r",\s*", files)} for name in VARIABLES
    }
    assert {name: set(known) for name, known in VARIABLES.items()} == {
        name: {row.strip() for row in told[name]} for name in VARIABLES
    }


def test_obstacles_alter_one_line_of_the_prompt() -> None:
    prompts = PromptSet.load()
    bare = build_mission()
    disc: dict[str, object] = {"center": (50, 50), "radius": 5}
    corners: dict[str, object] = {"polygon": ((0, 0), (4, 0), (4, 2.5))}
    told = prompts.system(build_mission(obstacles=[disc, corners]))
    line = (
        "- Obstacles: keep your position and every place of a plan 1.5 or more from a disc of radius 5 around "
        "[50, 50]; a polygon with the corners [[0, 0], [4, 0], [4, 2.5]]\n"
    )
    assert line in told and told.replace(line, "") == prompts.system(bare)
    assert "Obstacles" not in prompts.system(bare)
    ball = build_mission(
        points=((0, 0, 0), (9, 9, 9)),
        center=(50, 50, 50),
        arena=((0, 0, 0), (100, 100, 100)),
        obstacles=[{"center": (9, 9, 9), "radius": 5}],
    )
    assert "a ball of radius 5 around [9, 9, 9]" in prompts.system(ball)


def test_prompt_names_places_if_robots_are_more_or_fewer() -> None:
    prompts = PromptSet.load()
    team = build_mission(shape="circle", n_robots=10)
    for mission in (team, team.change(places=10)):
        assert "Places" not in prompts.system(mission)
        assert "the 10 robots" in prompts.plan(plan_question(mission=mission))
    spares, gaps = team.change(places=8), team.change(places=12)
    assert "- Places: 8 for 10 robots, so 2 of the robots wait aside\n- Centre" in prompts.system(spares)
    assert "- Places: 12 for 10 robots, so 2 of the places stay empty\n- Centre" in prompts.system(gaps)
    told = prompts.plan(plan_question(mission=spares))
    assert "exactly 8 places for the team of 10 robots," in told and "from 0 to 9" in told
    assert "lists all 8 places" in PromptSet.load(json=True).plan(plan_question(mission=spares))


def test_prompt_of_a_travelling_formation_has_its_velocity() -> None:
    prompts = PromptSet.load()
    mission = MISSION.change(velocity=(1, -0.5), since=2)
    line = (
        "- Velocity of the centre: [1.0, -0.5] in a round; the whole formation travels, and centre, places and goals "
        "are given for the end of this round\n"
    )
    assert prompts.system(mission).replace(line, "") == prompts.system(MISSION) != prompts.system(mission)
    assert "- Centre of the shape: [43.5, 51]\n" + line in prompts.system(mission.at(4))


def test_the_written_out_missions_of_a_long_way_stay_apart() -> None:
    prompts = PromptSet.load()
    mission = MISSION.change(velocity=(0.01, 0))
    first = prompts.system(mission.at(1))
    for round_ in range(2, 200):
        assert prompts.plan(plan_question(mission=mission.at(round_)))
    assert prompts.system(mission.at(1)) == first


def test_prompt_tells_a_spare_where_it_waits() -> None:
    text = PromptSet.load().step(step_question(slot=None, target=(1.0, 2.0)))
    assert "Your goal, where you wait, out of the others' way: [1.0, 2.0]\n" in text
    with pytest.raises(AssertionError, match="where to wait"):
        assert step_question(slot=None).goal


def test_brief_prompts_are_brief_and_say_what_a_robot_must_know() -> None:
    brief = PromptSet.load("brief")
    assert PromptSet.load("brief") is not PromptSet.load()
    plan, step = brief.plan(plan_question()), brief.step(step_question())
    assert max(map(len, (brief.system(MISSION), plan, step))) <= 240
    assert plan.startswith("Plan: [[x, y], [x, y], ...]\nmy plan: a\n")
    assert step.startswith("Position: [x, y]\n")
    assert brief.step(step_question(horizon=4)).startswith("Path of at most 4: [[x, y], ...]\n")
    json = PromptSet.load("brief", json=True)
    assert json.plan(plan_question()).startswith('{"plan": [[x, y], [x, y], ...], "my_plan": a}\n')
    assert json.step(step_question()).startswith('{"position": [x, y]}\n')
    assert json.step(step_question(horizon=4)).startswith('{"path": [[x, y], ...]}, at most 4\n')
    retry = brief.retry("it is empty.", step_question())
    assert retry == "Not usable: it is empty. Answer again in full:\nPosition: [x, y]"
    stones = build_mission(obstacles=[{"center": [10, 10], "radius": 2}])
    assert "keep your position" in brief.step(step_question(mission=stones))
    assert "keep your position" in brief.plan(plan_question(mission=stones))


def test_brief_prompts_tell_three_nearest_robots_in_step_reach() -> None:
    here = (50.0, 50.0)
    around = ((58.0, 50.0), (50.0, 54.5), (47.0, 46.0), (50.0, 42.25), (59.5, 50.0))
    told = PromptSet.load("brief").step(step_question(position=here, neighbors=around, mission=build_mission()))
    assert "Keep 3 from [50, 54.5], [47, 46], [50, 42.25]." in told
    told = PromptSet.load("brief").step(step_question(position=here, neighbors=around[4:], mission=build_mission()))
    assert "Keep" not in told


def test_a_template_is_no_link_out_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("TOPSECRET")
    folder = tmp_path / "prompts"
    folder.mkdir()
    (folder / "system.j2").symlink_to(tmp_path / "secret")
    with pytest.raises(InputError, match="no link out of it"):
        PromptSet.load(folder)
