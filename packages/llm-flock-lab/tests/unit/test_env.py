"""The PettingZoo environment: PettingZoo's own checks, and that good policies fly as good models do."""

import copy
import importlib
import pickle
import sys
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pettingzoo")
from pettingzoo.test import parallel_api_test, parallel_seed_test

from llm_flock.errors import InputError
from llm_flock.mission import Mission
from llm_flock_lab._env import PLAN, FlockEnv, parallel_env

SQUARE: dict[str, Any] = {"shape": "square", "n_robots": 4}
CONTROLS = ["waypoints", "questions"]


def towards_goal(env: FlockEnv, seen: dict[str, Any]) -> Any:
    """A policy that plans the ideal points, and flies straight."""
    ideal = env.mission.ideal
    assert ideal is not None
    step = (seen["goal"] - seen["position"]) * seen["has_goal"]
    step *= min(1.0, env.mission.max_step / max(1e-9, float(np.linalg.norm(step))))
    if env.control == "waypoints":
        return step / env.mission.max_step
    return {"plan": np.array(ideal), "slot": 0, "waypoint": seen["position"] + step}


def fly(env: FlockEnv, seed: int | None = 3) -> tuple[float, dict[str, Any]]:
    """One episode by that policy: the sum of rewards, and what the last step returned."""
    seen, _ = env.reset(seed=seed)
    total, last = 0.0, {}
    while env.agents:
        acting = set(env.agents)
        seen, rewards, over, cut, told = env.step({agent: towards_goal(env, seen[agent]) for agent in env.agents})
        assert all(set(part) == acting for part in (seen, rewards, over, cut, told))
        assert all(env.observation_space(agent).contains(seen[agent]) for agent in seen)
        total += sum(rewards.values())
        last = {"over": over, "cut": cut, "told": told}
    return total, last


@pytest.mark.parametrize("control", CONTROLS)
def test_pettingzoos_own_checks_pass(control: Any) -> None:
    parallel_api_test(parallel_env(**SQUARE, control=control, rounds=12), num_cycles=60)
    parallel_seed_test(lambda: parallel_env(**SQUARE, control=control, rounds=8, noise=0.1), num_cycles=20)


@pytest.mark.parametrize("control", CONTROLS)
def test_a_good_policy_forms_the_shape(control: Any) -> None:
    total, last = fly(parallel_env(**SQUARE, control=control))
    assert all(last["over"].values()) and not any(last["cut"].values())
    assert total > 40, "ten for each robot when formed, and the way to the goals"
    assert all(told["origin"] == "model" for told in last["told"].values())


def test_after_the_last_round_robots_are_truncated() -> None:
    _, last = fly(parallel_env(**SQUARE, rounds=2))
    assert all(last["cut"].values()) and not any(last["over"].values())


def test_a_robot_that_dies_is_terminated_and_the_others_go_on() -> None:
    env = parallel_env(**SQUARE, kill="1@3", rounds=6)
    seen, _ = env.reset(seed=1)
    gone: list[str] = []
    while env.agents:
        seen, _, over, _, _ = env.step({agent: towards_goal(env, seen[agent]) for agent in env.agents})
        gone += [agent for agent, ended in over.items() if ended]
    assert gone == ["robot_1"]


def rest_of(env: FlockEnv, seen: dict[str, Any], most: int = 100) -> list[str]:
    """All that the next steps return, as text."""
    told: list[str] = []
    while env.agents and len(told) < most:
        seen, *others = env.step({agent: towards_goal(env, seen[agent]) for agent in env.agents})
        told.append(repr((seen, others, env.state().tolist())))
    return told


@pytest.mark.slow
@pytest.mark.parametrize(
    ("control", "fields"),
    [
        ("waypoints", {"protocol": "released"}),
        ("questions", {}),
        ("questions", {"gaps": "replan", "render_mode": "rgb_array"}),
    ],
    ids=str,
)
def test_copies_go_on_as_the_original_does(control: Any, fields: dict[str, Any]) -> None:
    """Made after `reset` or in the middle, in a process or between two; none changes another's episode."""
    hard: dict[str, Any] = {"noise": 0.2, "loss": 0.2, "delay": 1, "kill": "1@6", "rounds": 12}
    env = parallel_env(**SQUARE, control=control, **hard, **fields)
    seen, _ = env.reset(seed=4)
    at_start = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    for _ in range(5):
        seen, *_ = env.step({agent: towards_goal(env, seen[agent]) for agent in env.agents})
    halfway = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = rest_of(env, seen)
    assert len(expected) > 5
    for one in halfway:
        assert rest_of(one, seen) == expected
    again = parallel_env(**SQUARE, control=control, **hard, **fields)
    first, _ = again.reset(seed=4)
    whole = rest_of(again, first)
    assert whole[5:] == expected
    for one in at_start:
        assert rest_of(one, first) == whole
        assert repr(one.reset(seed=9)) == repr(env.reset(seed=9)), "a copy can begin again"


def test_the_seed_decides_the_start() -> None:
    env = parallel_env(**SQUARE, seed=5)
    first, second, again = (e.reset()[0]["robot_0"]["position"] for e in (env, env, parallel_env(**SQUARE, seed=5)))
    assert np.array_equal(first, again) and not np.array_equal(first, second)


def test_questions_come_before_steps_and_bad_plans_are_refused() -> None:
    env = parallel_env(Mission(shape="square", n_robots=4), control="questions")
    seen, _ = env.reset(seed=0)
    assert all(seen[agent]["asks"] == PLAN for agent in env.agents)
    nowhere = {"plan": np.zeros((4, 2)), "slot": 0, "waypoint": np.full(2, np.nan)}
    env.step(dict.fromkeys(env.agents, nowhere))
    seen, *_ = env.step(dict.fromkeys(env.agents, nowhere))
    assert not any(seen[agent]["has_goal"] for agent in env.agents)


def test_pictures_have_one_size() -> None:
    env = parallel_env(**SQUARE, render_mode="rgb_array")
    assert env.render() is None
    seen, _ = env.reset(seed=0)
    before = env.render()
    env.step({agent: towards_goal(env, seen[agent]) for agent in env.agents})
    after = env.render()
    assert before is not None and after is not None and before.shape == after.shape and before.dtype == np.uint8
    assert not np.array_equal(before, after)
    assert env.record().rounds == 1 and not env.record().run.simulated


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"control": "joystick"}, "control"),
        ({"model": "openai:o3-mini"}, "model"),
        ({"join": "1@3"}, "join"),
        ({"out": "runs/x"}, "out"),
        ({"no_such_field": 1}, "no_such_field"),
    ],
)
def test_environment_rejects_options_that_it_cannot_follow(options: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        parallel_env(**SQUARE, **options)
    assert caught.value.field == field


def test_without_the_extra_the_line_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "llm_flock_lab._env")
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    with pytest.raises(ImportError, match=r"pip install 'llm-flock\[env\]'"):
        importlib.import_module("llm_flock_lab._env")


def test_wrong_actions_are_refused() -> None:
    env = parallel_env(**SQUARE)
    with pytest.raises(InputError, match="reset"):
        env.step({})
    env.reset(seed=0)
    for wrong, cause in (
        ({}, "an action for every agent"),
        (dict.fromkeys(env.agents, "up"), "numbers of shape"),
        (dict.fromkeys(env.agents, np.zeros(3)), r"not \(3,\)"),
    ):
        with pytest.raises(InputError, match=cause):
            env.step(wrong)
