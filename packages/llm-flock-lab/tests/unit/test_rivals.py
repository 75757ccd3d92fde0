"""Rivals: what each of them promises, and what it needs for that."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, pairwise

import numpy as np
import pytest
from scipy.sparse.csgraph import shortest_path

import llm_flock
from llm_flock import metrics
from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.message import Message, Provenance, claims_in, table_digest
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol import AssignmentInput, AssignmentRule, Claim, ConsensusRule, Standing
from llm_flock.testing import check_assignment_rule, check_consensus_rule
from llm_flock_lab import RIVALS, fly_rival
from llm_flock_lab._rivals import (
    DecentralizedCapt,
    LeaderAssignment,
    consensus_based_auction,
    highest_id,
    lowest_id,
    own_number,
    random_priority,
    smallest_longest_way,
    smallest_sum_of_squares,
)

CIRCLE = Mission(shape="circle", n_robots=10)
SAFE = CIRCLE.safe_distance - metrics.ROUNDING


def origin(proposer: int) -> Provenance:
    return Provenance(mission=0, mission_digest="0" * 16, epoch=0, degree=proposer % 3, proposer=proposer, sequence=0)


@pytest.mark.parametrize("rule", [lowest_id(), highest_id(), random_priority()], ids=lambda rule: rule.name)
def test_consensus_rules_keep_the_contract(rule: ConsensusRule) -> None:
    check_consensus_rule(rule)


@pytest.mark.parametrize(
    "rule", [consensus_based_auction(), DecentralizedCapt(), LeaderAssignment()], ids=lambda rule: rule.name
)
def test_assignment_rules_keep_the_contract(rule: AssignmentRule) -> None:
    check_assignment_rule(rule)


def agreed(rule: ConsensusRule, order: list[int], seed: int) -> set[int]:
    """The proposers that robots of these ids follow, who stand in a row, after as many rounds as the row has hops."""
    rng = np.random.default_rng(seed)
    plans = {robot: Plan.of(rng.uniform(0, 100, (len(order), 2)).tolist()) for robot in order}
    follows = {robot: robot for robot in order}
    for _ in range(len(order) - 1):
        says = {
            robot: Message(sender=robot, sequence=0, degree=2, plan=plans[of], provenance=origin(of))
            for robot, of in follows.items()
        }
        for k, robot in enumerate(order):
            of = follows[robot]
            own = Standing(robot=robot, plan=plans[of], provenance=origin(of), degree=2)
            beside = sorted(order[max(0, k - 1) : k] + order[k + 1 : k + 2])
            chosen = rule.choose(own, [says[other] for other in beside])
            if chosen is not None and chosen.provenance is not None:
                follows[robot] = chosen.provenance.proposer
    return set(follows.values())


@pytest.mark.parametrize(("rule", "leader"), [(lowest_id(), 0), (highest_id(), 5)], ids=["lowest", "highest"])
def test_the_plan_of_one_id_spreads_hop_by_hop(rule: ConsensusRule, leader: int) -> None:
    assert agreed(rule, [3, 0, 4, 1, 5, 2], 0) == {leader}


def test_priorities_by_chance_choose_anybody_for_all() -> None:
    leaders = [agreed(random_priority(), [3, 0, 4, 1, 5, 2], seed) for seed in range(100)]
    assert all(len(chosen) == 1 for chosen in leaders)
    assert set().union(*leaders) == {0, 1, 2, 3, 4, 5}


def claims_of(rule: AssignmentRule, places: Points, goals: Points, beside: list[list[int]]) -> Iterator[list[Claim]]:
    """The claims after each communication round of robots that stand still and hear those beside them."""
    plan = Plan.of(goals.tolist())
    here = [tuple(row) for row in places.tolist()]

    def now(robot: int, heard: list[Message]) -> AssignmentInput:
        return AssignmentInput(
            robot=robot,
            position=here[robot],
            plan=plan,
            spacing=10.0,
            chosen=robot,
            adopted=False,
            heard=heard,
            sensed={other: here[other] for other in beside[robot]},
        )

    claims = [rule.take(now(robot, [])) for robot in range(len(here))]
    while True:
        says = [
            Message(
                sender=robot,
                sequence=0,
                degree=0,
                plan=plan,
                provenance=origin(0),
                slot=claim.slot,
                claims=claims_in(claim.table or ()),
                table_digest=table_digest(claim.table or ()),
                offer=claim.offer,
            )
            for robot, claim in enumerate(claims)
        ]
        claims = [
            rule.update(claim, now(robot, [says[other] for other in beside[robot]]))
            for robot, claim in enumerate(claims)
        ]
        yield claims


def after(rounds: int, claims: Iterator[list[Claim]]) -> list[Claim]:
    return next(islice(claims, rounds - 1, None))


def connected(n: int, rng: np.random.Generator) -> tuple[list[list[int]], int]:
    """Whom each robot hears, in a random tree with a few more links, and how many hops it is across."""
    links = np.zeros((n, n), dtype=bool)
    for robot in range(1, n):
        links[robot, rng.integers(0, robot)] = True
    links |= np.triu(rng.random((n, n)) < 0.1 * rng.random(), 1)
    links |= links.T
    return [np.flatnonzero(row).tolist() for row in links], int(shortest_path(links, unweighted=True).max())


def test_cbaa_gives_distinct_places_within_n_times_d_rounds() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        n = int(rng.integers(3, 11))
        (beside, across), (places, goals) = connected(n, rng), rng.uniform(0, 100, (2, n, 2))
        claims = after(n * across, claims_of(consensus_based_auction(), places, goals, beside))
        assert {claim.slot for claim in claims} == set(range(n))
        assert len({claim.table for claim in claims}) == 1


def test_cbaa_gives_a_place_twice_where_teams_are_apart() -> None:
    places = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.0], [1.5, 0.0]])
    goals = np.array([[0.0, 0.0], [1.0, 0.0], [50.0, 0.0], [60.0, 0.0]])
    claims = after(20, claims_of(consensus_based_auction(), places, goals, [[1], [0], [3], [2]]))
    assert {claim.slot for claim in claims} == {0, 1}


def test_d_capt_exchanges_until_no_neighbours_gain() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        n = int(rng.integers(3, 9))
        (beside, _), (places, goals) = connected(n, rng), rng.uniform(0, 100, (2, n, 2))
        squares, slots, done = [float(((places - goals) ** 2).sum())], list(range(n)), False
        for claims in islice(claims_of(DecentralizedCapt(), places, goals, beside), 40 * n):
            found = [claim.slot for claim in claims if claim.slot is not None]
            done = set(found) == set(range(n))  # no exchange is half done
            if done:
                slots = found
                squares.append(float(((places - goals[slots]) ** 2).sum()))
        assert all(later <= before for before, later in pairwise(squares)) and done
        for i in range(n):
            for j in beside[i]:
                gain = 2.0 * float((places[i] - places[j]) @ (goals[slots[j]] - goals[slots[i]]))
                assert gain < 0.01 * 10.0**2


def test_the_bottleneck_comes_before_the_sum_of_squares() -> None:
    # The sum of squares alone would send one robot 10 far and the other not at all.
    distances = np.array([[0.0, 7.9], [7.9, 10.0]])
    assert smallest_longest_way(distances) == [1, 0] and smallest_sum_of_squares(distances) == [0, 1]
    assert smallest_longest_way(np.array([[0.0, 2.0], [2.0, 1.0]])) == [0, 1]


def test_each_assignment_is_best_by_its_own_measure() -> None:
    rng, differ = np.random.default_rng(2), 0
    for _ in range(100):
        ways = metrics.straight(*rng.uniform(0, 100, (2, 8, 2)))
        rows = np.arange(8)
        bottleneck, squares = (ways[rows, give(ways)] for give in (smallest_longest_way, smallest_sum_of_squares))
        assert bottleneck.max() <= squares.max() and (squares**2).sum() <= (bottleneck**2).sum()
        differ += bottleneck.max() < squares.max() - 1e-9
    assert differ > 10
    assert own_number(np.zeros((3, 3))) == [0, 1, 2]


def apart(n: int, distance: float, side: float, rng: np.random.Generator) -> Points:
    """Random places in a square, no two nearer than this."""
    places = rng.uniform(0, side, (1, 2))
    while len(places) < n:
        new = rng.uniform(0, side, (1, 2))
        if metrics.straight(new, places).min() >= distance:
            places = np.concatenate([places, new])
    return places


def closest(start: Points, goals: Points, *, in_time: bool) -> float:
    """The smallest distance on straight lines, flown in a common time or at a speed of 1."""
    ways = np.linalg.norm(goals - start, axis=1)
    if in_time:
        return metrics.segment_separation(start, goals)
    track = [start + np.minimum(1.0, t / ways)[:, None] * (goals - start) for t in np.arange(0.0, ways.max() + 1.0)]
    return min(metrics.segment_separation(*pair) for pair in pairwise(track))


def test_capt_is_safe_by_its_conditions_and_without_one_not() -> None:
    """Starts and goals 2 sqrt(2) R apart, the smallest sum of squares and a common time: each of them is needed."""
    rng, far = np.random.default_rng(3), np.sqrt(2.0) * CIRCLE.safe_distance
    without = {"spacing": np.inf, "squares": np.inf, "numbers": np.inf, "time": np.inf}
    for _ in range(200):
        start, goals = apart(8, far, 20.0, rng), apart(8, far, 20.0, rng)
        ways = metrics.straight(start, goals)
        best = goals[smallest_sum_of_squares(ways)]
        assert closest(start, best, in_time=True) >= SAFE
        near, to = apart(8, CIRCLE.safe_distance, 20.0, rng), apart(8, CIRCLE.safe_distance, 20.0, rng)
        tight = to[smallest_sum_of_squares(metrics.straight(near, to))]
        without["spacing"] = min(without["spacing"], closest(near, tight, in_time=True))
        without["squares"] = min(without["squares"], closest(start, goals[smallest_longest_way(ways)], in_time=True))
        without["numbers"] = min(without["numbers"], closest(start, goals, in_time=True))
        without["time"] = min(without["time"], closest(start, best, in_time=False))
    assert max(without.values()) < SAFE, without


def test_capt_flies_these_lines_and_the_bottleneck_is_the_bound() -> None:
    flown = fly_rival("CAPT", CIRCLE, seed=3, shield=False)
    plan, start = flown.plans[0], flown.positions[0]
    assert flown.formed and plan is not None
    goals = np.array([plan.points[slot] for slot in flown.slots if slot is not None])
    longest = float(np.linalg.norm(goals - start, axis=1).max()) / CIRCLE.max_step
    shares = np.minimum(1.0, np.arange(len(flown.positions)) / longest)
    assert np.allclose(flown.positions, start + shares[:, None, None] * (goals - start))
    bottleneck = fly_rival("central, bottleneck", CIRCLE, seed=3, shield=False).summary
    assert bottleneck.rounds_to_formed == bottleneck.lower_bound_rounds == 6 < (flown.summary.rounds_to_formed or 0)


@pytest.mark.parametrize("name", RIVALS)
def test_every_rival_keeps_the_safe_distance_under_the_shield(name: str) -> None:
    flown = fly_rival(name, CIRCLE, seed=1, shield=True)
    assert flown.formed and flown.summary.min_separation is not None and flown.summary.min_separation >= SAFE
    messages, size = RIVALS[name].traffic(flown)
    assert (messages > 0) == (size > 0) == (RIVALS[name].link != "none")


def test_one_central_planner_asks_its_model_once() -> None:
    once = fly_rival("one central planner", CIRCLE, seed=0, shield=True)
    assert once.summary.model_calls == 1 and len(set(once.plans)) == 1
    steps = fly_rival("one central planner, every step", CIRCLE, seed=0, shield=True)
    assert steps.summary.model_calls == 1 + 10 * steps.summary.rounds and steps.plans == once.plans
    assert RIVALS["one central planner"].traffic(once)[0] == 2.0
    assert RIVALS["one central planner, every step"].traffic(steps)[0] == 2.0 * steps.summary.rounds


def test_a_fixed_formula_needs_neither_model_nor_message() -> None:
    flown = fly_rival("fixed formula", CIRCLE, seed=0, shield=True)
    assert flown.slots == tuple(range(10)) and flown.summary.model_calls == 0
    assert RIVALS["fixed formula"].traffic(flown) == (0.0, 0.0)


def test_rules_fly_by_their_names() -> None:
    run = llm_flock.run(CIRCLE, consensus="random-priority", assignment="by-leader")
    assert run.formed and (run.summary.consensus, run.summary.assignment) == ("random-priority", "by-leader")
    bare = llm_flock.run(
        CIRCLE, protocol="baseline", assignment="cbaa", comm_rounds=5, model="simulated:canonical", start="separated"
    )
    assert bare.formed and bare.summary.assignment == "cbaa"


def test_an_auction_without_a_team_sends_less() -> None:
    def size(assignment: str) -> float:
        given = {"protocol": "baseline", "comm_rounds": 5, "model": "geometry", "consensus": "influence"}
        run = llm_flock.run(CIRCLE, assignment=assignment, rounds=5, stop_when_formed=False, **given)
        return run.summary.bytes_per_robot_round

    assert size("cbaa") < size("auction")


def test_an_unknown_rival_and_unfit_missions_are_refused() -> None:
    with pytest.raises(InputError, match=r"CAPTT.*CAPT"):
        fly_rival("CAPTT", CIRCLE, seed=0, shield=True)
    with pytest.raises(InputError, match=r"places.*10 robots"):
        fly_rival("CAPT", Mission(n_robots=10, places=8), seed=0, shield=True)
    with pytest.raises(InputError, match=r"velocity.*stands still"):
        fly_rival("CAPT", Mission(n_robots=10, velocity=(1.0, 0.0)), seed=0, shield=True)


def test_a_station_without_a_plan_leaves_all_where_they_are() -> None:
    flown = fly_rival("CAPT", Mission(shape="text:a heart", n_robots=3), seed=0, shield=False)
    assert not flown.formed and flown.plans == (None,) * 3 and (flown.positions == flown.positions[0]).all()


def test_only_the_leader_assigns_all() -> None:
    plan = Plan.of([[0, 0], [10, 0]])

    def owners(robot: int) -> list[int]:
        """Owners of the places for a robot at the second place; robot 0, whose plan it is, would rather have that."""
        now = AssignmentInput(
            robot=robot,
            position=(10.0, 0.0),
            plan=plan,
            spacing=10.0,
            chosen=None,
            adopted=robot > 0,
            heard=(),
            sensed={},
            origin=origin(0),
            positions=(2**23, (0, 1), ((10.0, 0.0), (20.0, 0.0))),
        )
        return [owner for _, _, owner in LeaderAssignment().take(now).table or ()]

    assert owners(0) == [0, 1] and owners(1) == [-1, 1]
