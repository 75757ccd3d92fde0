"""The committed path of a robot, and every reason to ask its planner again."""

from __future__ import annotations

import pytest

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, StepAnswer, StepQuestion
from llm_flock.protocol._motion.committed_path import CommittedPath, Trigger

MISSION = Mission(shape="triangle", n_robots=3)
GOAL = (60.0, 50.0)
PLAN = Plan.of([GOAL, (90.0, 90.0), (50.0, 90.0)])
START = (42.0, 50.0)
WAY = ((48.0, 50.0), (54.0, 50.0), GOAL)
FAR = {1: (44.0, 70.0)}


def asked(position: Point = START, **changes: object) -> StepQuestion:
    fields = {
        "mission": MISSION,
        "robot": 0,
        "round": 1,
        "position": position,
        "neighbors": (),
        "plan": PLAN,
        "slot": 0,
        "horizon": 20,
    }
    return StepQuestion(**fields | changes)  # pyright: ignore[reportArgumentType]


def foresee(*way: Point, mission: Mission = MISSION) -> CommittedPath:
    answer = StepAnswer(waypoint=way[0], path=way[1:])
    return CommittedPath.of(asked(mission=mission), answer, FAR)


def flown(committed: CommittedPath, *places: Point) -> CommittedPath:
    """The robot was at START and flew to these places, one a round."""
    here = START
    for place in places:
        committed, here = committed.after_step(here, place), place
    return committed


def test_committed_path_needs_no_question_and_holds_at_goal() -> None:
    committed = foresee(*WAY)
    here = START
    for k, waypoint in enumerate(WAY):
        assert committed.path == WAY[k:]
        committed = committed.after_step(here, waypoint)
        here = waypoint
        assert committed.trigger(asked(here), FAR) is None
    for _ in range(3):
        assert committed.path == (GOAL,)
        committed = committed.after_step(GOAL, GOAL)
        assert committed.trigger(asked(GOAL), {**FAR, 2: (62.0, 50.0)}) is None, "with any robot near"


FAILURE = NoAnswer(cause="answer", reason="none")


def test_a_failed_question_is_asked_again_even_at_the_goal() -> None:
    committed = CommittedPath.of(asked(), FAILURE, FAR)
    assert committed.after_step(START, WAY[0]).trigger(asked(GOAL), FAR) is Trigger.NO_ANSWER


@pytest.mark.parametrize(
    ("question", "reason"),
    [
        (asked(WAY[0], slot=1), Trigger.NEW_GOAL),
        (asked(WAY[0], target=(20.0, 50.0)), Trigger.NEW_GOAL),
        (asked(WAY[0], plan=Plan.of([(50.0, 80.0), GOAL, START])), Trigger.NEW_PLAN),
        (asked(WAY[0], plan=Plan.of([GOAL, (90.0, 80.0), START])), None),
        (asked(WAY[0], plan=Plan.of([(80.0, 51.0), (90.0, 80.0), START])), None),
        (asked(WAY[0], target=(80.0, 55.0)), None),
        (asked(WAY[0], target=(57.0, 50.0)), None),
        (asked(WAY[0], target=(50.0, 50.0)), Trigger.NEW_GOAL),
    ],
)
def test_another_goal_is_a_reason_unless_it_lies_the_same_way(question: StepQuestion, reason: Trigger | None) -> None:
    assert flown(foresee(*WAY), WAY[0]).trigger(question, FAR) is reason


def test_farther_goal_the_same_way_is_asked_about_at_path_end() -> None:
    committed = flown(foresee(*WAY), *WAY)
    assert committed.trigger(asked(GOAL, target=(80.0, 50.0)), FAR) is Trigger.NEW_GOAL
    over = flown(foresee(WAY[0]), WAY[0])
    assert over.trigger(asked(WAY[0], target=(80.0, 50.0)), FAR) is Trigger.NEW_GOAL


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ((48.0, 50.0), None),
        ((48.0, 51.4), None),
        ((44.0, 50.0), None),
        ((48.0, 51.6), Trigger.ALTERED),
        ((42.0, 50.0), Trigger.ALTERED),
        ((43.0, 50.0), Trigger.ALTERED),
    ],
)
def test_step_flown_differently_is_a_reason_beyond_a_tolerance(place: Point, reason: Trigger | None) -> None:
    committed = flown(foresee(*WAY), place)
    assert committed.trigger(asked(place), FAR) is reason
    if reason is not None:
        after = committed.after_step(place, WAY[1])
        assert after.trigger(asked(WAY[1]), FAR) is None, "the last step counts, not an earlier one"


def test_a_path_that_is_over_short_of_the_goal_is_a_reason() -> None:
    assert flown(foresee(WAY[0]), WAY[0]).trigger(asked(WAY[0]), FAR) is Trigger.USED_UP


def test_only_a_new_obstacle_in_the_way_that_is_left_is_a_reason() -> None:
    def with_disc(*center: float) -> Mission:
        return MISSION.model_copy(update={"obstacles": (Obstacle(center=center, radius=1.0),)})

    def meets(committed: CommittedPath, *center: float) -> Trigger | None:
        return committed.trigger(asked(WAY[0], mission=with_disc(*center)), FAR)

    committed = flown(foresee(*WAY), WAY[0])
    assert meets(committed, 54.0, 52.0) is Trigger.OBSTACLE
    assert meets(committed, 54.0, 52.6) is None
    assert meets(committed, 44.0, 50.0) is None
    knowing = flown(foresee(*WAY, mission=with_disc(54.0, 52.0)), WAY[0])
    assert meets(knowing, 54.0, 52.0) is None


@pytest.mark.parametrize(
    ("robot", "place", "reason"),
    [
        (2, (54.0, 52.9), Trigger.NEIGHBOUR),
        (2, (54.0, 53.1), None),
        (2, (44.0, 50.0), None),
        (1, (54.0, 52.9), None),
    ],
)
def test_unseen_robot_coming_near_the_way_is_a_reason_to_ask(robot: int, place: Point, reason: Trigger | None) -> None:
    committed = flown(foresee(*WAY), WAY[0])
    assert committed.trigger(asked(WAY[0]), {robot: place}) is reason
