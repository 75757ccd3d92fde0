"""Robots make progress whatever their models answer, and all of a team come to know the last order."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from benchmarks import minds, orders

import llm_flock
from llm_flock.arrays import Point
from llm_flock.llm._port import Call
from llm_flock.llm._simulated.prompt_reader import StepPrompt
from llm_flock.mission import Mission


@cache
def calls_of_good_minds(team: str, seed: int) -> int:
    return minds.fly(team, "still", "none", seed).calls


@pytest.mark.parametrize("mind", ["still", "wary", "collapse"])
@pytest.mark.parametrize(("team", "seed"), [("clump 10", 0), ("clump 10", 3), ("corner 2", 1)])
def test_minds_that_wait_hold_no_team_up(mind: str, team: str, seed: int) -> None:
    seen = minds.fly(team, mind, "all", seed)
    assert seen.formed is not None and seen.says and seen.separation >= 3.0 - 1e-6
    assert seen.calls <= 2.5 * calls_of_good_minds(team, seed)


class Skittish(minds.Mind):
    """It steps away from any robot that is near, also from a dead one beside its place."""

    __module__ = "skittish"

    async def ask(self, call: Call) -> str:
        if call.kind == "plan":
            return f"Plan: [[45, 45], [55, 45], [55, 55], [45, 55]]\nmy plan: {call.robot % 4}"
        return await super().ask(call)

    def _choose(self, prompt: StepPrompt) -> Point:
        here = prompt.position
        near = min(prompt.seen(), key=lambda other: math.dist(other, here), default=None)
        if self._kind == "calm" or near is None or math.dist(near, here) >= 3.6:
            return super()._choose(prompt)
        share = prompt.reach / max(math.dist(near, here), 1e-9)
        return here[0] - share * (near[0] - here[0]), here[1] - share * (near[1] - here[1])


def test_a_probe_that_leads_away_closes_no_breaker() -> None:
    """A place is 2.7 from a dead body, so others leave a robot at it no room."""
    starts = [[30, 30], [70, 30], [30, 70], [70, 70], [56.9, 56.9]]
    calls = list[int]()
    for kind in ("calm", "skittish"):
        flown = llm_flock.run(
            shape="square",
            n_robots=5,
            places=4,
            model=[Skittish(kind, k) for k in range(5)],
            seed=1,
            rounds=300,
            start_positions=starts,
            kill="4@1",
            trace=False,
        )
        assert flown.formed
        calls.append(flown.summary.model_calls)
    assert calls[1] <= 1.5 * calls[0]


@pytest.mark.parametrize("seed", [5, 6])
def test_all_robots_follow_the_last_of_twelve_orders(seed: int) -> None:
    followed = orders.fly(12, seed)
    assert followed.rounds is not None and followed.separation >= 3.0 - 1e-6


def test_a_robot_left_behind_by_two_orders_is_found() -> None:
    """It stands alone at the end of a line that the others have left for a circle."""
    sets = {"shape": "line", "center": [50, 50]}, {"shape": "circle", "center": [50, 50]}
    changes = [{"round": 5, "robot": 5, "set": sets[0]}, {"round": 10, "robot": 0, "set": sets[1]}]
    flown = llm_flock.run(seed=0, rounds=300, changes=changes, trace=False)
    assert minds.judge(flown.positions[10:], np.array(Mission().ideal), 10.0) is not None
    assert flown.formed and len(flown.positions) < 60


@pytest.mark.parametrize(("each", "later", "seed"), [(1, 4, 2), (1, 4, 3), (2, 1, 4), (4, 1, 1)])
def test_groups_with_orders_of_their_own_find_each_other(each: int, later: int, seed: int) -> None:
    """Two groups out of touch are each given an order; the later one holds for all."""
    rng = np.random.default_rng(seed)
    offsets = np.array([(5.0 * (k % 3), 5.0 * (k // 3)) for k in range(each)])
    starts = np.concatenate([offsets + place for place in ((12.0, 70.0), (80.0, 20.0))]) + rng.uniform(-0.5, 0.5, 2)
    changes = [
        {"round": 1, "robot": 0, "set": {"center": [20, 80]}},
        {"round": later, "robot": each, "set": {"center": [80, 20]}},
    ]
    flown = llm_flock.run(
        n_robots=2 * each, seed=seed, rounds=300, start_positions=starts.tolist(), changes=changes, trace=False
    )
    assert flown.formed and np.allclose(flown.positions[-1].mean(axis=0), (80.0, 20.0), atol=1.0)


def test_robot_that_returns_after_the_search_finds_the_team() -> None:
    """The team was sent elsewhere meanwhile, and has given its place up."""
    changes = [{"round": 18, "robot": 0, "set": {"center": [75, 50]}}]
    options = {"kill": "1@15", "join": "1@60", "changes": changes, "trace": False, "center": (20.0, 50.0)}
    flown = llm_flock.run(shape="line", n_robots=3, seed=3, rounds=260, **options)
    assert flown.formed and np.allclose(flown.positions[-1].mean(axis=0), (75.0, 50.0), atol=1.0)


@pytest.mark.parametrize(("n", "dies"), [(3, "1@10"), (5, "2@10")])
def test_survivors_out_of_touch_replan_together(n: int, dies: str) -> None:
    """A dead body in sight is no company, and a plan without a vacant place no reason to stay."""
    starts = [[50.0 - 5.0 * (n - 1) + 10.0 * k, 50.0] for k in range(n)]
    changes = [{"round": 18, "robot": 0, "set": {"center": [50, 20]}}]
    options = {"kill": dies, "gaps": "replan", "start_positions": starts, "changes": changes, "trace": False}
    flown = llm_flock.run(shape="line", n_robots=n, seed=1, rounds=280, model="simulated:ideal,canonical", **options)
    assert flown.formed and flown.summary.plans_in_use == 1


def test_the_judge_of_minds_sees_what_is_no_circle() -> None:
    circle = np.array(Mission().ideal)
    turned = circle[::-1, ::-1]
    moved = circle + [0.0, 1.5]
    dented = circle.copy()
    dented[3] = 50.0 + 0.9 * (dented[3] - 50.0)
    found = [minds.judge(np.array([places] * 3), circle, 10.0) for places in (circle, turned, moved, dented)]
    assert found == [0, 0, None, None] and minds.judge(np.array([circle] * 2), circle, 10.0) is None
    crossing = np.array([[[0.0, 0.0], [4.0, 0.0]], [[4.0, 0.1], [0.0, 0.1]]])
    assert minds.separation(crossing) == pytest.approx(0.0)
