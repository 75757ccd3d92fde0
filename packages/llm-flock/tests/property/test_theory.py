"""What docs/explanation/theory.md proves, on random cases: max-consensus, lattice of tables, bound of the auction."""

import math
from itertools import permutations

import numpy as np
import pytest
from driven_team import DrivenTeam, Links, turned
from effort import cases
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from llm_flock.arrays import Mask, Point
from llm_flock.message import NO_OWNER, BidEntry, BidTable
from llm_flock.mission import Mission
from llm_flock.protocol._agreement.auction import SWAP_GAIN, merge, rank
from llm_flock.protocol._agreement.consensus import PlanKey, plan_key
from llm_flock.protocol._membership.search import MANY
from llm_flock.protocol._path_length import path_lengths
from llm_flock.shield import project

SEEDS = st.integers(0, 2**32)


def random_tree(n: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """The edges of a random spanning tree of randomly numbered robots."""
    order = rng.permutation(n)
    return [(int(order[k]), int(order[rng.integers(0, k)])) for k in range(1, n)]


def links_of(n: int, edges: list[tuple[int, int]]) -> Links:
    return tuple(tuple(sorted({b for e in edges for a, b in (e, e[::-1]) if a == i})) for i in range(n))


def random_links(n: int, rng: np.random.Generator) -> tuple[Links, Mask]:
    """A random connected graph, from a tree to a dense one, and its adjacency."""
    pairs = [(i, j) for i in range(n) for j in range(i) if rng.random() < rng.choice([0.0, 0.1, 0.4])]
    links = links_of(n, random_tree(n, rng) + pairs)
    adjacent = np.array([[j in links[i] for j in range(n)] for i in range(n)], dtype=np.bool_)
    return links, adjacent


def circle(n: int) -> Mission:
    return Mission(shape="circle", n_robots=n, arena=((-500, -500), (600, 600)))


def places(n: int, rng: np.random.Generator) -> list[Point]:
    return [tuple(x) for x in rng.uniform(0, 100, (n, 2)).tolist()]


def hops(adjacent: Mask, start: int) -> list[int]:
    """Number of hops from one robot to each."""
    found, front = {start: 0}, [start]
    for i in front:
        for j in np.flatnonzero(adjacent[i]).tolist():
            if j not in found:
                found[j] = found[i] + 1
                front.append(j)
    return [found[i] for i in range(len(adjacent))]


def key_of(team: DrivenTeam, robot: int) -> PlanKey:
    agent = team.agents[robot]
    assert agent.plan is not None and agent.provenance is not None
    # Proposals are exact shapes, so their class decides nothing here.
    return plan_key(agent.plan, agent.provenance, 0)


@cases(10)
@given(seed=SEEDS, n=st.integers(1, 9))
def test_highest_plan_spreads_one_hop_in_a_communication_round(seed: int, n: int) -> None:
    """Theorem 1: so all hold it after the diameter at the latest, and not a communication round before they are
    reached."""
    rng = np.random.default_rng(seed)
    links, adjacent = random_links(n, rng)
    team = DrivenTeam(circle(n), "flock", turned(circle(n), n))
    team.begin(places(n, rng), links)
    top = max(range(n), key=lambda i: key_of(team, i))
    highest, away = team.plans[top], hops(adjacent, top)
    diameter = max(max(hops(adjacent, i)) for i in range(n))
    for comm_round in range(diameter + 1):
        assert [plan == highest for plan in team.plans] == [far <= comm_round for far in away]
        team.comm_round()
    assert set(team.plans) == {highest}


@cases(10)
@given(seed=SEEDS, n=st.integers(2, 7), window=st.integers(1, 4))
def test_a_jointly_connected_team_agrees(seed: int, n: int, window: int) -> None:
    """Theorem 2: each link of a random tree exists in one round of a window only; no graph needs to be whole."""
    rng = np.random.default_rng(seed)
    team = DrivenTeam(circle(n), "flock", turned(circle(n), n))
    spots = places(n, rng)
    team.begin(spots, links_of(n, random_tree(n, rng)))
    highest = team.plans[max(range(n), key=lambda i: key_of(team, i))]
    for _ in range(n - 1):
        # Another tree in each window: only the union within one window is connected.
        when = [(edge, int(rng.integers(0, window))) for edge in random_tree(n, rng)]
        for number in range(window):
            team.end()
            team.begin(spots, links_of(n, [edge for edge, at in when if at == number]))
            team.comm_round()
    assert set(team.plans) == {highest}


ENTRIES = st.one_of(
    st.tuples(st.integers(0, 3), st.sampled_from([-3.0, -2.0, -1.0, 0.0]), st.integers(0, 3)),
    st.tuples(st.integers(0, 3), st.just(0.0), st.just(NO_OWNER)),
)
TABLES = st.lists(ENTRIES, min_size=3, max_size=3).map(tuple)


@given(a=TABLES, b=TABLES, c=TABLES)
def test_merging_is_the_join_of_a_lattice(a: BidTable, b: BidTable, c: BidTable) -> None:
    """Lemma 1: tables may arrive in any order and repeatedly; the outcome is the same."""
    assert merge(a, b) == merge(b, a)
    assert merge(merge(a, b), c) == merge(a, merge(b, c))
    assert merge(a, a) == a
    assert all(rank(x) >= max(rank(y), rank(z)) for x, y, z in zip(merge(a, b), a, b, strict=True))
    assert len({merge(merge(x, y), z) for x, y, z in permutations((a, b, c))}) == 1


@given(a=ENTRIES, b=ENTRIES)
def test_entries_of_equal_rank_are_equal(a: BidEntry, b: BidEntry) -> None:
    """The order of claims is total: no two different claims can stand side by side without end."""
    assert (rank(a) == rank(b)) == (a == b)
    assert (rank(a) > rank(b)) == (a[0] > b[0] or (a[0] == b[0] and rank(a)[1:] > rank(b)[1:]))


def greedy(bids: list[tuple[float, ...]]) -> list[int]:
    """Whose slot is which, by taking the best pair of all that are left, again and again."""
    n = len(bids)
    slots = [-1] * n
    left = sorted((-bids[i][a], a, i) for i in range(n) for a in range(n))
    for _, a, i in left:
        if slots[i] < 0 and a not in slots:
            slots[i] = a
    return slots


@cases(10)
@given(seed=SEEDS, n=st.integers(1, 8))
def test_auction_ends_greedily_within_n_times_the_diameter(seed: int, n: int) -> None:
    """Theorem 5: all follow one plan from the beginning, none exchanges places, and none are assigned together."""
    rng = np.random.default_rng(seed)
    links, adjacent = random_links(n, rng)
    diameter = max(max(hops(adjacent, i)) for i in range(n))
    team = DrivenTeam(circle(n), "flock", turned(circle(n), 1) * n, swaps=False, joint=False)
    team.begin(places(n, rng), links)
    for _ in range(n * diameter):
        team.comm_round()
    bids = [agent.claim.bids for agent in team.agents]
    assert team.slots == greedy([b for b in bids if b is not None])
    assert len({agent.claim.table for agent in team.agents}) == 1


@cases(10)
@given(seed=SEEDS, n=st.integers(2, 7))
def test_exchanges_come_to_rest_while_robots_stand_still(seed: int, n: int) -> None:
    """What theorem 4 leaves open: all comes to rest, and no pair is left with an exchange that it would make."""
    rng = np.random.default_rng(seed)
    links, _ = random_links(n, rng)
    mission = circle(n)
    team = DrivenTeam(mission, "flock", turned(mission, 1) * n, joint=False)
    where = places(n, rng)
    team.begin(where, links)
    plan = team.plans[0]
    assert plan is not None

    def squared(i: int, slot: int) -> float:
        return path_lengths(where[i], plan, [slot], mission.spacing)[0] ** 2

    total, slots, distinct = math.inf, [0], False
    for _ in range(60 * n):
        team.comm_round()
        slots = [slot for slot in team.slots if slot is not None]
        distinct = sorted(slots) == list(range(n))
        if distinct and (total < math.inf or len({agent.claim.table for agent in team.agents}) == 1):
            before, total = total, sum(squared(i, slot) for i, slot in enumerate(slots))
            assert total <= before + 1e-6
    assert distinct and len({agent.claim.table for agent in team.agents}) == 1
    for i in range(n):
        for j in links[i]:
            gained = squared(i, slots[i]) + squared(j, slots[j]) - squared(i, slots[j]) - squared(j, slots[i])
            assert gained < SWAP_GAIN * mission.spacing**2
    settled = team.slots
    for _ in range(20):
        team.comm_round()
    assert team.slots == settled


@cases(10)
@given(seed=SEEDS, n=st.integers(2, MANY))
def test_robots_in_touch_are_jointly_placed_within_diameter(seed: int, n: int) -> None:
    """Theorem 6a: all have the same table, and it is the assignment of the smallest sum of squares."""
    rng = np.random.default_rng(seed)
    links, adjacent = random_links(n, rng)
    diameter = max(max(hops(adjacent, i)) for i in range(n))
    team = DrivenTeam(circle(n), "flock", turned(circle(n), 1) * n, swaps=False)
    where = places(n, rng)
    team.begin(where, links)
    for _ in range(diameter):
        team.comm_round()
    plan, slots = team.plans[0], team.slots
    assert plan is not None and len({agent.claim.table for agent in team.agents}) == 1
    squares = cdist(np.round(where, 2), plan.array) ** 2
    assert sorted(slots, key=str) == sorted(range(n), key=str)
    best = squares[linear_sum_assignment(squares)].sum()
    assert sum(squares[i, slot] for i, slot in enumerate(slots) if slot is not None) == pytest.approx(best)
    for _ in range(n):
        team.comm_round()
    assert team.slots == slots, "it is at rest"


@given(SEEDS)
def test_theorem_15_a_free_way_is_flown(seed: int) -> None:
    rng = np.random.default_rng(seed)
    dim, safe, longest = int(rng.integers(2, 4)), 3.0, 6.0
    margin, left = float(rng.uniform(0.01, 2.0)), float(rng.uniform(0.1, 20.0))
    direction = rng.normal(size=dim)
    here, stop = np.zeros(dim), left * direction / np.linalg.norm(direction)
    bodies = [
        body
        for body in rng.uniform(-15, 15, (12, dim))
        if np.linalg.norm(body - np.clip(body @ stop / (stop @ stop), 0.0, 1.0) * stop) >= (1.0 + margin) * safe
    ]
    wish = stop * min(1.0, longest / left)
    to = project(
        tuple(here.tolist()),
        tuple(wish.tolist()),
        [tuple(body.tolist()) for body in bodies],
        safe_distance=safe,
        max_step=longest,
    )
    gained = left - float(np.linalg.norm(stop - np.array(to)))
    assert gained >= min(longest, margin * safe / 2.0, left) - 1e-6
