"""Simulated models: what they read, what they say, and what each profile gets wrong, at its rate."""

from __future__ import annotations

import asyncio
import csv
import math
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from answer_readers import parse_path, parse_path_json, parse_plan, parse_plan_json, parse_step, parse_step_json
from simulated_talk import CIRCLE, JSON, PLAN, TEXT, Conversation, plan_talk, responder, step_talk

from llm_flock import shapes as formations
from llm_flock.errors import AnswerError, InputError, ModelError
from llm_flock.llm._planner import LanguagePlanner
from llm_flock.llm._port import Call, ChatMessage
from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import FAILURES, PROFILES, Profile, parse_profile
from llm_flock.llm._simulated.seen import AFTER_REJECTION, SEEN, SMALL_MODELS
from llm_flock.metrics import ShapeTarget
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.planner import StepAnswer, StepQuestion
from llm_flock.protocol._verification.plans import check_plan
from llm_flock.shapes import rotated

ROOT = Path(__file__).parents[4]


MISSIONS = [
    *(
        build_mission(shape=info.name.replace("K", "5"), n_robots=n, arena=((-200, -200), (300, 300)))
        for info in formations.shapes()
        if info.name not in ("points", "text:DESCRIPTION")
        for n in info.examples
    ),
    build_mission(points=((0.25, 0), (10, 3), (-3, 12), (20, 20)), arena=((-200, -200), (300, 300))),
    build_mission(points=((0, 0, 0), (10, 0, 2), (0, 10, -4)), center=(9, 9, 9), arena=((-20,) * 3, (40,) * 3)),
    build_mission(
        shape="wedge", n_robots=5, spacing=0.5, safe_distance=0.2, max_step=0.3, comm_range=2, center=(0.5, 0),
        arena=((-5, -5), (5, 5)),
    ),
]  # fmt: skip


@pytest.mark.parametrize("mission", MISSIONS, ids=lambda m: f"{m.shape}-{m.n_robots}-{m.dim}")
def test_an_ideal_model_draws_every_shape_from_words_alone(mission: Mission) -> None:
    plan, slot = parse_plan(responder().answer(plan_talk(mission, robot=1)), mission.n_robots, mission.dim)
    assert slot == 1
    assert mission.ideal is not None
    ideal = np.array(mission.ideal)
    tolerance = 0.02 if mission.max_step > 1 else 0.002
    np.testing.assert_allclose(plan.array.mean(axis=0), mission.center, atol=tolerance)
    assert ShapeTarget(ideal).error(plan.array).mean < tolerance
    # A random orientation, in the plane only.
    assert np.abs(plan.array - ideal).max() > 0.05 * mission.spacing
    if mission.dim == 3:
        np.testing.assert_allclose(plan.array[:, 2], ideal[:, 2], atol=tolerance)


def test_orientations_differ_between_seeds_and_repeat_with_them() -> None:
    said = [responder(seed=seed).answer(plan_talk()) for seed in (1, 1, 2)]
    assert said[0] == said[1] != said[2]


def test_orientations_are_uniform() -> None:
    thinker, first = responder(seed=5), []
    for _ in range(400):
        x, y = parse_plan(thinker.answer(plan_talk()), 10, 2)[0].points[0]
        first.append(math.atan2(y - 50, x - 50))
    counts, _ = np.histogram(first, bins=8, range=(-math.pi, math.pi))
    # 50 expected in each; chi-square with 7 degrees of freedom exceeds 24.3 once in a thousand seeds.
    assert ((counts - 50) ** 2 / 50).sum() < 24.3


def test_a_shape_in_other_words_is_refused() -> None:
    mission = build_mission(shape="text:the letter A", n_robots=6)
    with pytest.raises(ModelError, match="a simulated model cannot read words: it draws no 'the letter A'"):
        responder().answer(plan_talk(mission, robot=0))
    space = build_mission(shape="text:a circle", n_robots=6, center=(5, 6, 7), arena=((-50,) * 3, (50,) * 3))
    plan, _ = parse_plan(responder().answer(plan_talk(space, robot=0)), 6, 3)
    np.testing.assert_allclose(plan.array[:, 2], 7)


def test_steps_are_full_and_straight_until_the_exact_goal() -> None:
    position, goal = (20.0, 20.0), PLAN.points[4]
    rounds = 0
    while position != goal:
        waypoint = parse_step(responder().answer(step_talk(position, slot=4)), 2)
        assert math.dist(position, waypoint) <= CIRCLE.max_step
        assert waypoint == goal or math.dist(position, waypoint) > CIRCLE.max_step - 0.03
        position, rounds = waypoint, rounds + 1
        assert rounds < 20
    assert rounds == math.ceil(math.dist((20.0, 20.0), goal) / CIRCLE.max_step)
    assert parse_step(responder().answer(step_talk(goal, slot=4)), 2) == goal


@pytest.mark.parametrize("prompts", [TEXT, JSON], ids=["text", "json"])
def test_a_path_is_the_steps_that_would_be_given_one_by_one(prompts: PromptSet) -> None:
    read = parse_path_json if prompts.json else parse_path
    path = read(responder().answer(step_talk(slot=4, prompts=prompts, horizon=20)), 20, 2)
    position = (20.0, 20.0)
    for waypoint in path:
        assert parse_step(responder().answer(step_talk(position, slot=4)), 2) == waypoint
        position = waypoint
    assert position == PLAN.points[4]
    assert read(responder().answer(step_talk(slot=4, prompts=prompts, horizon=2)), 2, 2) == path[:2]


def test_failures_befall_whole_paths() -> None:
    goal = PLAN.points[0]
    position = (goal[0] - 15.0, goal[1])
    path = parse_path(responder("overshoot").answer(step_talk(position, horizon=20)), 20, 2)
    assert len(path) == 3 and path[-1][0] > goal[0] + 2
    talk = step_talk((20.0, 20.0), neighbors=((60.0, 20.0),), horizon=20)
    path = parse_path(responder("collapse").answer(talk), 20, 2)
    assert len(path) > 3 and path[-1][0] > 50.0


def test_json_is_spoken_when_asked_for() -> None:
    text = responder().answer(plan_talk(prompts=JSON))
    assert text.startswith("{") and parse_plan_json(text, 10, 2)[1] == 3
    text = responder().answer(step_talk(prompts=JSON))
    assert text.startswith("{") and parse_step_json(text, 2) == parse_step(responder().answer(step_talk()), 2)


def test_question_is_found_behind_rejected_and_older_exchanges() -> None:
    older = plan_talk()
    asked = StepQuestion(mission=CIRCLE, robot=0, round=1, position=(1.0, 2.0), neighbors=(), plan=PLAN, slot=0)
    retry = ("user", TEXT.retry("no", asked))
    talk = [*older, ("assistant", "Plan: ..."), step_talk()[1], ("assistant", "?"), retry]
    assert parse_step(responder().answer(talk), 2) == parse_step(responder().answer(step_talk()), 2)


@pytest.mark.parametrize(
    ("talk", "template"),
    [
        ([], "plan.j2 and step.j2"),
        ([("user", "What do you think?")], "plan.j2 and step.j2"),
        ([("system", "Form a circle."), plan_talk()[1]], "system.j2"),
        ([plan_talk()[0], ("user", "Work out a plan: please.")], "plan.j2"),
        ([plan_talk()[0], ("user", "Your position: [1, 2]. Where to?")], "step.j2"),
    ],
)
def test_other_words_than_the_packaged_ones_are_not_understood(talk: Conversation, template: str) -> None:
    with pytest.raises(InputError, match="packaged words") as caught:
        responder().answer(talk)
    assert caught.value.field == "prompts" and template in caught.value.says


def test_distorted_plans_can_be_read_and_are_wrong() -> None:
    ideal = np.array(CIRCLE.ideal)
    thinker = responder("distorted")
    plans = [parse_plan(thinker.answer(plan_talk()), 10, 2)[0].array for _ in range(30)]
    errors = [ShapeTarget(ideal).error(plan).mean for plan in plans]
    assert min(errors) > 0.1 * CIRCLE.spacing
    nearest = [formations.smallest_distance(plan) for plan in plans]
    assert np.ptp(nearest) > 2.0
    # Steps are not concerned.
    assert parse_step(thinker.answer(step_talk()), 2) == parse_step(responder().answer(step_talk()), 2)


def test_overshooting_steps_are_always_of_full_length() -> None:
    goal = PLAN.points[0]
    for distance in (0.0, 0.5, 3.0, 5.9, 30.0):
        position = (goal[0] - distance, goal[1])
        waypoint = parse_step(responder("overshoot").answer(step_talk(position)), 2)
        assert CIRCLE.max_step - 0.03 < math.dist(position, waypoint) <= CIRCLE.max_step
        if distance > 0:
            assert waypoint[0] > position[0] and abs(waypoint[1] - position[1]) < 0.02


def test_collapsing_steps_go_to_the_centroid() -> None:
    near = parse_step(responder("collapse").answer(step_talk((20.0, 20.0), neighbors=((22.0, 20.0), (21.0, 23.0)))), 2)
    assert near == (21.0, 21.0)
    far = parse_step(responder("collapse").answer(step_talk((20.0, 20.0), neighbors=((60.0, 20.0),))), 2)
    assert far[1] == 20.0 and 5.9 < far[0] - 20.0 <= 6.0
    alone = parse_step(responder("collapse").answer(step_talk((20.0, 20.0))), 2)
    assert alone == (20.0, 20.0)
    both = parse_step(responder("collapse,overshoot").answer(step_talk((20.0, 20.0), neighbors=((22.0, 20.0),))), 2)
    assert 5.9 < both[0] - 20.0 <= 6.0


@pytest.mark.parametrize("prompts", [TEXT, JSON], ids=["text", "json"])
@pytest.mark.parametrize("mission", [CIRCLE, build_mission(shape="circle", n_robots=1)], ids=["ten", "one"])
def test_malformed_answers_are_never_usable_and_fail_variously(mission: Mission, prompts: PromptSet) -> None:
    thinker, reasons = responder("malformed"), Counter[str]()
    n = mission.n_robots
    plan = Plan.of(mission.ideal or ())
    read_plan, read_step = (parse_plan_json, parse_step_json) if prompts.json else (parse_plan, parse_step)
    plan_question = plan_talk(mission, robot=0, prompts=prompts)
    step_question = step_talk((50.0, 50.0), mission=mission, plan=plan, prompts=prompts)
    path_question = step_talk((30.0, 30.0), mission=mission, plan=plan, prompts=prompts, horizon=9)
    read_path = parse_path_json if prompts.json else parse_path
    for _ in range(40):
        text = thinker.answer(plan_question)
        with pytest.raises(AnswerError) as caught:
            read_plan(text, n, 2)
        reasons["plan" + re.sub(r"[-0-9.]+", "#", str(caught.value))] += 1
        text = thinker.answer(step_question)
        with pytest.raises(AnswerError) as caught:
            read_step(text, 2)
        reasons["step" + re.sub(r"[-0-9.]+", "#", str(caught.value))] += 1
        text = thinker.answer(path_question)
        with pytest.raises(AnswerError) as caught:
            read_path(text, 9, 2)
        reasons["path" + re.sub(r"[-0-9.]+", "#", str(caught.value))] += 1
    assert sum(reason.startswith("plan") for reason in reasons) >= 3
    assert sum(reason.startswith("step") for reason in reasons) >= 3
    assert sum(reason.startswith("path") for reason in reasons) >= 3


@pytest.mark.parametrize("failure", FAILURES)
def test_failures_come_at_their_rate(failure: str) -> None:
    thinker = responder(f"{failure}@0.3", seed=11)
    hits = sum(failure in thinker.draw() for _ in range(2000))
    assert abs(hits / 2000 - 0.3) < 4 * math.sqrt(0.3 * 0.7 / 2000)
    assert not any(responder(f"{failure}@0").draw() for _ in range(5))
    assert all(responder(failure, seed).draw() == {failure} for seed in range(5))


def test_one_failures_rate_does_not_shift_anothers_chance() -> None:
    alone, both = responder("flaky@0.3", 4), responder("flaky@0.3,malformed@0.5", 4)
    assert ["flaky" in alone.draw() for _ in range(50)] == ["flaky" in both.draw() for _ in range(50)]


def ask(profile: str, talk: Conversation, tries: int = 1, **options: Any) -> list[Any]:
    """Replies and errors, in turn."""
    model = SimulatedModel(parse_profile(profile), np.random.default_rng(0), **options)
    roles: Any = ("system", "user", "assistant")
    messages = tuple(ChatMessage(roles[roles.index(role)], text) for role, text in talk)

    async def all_tries() -> list[Any]:
        out: list[Any] = []
        for attempt in range(tries):
            try:
                out.append(await model.ask(Call(robot=3, round=1, kind="step", attempt=attempt, messages=messages)))
            except ModelError as error:
                out.append(error)
        return out

    return asyncio.run(all_tries())


def test_a_reply_has_text_and_estimated_tokens() -> None:
    talk = step_talk()
    (reply,) = ask("ideal", talk)
    assert reply.text == responder().answer(talk) and reply.model == "simulated:ideal"
    assert reply.usage.input == math.ceil(sum(len(text) for _, text in talk) / 4)
    assert reply.usage.output == math.ceil(len(reply.text) / 4)


def test_flaky_models_fail_as_providers_do() -> None:
    errors = ask("flaky", step_talk(), tries=60)
    assert {error.kind for error in errors} == {"rate_limit", "server", "timeout"}
    assert all(error.retry_after_s is not None for error in errors if error.kind == "rate_limit")
    mixed = ask("flaky@0.5", step_talk(), tries=40)
    assert 5 < sum(isinstance(answer, ModelError) for answer in mixed) < 35


def test_slow_models_take_about_a_second() -> None:
    waits: list[float] = []

    async def sleep(seconds: float) -> None:
        waits.append(seconds)

    ask("slow", step_talk(), tries=300, sleep=sleep)
    assert len(waits) == 300 and 0.9 < float(np.median(waits)) < 1.1 and max(waits) < 10
    waits.clear()
    ask("slow@0.2", step_talk(), tries=300, sleep=sleep)
    assert 30 < len(waits) < 95


def test_a_planner_with_other_prompts_gets_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "step.j2").write_text("Where to?", encoding="utf-8")
    model = SimulatedModel(Profile(), np.random.default_rng(0))
    planner = LanguagePlanner(0, model, PromptSet.load(tmp_path))
    question = StepQuestion(mission=CIRCLE, robot=0, round=1, position=(1.0, 2.0), neighbors=(), plan=PLAN, slot=0)
    with pytest.raises(InputError, match="the only ones understood"):
        asyncio.run(planner.step(question))


def test_a_planner_and_a_malformed_model_get_along() -> None:
    model = SimulatedModel(parse_profile("malformed@0.5"), np.random.default_rng(3))
    tries: list[int] = []
    planner = LanguagePlanner(
        0, model, TEXT, max_retries=30, on_attempt=lambda attempt: tries.append(attempt.call.attempt)
    )

    async def walk() -> None:
        for round_ in range(10):
            question = StepQuestion(
                mission=CIRCLE, robot=0, round=round_, position=(20.0, 20.0), neighbors=(), plan=PLAN, slot=0
            )
            assert isinstance(await planner.step(question), StepAnswer)

    asyncio.run(walk())
    assert max(tries) >= 1


def test_profiles_compose() -> None:
    assert parse_profile("distorted@0.3, overshoot@.25,slow").rates == {"distorted": 0.3, "overshoot": 0.25, "slow": 1}
    assert parse_profile("ideal") == Profile(text="ideal")
    assert parse_profile("ideal,flaky@1e-1").rates == {"flaky": 0.1}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "unknown profile ''; expected one of ideal, distorted"),
        (
            "perfect",
            "expected one of ideal, distorted, overshoot, collapse, malformed, slow, flaky, brisk, overlong",
        ),
        ("ideal,", "unknown profile"),
        ("text", "unknown profile"),
        ("overshoot@", "overshoot@RATE"),
        ("overshoot@1.1", "overshoot@RATE with a rate from 0 to 1"),
        ("overshoot@-0.1", "from 0 to 1"),
        ("overshoot@nan", "from 0 to 1"),
        ("overshoot@half", "from 0 to 1"),
        ("overshoot@0.1,overshoot@0.2", "there twice"),
        ("ideal@0.5", "ideal without a rate"),
        ("placeholders", "did you mean 'placeholder'?"),
        ("placeholder@0.6,echo@0.5", "add up to 1 at most"),
        ("smollm2-135m,gemma3-270m", "add up to 1 at most"),
    ],
)
def test_profiles_that_do_not_exist(text: str, why: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_profile(text)
    assert caught.value.field == "model" and caught.value.value == f"simulated:{text}" and why in caught.value.says


def test_the_documentation_lists_exactly_the_profiles() -> None:
    text = (ROOT / "docs" / "reference" / "simulated.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| `([a-z0-9-]+)` \|", text, re.MULTILINE) == [*PROFILES, *SEEN, *SMALL_MODELS]
    assert list(PROFILES) == ["ideal", *FAILURES]


def test_turning_keeps_the_reference_unchanged() -> None:
    ideal = np.array(CIRCLE.ideal)
    rotated(ideal, (50, 50), 1.0)
    np.testing.assert_array_equal(ideal, np.array(CIRCLE.ideal))


@pytest.mark.parametrize("places", [8, 12])
def test_stand_in_plans_as_many_places_as_the_prompt_asks(places: int) -> None:
    mission = CIRCLE.change(places=places)
    plan, slot = parse_plan(responder().answer(plan_talk(mission, robot=9)), places, 2)
    assert len(plan) == places and slot == 9 % places and check_plan(mission, plan) is None


STEP_QUESTION = StepQuestion(mission=CIRCLE, robot=3, round=1, position=(20, 20), neighbors=(), plan=PLAN, slot=0)
CORRECTION = [
    ("assistant", "Position: [1, 2, 3]"),
    ("user", TEXT.retry("the position has 3 numbers, 2 are required.", STEP_QUESTION)),
]
SPOILED = {
    "again": ("Position: [1, 2, 3]", "has 3 numbers"),
    "parrot": ("the position has 3 numbers, 2 are required", ""),
    "placeholder": ("Position: [x, y]", "placeholders"),
    "echo": ("Where do you go in this round?", ""),
    "miscounted": (", 0]", "has 3 numbers"),
    "cutoff": ("a full step straight", ""),
    "units": (" m, ", None),
    "retracted": ("Corrected:", None),
    "base": ("Position: ", None),
}
"""Words of a spoiled step, and of its refusal; None where the right step is read from it."""


@pytest.mark.parametrize("fault", SPOILED)
def test_an_answer_is_spoiled_as_those_of_small_models(fault: str) -> None:
    talk = step_talk()
    text, right = responder(fault).answer([*talk, *CORRECTION]), parse_step(responder().answer(talk), 2)
    said, reason = SPOILED[fault]
    assert said in text
    if reason is None:
        assert parse_step(text, 2) == right
    else:
        with pytest.raises(AnswerError, match=reason or "no complete position"):
            parse_step(text, 2)


def test_other_places_and_axes_are_read_as_they_stand() -> None:
    plan, slot = parse_plan(responder("canonical").answer(plan_talk()), 10, 2)
    swapped, _ = parse_plan(responder("canonical,swapped").answer(plan_talk()), 10, 2)
    assert swapped.points == tuple(point[::-1] for point in plan.points)
    assert parse_plan(responder("canonical,base").answer(plan_talk()), 10, 2) == (plan, slot + 1)
    together, _ = parse_plan(responder("canonical,coincident").answer(plan_talk()), 10, 2)
    assert set(together.points) == {plan.points[0]} and check_plan(CIRCLE, together) is not None


@pytest.mark.parametrize("model", SMALL_MODELS)
def test_small_models_fail_at_the_rates_that_were_seen(model: str) -> None:
    with (ROOT / "docs" / "data" / "small-models.csv").open(encoding="utf-8", newline="") as file:
        counts = {row["Profile"]: int(row[model]) for row in csv.DictReader(file)}
    answers = counts.pop("all")
    assert {name: round(share * answers) for name, share in SMALL_MODELS[model].items()} == {
        name: count for name, count in counts.items() if count
    }
    right = responder().answer(step_talk())
    first = [reply.text for reply in ask(model, step_talk(), 300)]
    total = sum(SMALL_MODELS[model].values())
    assert abs(sum(text != right for text in first) / 300 - total) < 0.1
    assert not any(said in text for text in first for said in ("cannot be used", "Position: [1, 2, 3]"))
    later = [reply.text for reply in ask(model, [*step_talk(), *CORRECTION], 300)]
    again = SMALL_MODELS[model].get("again", 0.0)
    assert abs(sum(text == "Position: [1, 2, 3]" for text in later) / 300 - again) < 0.1 and AFTER_REJECTION


def test_a_cut_off_answer_says_so() -> None:
    assert {reply.finish_reason for reply in ask("cutoff@0.5", step_talk(), 20)} == {"length", "stop"}
