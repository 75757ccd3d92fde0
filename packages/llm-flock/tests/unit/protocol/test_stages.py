"""Missions that fix their orientation, prefer robots for places, or have stages, which the team enters by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import llm_flock
from llm_flock.errors import InputError
from llm_flock.mission import Mission
from llm_flock.plan import Drawing, Plan
from llm_flock.protocol._agreement.preferences import costs
from llm_flock.protocol._parts import Membership
from llm_flock.protocol._verification.plans import check_plan
from llm_flock.runtime import RunOrders, Trial, build_config

GROUPS = (
    '{"groups":[{"role":"scouts","count":3,"draw":[{"shape":"triangle"}]},'
    '{"role":"others","at":[60,0],"draw":[{"shape":"line"}]}]}'
)


@pytest.mark.parametrize("model", ["simulated:ideal", "geometry"])
def test_a_formation_points_where_it_is_told(model: str) -> None:
    flown = llm_flock.run(Mission(shape="wedge", n_robots=5, turn=-90), seed=1, model=model, trace=False)
    offset = flown.positions[-1] - flown.positions[-1].mean(axis=0)
    tip = offset[offset[:, 0].argmax()]
    assert flown.formed and abs(tip[1]) < 0.5, "the tip is in the east"
    assert (np.abs(offset[:, 1]) > 1).sum() == 4


def test_a_plan_of_a_program_is_seen_from_another_origin() -> None:
    program = '{"draw":[{"text":"H"}]}'
    plan = Plan(drawing=Drawing(program=program, places=10, spacing=5.0, center=(50.0, 50.0), turn_rad=0.3))
    assert plan.mapped((10.0, 20.0), 2.0).array == pytest.approx(2.0 * plan.array + np.array([10.0, 20.0]))
    assert Membership().missing == 0


def test_a_plan_of_another_orientation_is_refused() -> None:
    fixed = Mission(shape="wedge", n_robots=5, turn=0)
    other = Plan.of(Mission(shape="wedge", n_robots=5, turn=20).ideal or ())
    assert check_plan(fixed, Plan.of(fixed.ideal or ())) is None
    assert "off the shape" in (check_plan(fixed, other) or "")
    assert check_plan(Mission(shape="wedge", n_robots=5), other) is None, "any orientation will do"


@pytest.mark.parametrize("turn", [0, pytest.param(180, marks=pytest.mark.no_cover)])
def test_sides_and_named_robots_get_their_group(turn: float) -> None:
    def of_the_first_group(*wishes: Any) -> tuple[set[int], set[int]]:
        fields: dict[str, Any] = {"shape": f"program:{GROUPS}", "spacing": 8, "comm_range": 100, "turn": turn}
        flown = llm_flock.run(Mission(n_robots=9, prefer=wishes, **fields), seed=1, trace=False)
        assert flown.formed
        along = flown.positions[-1][:, 0] * (1 if turn == 0 else -1)
        return set(np.argsort(along)[:3].tolist()), set(np.argsort(flown.positions[0][:, 0])[:3].tolist())

    there, leftmost = of_the_first_group({"side": "west", "group": 0})
    assert there == leftmost, "wherever their place is"
    assert of_the_first_group(*({"robot": robot, "group": 0} for robot in (0, 4, 7)))[0] == {0, 4, 7}


@pytest.mark.parametrize(("way", "best"), [("shortest", {4}), ("center", {2}), ("edge", {0, 4})])
def test_a_preferred_way_outweighs_the_ways_of_others(way: str, best: set[int]) -> None:
    """In a row of five places, seen from beyond its last one."""
    plain, place = Mission(shape="line", n_robots=5), np.array([(90.0, 50.0)] * 5)
    plan = Plan.of(sorted(plain.ideal or ()))
    ways = np.linalg.norm(place[:, None] - plan.array, axis=2)
    preferred: Any = {"robot": 1, "way": way}
    found = costs(Mission(shape="line", n_robots=5, prefer=(preferred,)), plan, range(5), place, ways)
    assert int(found[1].argmin()) in best
    others = [0, 2, 3, 4]
    assert (found[others] == (ways**2)[others]).all()
    assert np.ptp(found[1]) > 10 * np.ptp(ways[1] ** 2)


@pytest.mark.no_cover
def test_a_weak_robot_flies_to_its_nearest_place() -> None:
    def ways(**more: Any) -> list[float]:
        found: list[float] = []
        for seed in range(3):
            mission = Mission(n_robots=8, comm_range=100, turn=0, **more)
            flown = llm_flock.run(mission, seed=seed, trace=False)
            assert flown.formed
            gone = float(np.linalg.norm(flown.positions[-1][3] - flown.positions[0][3]))
            nearest = np.linalg.norm(np.array(mission.ideal) - flown.positions[0][3], axis=1).min()
            found.append(gone - float(nearest))
        return found

    assert max(ways(prefer=({"robot": 3, "way": "shortest"},))) < 0.5 < max(ways())


STAGES: Any = ({"set": {"shape": "line", "turn": 90, "hold": 4}}, {"set": {"shape": "wedge"}})


HARD = {"loss": 0.3}, {"kill": "0@3", "gaps": "replan"}, {"noise": 0.2}


@pytest.mark.parametrize("more", [{}, *(pytest.param(more, marks=pytest.mark.no_cover) for more in HARD)])
def test_a_team_goes_on_by_its_own_view_when_it_has_formed(more: dict[str, Any]) -> None:
    flown = llm_flock.run(Mission(n_robots=8, then=STAGES), seed=2, trace=False, **more)
    first, second, third = flown.summary.missions
    assert [one.shape for one in (first, second, third)] == ["circle", "line", "wedge"]
    assert flown.formed and first.formed is not None and second.formed is not None
    assert second.round >= first.formed + 2, "all have stood there for three rounds"
    assert third.round >= second.formed + 4, "held"
    assert (flown.summary.min_separation or 0.0) >= 3.0 - 0.4 * ("noise" in more)


@pytest.mark.no_cover
def test_a_stage_waits_for_its_round_or_an_order() -> None:
    by_round: Any = ({"set": {"shape": "line"}, "when": 30},)
    flown = llm_flock.run(Mission(n_robots=4, then=by_round), trace=False)
    assert flown.formed and flown.summary.missions[-1].round == 30
    by_order: Any = ({"set": {"shape": "line"}, "when": "order"},)
    waits = Mission(n_robots=4, then=by_order)
    with pytest.raises(InputError, match="nobody can give"):
        llm_flock.run(waits)
    orders = RunOrders(build_config({"mission": waits.model_dump()}))

    async def steer(trial: Trial) -> None:
        orders.carry_out(trial)
        if trial.round == 20:
            orders.proceed()

    assert llm_flock.run(waits, steer=steer, trace=False).summary.missions[-1].round == 22
    with pytest.raises(InputError, match="no stage of the mission is left"):
        Mission().proceeding()
    order = waits.change(center=(45, 50), then=by_order).proceeding()
    assert Mission(n_robots=4, spacing=9).change(**order) == Mission(n_robots=4, shape="line", center=(45, 50))


def test_an_order_in_flight_is_checked_as_all_others_are() -> None:
    edge: Any = {"prefer": [{"robot": 1, "way": "edge"}]}
    for config, fields, cause in (
        ({"protocol": {"protocol": "paper"}}, edge, "auction"),
        ({"protocol": {"protocol": "paper"}}, {"then": [{"set": {"shape": "line"}}]}, "auction"),
        ({"protocol": {"without": "joint-assignment"}}, edge, "what preferences are part of"),
        ({"trial": {"sensing_delay": 1}}, {"velocity": [1, 0]}, "would fall behind"),
    ):
        orders = RunOrders(build_config(config))
        with pytest.raises(InputError, match=cause):
            orders.change(fields)
        assert orders.change({"center": [52, 50]}) == 0, "the order that was refused has left no trace"


def test_spare_robots_go_on_and_no_room_is_no_way_on() -> None:
    square: Any = ({"set": {"shape": "square"}},)
    spare = llm_flock.run(Mission(n_robots=5, places=4, then=square), trace=False)
    assert spare.formed and [one.shape for one in spare.summary.missions] == ["circle", "square"]
    wide: Any = ({"set": {"shape": "line", "spacing": 25}, "when": 20},)
    travels = Mission(n_robots=4, center=(40, 50), velocity=(2.5, 0), then=wide)
    flown = llm_flock.run(travels, rounds=24, trace=False)
    assert [one.shape for one in flown.summary.missions] == ["circle"], "the line has no room so far in the east"
    assert not flown.formed and flown.summary.reason == "1 of the mission's stages was not entered"


def test_an_order_in_flight_replaces_the_stages_that_are_left() -> None:
    line: Any = {"set": {"shape": "line", "center": [60, 50]}}
    mission = Mission(n_robots=4, center=(40, 50), then=(line, *STAGES[1:]))
    orders = RunOrders(build_config({"mission": mission.model_dump()}))
    given: list[int] = []

    async def steer(trial: Trial) -> None:
        orders.carry_out(trial)
        if trial.mission.shape == "line" and not given:
            given.append(orders.change({"spacing": 8}))

    flown = llm_flock.run(mission, steer=steer, trace=False)
    assert [one.shape for one in flown.summary.missions] == ["circle", "line", "line"]
    assert flown.formed and flown.positions[-1].mean(axis=0) == pytest.approx([60, 50], abs=0.1)


def test_orders_add_up_before_robots_have_them() -> None:
    orders = RunOrders(build_config({"mission": {"n_robots": 4}}))

    async def steer(trial: Trial) -> None:
        orders.carry_out(trial)
        if trial.round == 5:
            orders.change({"center": [45, 50]})
            orders.change({"shape": "line", "then": [{"set": {"shape": "square"}, "when": "order"}]})
        if trial.round == 6:
            orders.proceed()

    flown = llm_flock.run(Mission(n_robots=4), steer=steer, trace=False)
    assert [one.shape for one in flown.summary.missions] == ["circle", "line", "square"]
    assert flown.formed and flown.positions[-1].mean(axis=0) == pytest.approx([45, 50], abs=0.1)


@pytest.mark.parametrize("field", [{"n_robots": 9}, {"obstacles": [{"center": [30, 30], "radius": 5}]}, {"since": 7}])
def test_no_order_drops_what_it_cannot_change(field: dict[str, Any]) -> None:
    later: Any = [{"set": {"shape": "line"}, "when": "formed"}]
    orders = RunOrders(build_config({"mission": {"n_robots": 4, "comm_range": 60, "then": later}}))
    orders.round = 3
    with pytest.raises(InputError, match="by radio"):
        orders.change(field)


@pytest.mark.no_cover
def test_a_body_on_a_place_that_may_not_turn_ends_no_flight() -> None:
    line: Any = [{"set": {"shape": "line", "turn": 0.0, "center": [50, 40]}, "when": "formed"}]
    mission = Mission(n_robots=8, comm_range=25, then=line)
    options: Any = {"start": "connected", "gaps": "replan", "kill": "2@10,3@30", "join": "7@12"}
    summary = llm_flock.run(mission, seed=5, trace=False, **options).summary
    assert summary.formed and [mission.shape for mission in summary.missions] == ["circle", "line"]
