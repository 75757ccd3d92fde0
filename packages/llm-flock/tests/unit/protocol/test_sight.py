"""What robots assume of their sensors: margins, rests, and what is refused."""

from typing import Any

import pytest

import llm_flock
from llm_flock.errors import InputError
from llm_flock.events import Origin
from llm_flock.mission import Mission
from llm_flock.protocol._motion.safety import ShieldedSafety
from llm_flock.runtime import build_config
from llm_flock.runtime._schedule import Sight


@pytest.mark.parametrize(
    ("sense_range", "error", "delay", "expected"),
    [
        (15.0, 0.0, 0.0, (0.0, 0)),
        (15.0, 0.5, 0.0, (0.5, 0)),
        (15.0, 0.0, 1.0, (0.0, 1)),
        (15.0, 0.3, 2.0, (0.3, 2)),
        (15.0, 0.0, 0.1, (0.0, 1)),  # sensors do not see far enough for a body that flies on meanwhile
        (16.2, 0.0, 0.1, (0.3, 0)),
        (16.1, 0.0, 0.1, (0.0, 1)),
        (30.0, 0.0, 0.25, (0.75, 0)),
        (30.0, 0.0, 0.3, (0.0, 1)),  # half of what others fly unseen is over a quarter of the safe distance
        (30.0, 0.5, 0.1, (0.5, 1)),
        (30.0, 0.4, 0.1, (0.7, 0)),
        (30.0, 0.0, 3.25, (0.75, 3)),
    ],
)
def test_margins_are_used_where_there_is_room_else_rests(
    sense_range: float, error: float, delay: float, expected: tuple[float, int]
) -> None:
    sight = Sight.of(Mission(sense_range=sense_range), error, delay)
    assert (sight.error, sight.rests) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("options", "field", "says"),
    [
        ({"drift": 0.8}, "drift", "at most safe_distance / 4 = 0.75"),
        ({"drift": 0.5, "noise": 0.3}, "noise", "noise and drift together"),
        ({"drift": 0.3, "noise": 0.5}, "noise", "noise and drift together"),
        ({"drift": -0.1}, "drift", "at least 0"),
        ({"sensing_delay": -1}, "sensing_delay", "at least 0"),
        ({"sensing_delay": 21}, "sensing_delay", "at most 20"),
        ({"sensing_delay": 1, "velocity": (1, 0)}, "sensing_delay", "would fall behind"),
        (
            {"sensing_delay": 1, "changes": [{"round": 3, "robot": 0, "set": {"velocity": [1, 0]}}]},
            "sensing_delay",
            "would fall behind",
        ),
    ],
)
def test_bounds_that_leave_no_room_are_refused(options: dict[str, Any], field: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        build_config(**options)
    assert caught.value.field == field


def test_without_the_shield_nobody_rests_and_more_is_allowed() -> None:
    config = build_config(sensing_delay=2, drift=2.0, noise=1.0, velocity=(1, 0), shield=False)
    assert config.sight == Sight(error=3.0)


def test_all_rest_in_the_same_rounds() -> None:
    team = [ShieldedSafety(robot, Mission(), 0.0, rests=2) for robot in range(3)]
    assert [[robot.rests(number) for number in range(1, 8)] for robot in team] == [
        [False, True, True, False, True, True, False]
    ] * 3


def test_a_late_run_forms_in_turns_of_flight_and_rest() -> None:
    usual = llm_flock.run(seed=3)
    late = llm_flock.run(seed=3, sensing_delay=1)
    assert usual.formed and late.formed and usual.summary.nearest_read is None
    moves = [bool((a != b).any()) for a, b in zip(late.positions, late.positions[1:], strict=False)]
    assert moves[:4] == [True, False, True, False] and not any(moves[1::2])
    assert late.summary.rounds_to_formed == 2 * (usual.summary.rounds_to_formed or 0) - 1
    assert late.summary.model_calls < 2 * usual.summary.model_calls
    assert late.summary.min_separation == usual.summary.min_separation
    assert late.summary.waypoints[Origin.HOLD.value] >= 10 * (late.summary.rounds // 2)


@pytest.mark.no_cover
@pytest.mark.parametrize("sense_range", [15.0, 20.0])
@pytest.mark.parametrize("protocol", ["flock", "paper"])
def test_the_safe_distance_is_kept_in_truth(protocol: Any, sense_range: float) -> None:
    options: dict[str, Any] = {"sense_range": sense_range, "sensing_delay": 0.15, "noise": 0.1, "drift": 0.15}
    found = [
        llm_flock.run(seed=seed, protocol=protocol, start_area=((35, 35), (65, 65)), rounds=40, **options).summary
        for seed in range(2)
    ]
    nearest = min(s.min_separation or 0.0 for s in found)
    if protocol == "paper":  # nothing keeps its robots apart
        assert nearest < 3.0
        return
    assert all(s.formed for s in found) and nearest >= 3.0 - 1e-6
    assert all(s.nearest_read is not None and s.nearest_read != s.min_separation for s in found)


@pytest.mark.no_cover
def test_deadlines_are_longer_for_teams_that_rest() -> None:
    usual, late = (build_config(sensing_delay=delay).most_rounds for delay in (0, 3))
    assert late - 20 == 4 * (usual - 20)
    two: dict[str, Any] = {"shape": "line", "n_robots": 2, "start_positions": ((20, 50), (20, 60)), "seed": 1}
    flown = [llm_flock.run(**two, noise=0.75, sensing_delay=delay).summary for delay in (0, 1)]
    assert [s.formed for s in flown] == [False, False]
    assert [s.rounds for s in flown] == [3 * pace * (flown[0].lower_bound_rounds or 0) + 22 for pace in (1, 2)]
