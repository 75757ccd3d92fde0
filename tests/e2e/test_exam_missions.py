"""The second part of the exam: whole missions, by the model alone and with help."""

from __future__ import annotations

from llm_flock.exam.examinee import Setup
from llm_flock.exam.missions import Missions, fly_missions


def flown(model: str) -> dict[str, Missions]:
    found = fly_missions(Setup(model=model), 2, teams=(("triangle", 3),))
    return {one.fallback: one for one in found}


def test_a_good_model_needs_no_help() -> None:
    for one in flown("simulated:ideal").values():
        assert (one.team, one.trials, one.broken, one.formed, one.by_models) == ("triangle 3", 2, 0, 2, 2)
        assert one.violations == 0
        assert one.ratio is not None and one.ratio >= 1.0 and one.cost_per_formed == 0.0
        assert one.own_waypoints is not None and one.own_waypoints > 0.8


def test_a_model_without_usable_steps_forms_only_with_help() -> None:
    found = flown("simulated:overlong,collapse")
    assert [one.broken for one in found.values()] == [0, 0]
    assert found["hold"].formed == 0 and found["hold"].cost_per_formed is None and found["hold"].ratio is None
    assert found["breaker"].formed == 2 and found["breaker"].by_models == 0
