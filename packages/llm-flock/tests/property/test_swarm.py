"""Many agents over a fake link, without a clock: what must hold with any loss, delay or repetition of messages."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import scipy
from effort import cases
from hypothesis import given
from hypothesis import strategies as st
from whole_agent import whole_agent

from llm_flock import graph
from llm_flock.agent import Agent
from llm_flock.events import Broadcast, CommRoundBegan, CommRoundEnded, Planned, Received, RoundBegan
from llm_flock.links import LinkFaults, MemoryTransport
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanAnswer
from llm_flock.protocol._agreement.assignment import AssignmentRule, NearestAssignment
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.consensus import ConsensusRule, InfluenceConsensus, ProvenanceConsensus


def swarm(
    n: int,
    positions: np.ndarray,
    rng: np.random.Generator,
    consensus: Callable[[], ConsensusRule] = ProvenanceConsensus,
    assignment: Callable[[], AssignmentRule] = AuctionAssignment,
) -> list[Agent]:
    """N agents that have sensed each other and each proposed a randomly turned circle."""
    mission = Mission(shape="circle", n_robots=n, arena=((-500, -500), (600, 600)))
    near = graph.neighbors(positions, mission.comm_range)
    agents = [whole_agent(i, mission, consensus(), assignment(), shield_on=True) for i in range(n)]
    for i, agent in enumerate(agents):
        sensed = {j: tuple(positions[j].tolist()) for j in near[i]}
        agent.handle(
            RoundBegan(round=1, position=tuple(positions[i].tolist()), degree=len(sensed), sensed=sensed, observed=())
        )
        angle = rng.uniform(0, 2 * np.pi, 1) + 2 * np.pi * np.arange(n) / n
        radius = 5 / np.sin(np.pi / max(n, 2))
        points = 50 + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        agent.handle(Planned(PlanAnswer(plan=Plan.of(points.round(2).tolist()), slot=i)))
    return agents


def exchange(agents: list[Agent], transport: MemoryTransport, near: tuple[tuple[int, ...], ...]) -> None:
    """One communication round."""
    for i, agent in enumerate(agents):
        for effect in agent.handle(CommRoundBegan()):
            assert isinstance(effect, Broadcast)
            transport.broadcast(effect.payload, near[i])
    for receiver, payload in transport.deliver():
        agents[receiver].handle(Received(payload))
    for agent in agents:
        agent.handle(CommRoundEnded())


def chain(n: int, rng: np.random.Generator) -> np.ndarray:
    """A connected, randomly bent chain of robots."""
    steps = rng.uniform(4, 14, n)
    bend = np.cumsum(rng.normal(0, 0.5, n))
    return 50 + np.cumsum(np.column_stack([steps * np.cos(bend), steps * np.sin(bend)]), axis=0)


def owned(agent: Agent) -> list[int]:
    table = agent.claim.table or ()
    return [a for a, entry in enumerate(table) if entry[2] == agent.robot]


@cases(6)
@given(seed=st.integers(0, 2**32), n=st.integers(1, 9))
def test_a_connected_team_agrees_within_its_diameter(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    positions = chain(n, rng)
    near = graph.neighbors(positions, 15.0)
    agents = swarm(n, positions, rng)
    transport = MemoryTransport(n, LinkFaults(), rng)
    hops = scipy.sparse.csgraph.shortest_path(graph.adjacency(positions, 15.0), unweighted=True)
    for _ in range(int(hops.max())):
        exchange(agents, transport, near)
    assert len({a.plan for a in agents}) == 1


@cases(6)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(1, 8),
    loss=st.floats(0, 0.6),
    delay=st.integers(0, 3),
    duplicate=st.floats(0, 0.5),
    reorder=st.floats(0, 1),
)
def test_a_connected_team_ends_on_distinct_slots_under_faults(
    seed: int, n: int, loss: float, delay: int, duplicate: float, reorder: float
) -> None:
    rng = np.random.default_rng(seed)
    positions = chain(n, rng)
    near = graph.neighbors(positions, 15.0)
    agents = swarm(n, positions, rng)
    faults = LinkFaults(loss=loss, delay=delay, duplicate=duplicate, reorder=reorder)
    transport = MemoryTransport(n, faults, rng)
    for _ in range(400):
        exchange(agents, transport, near)
        for agent in agents:
            assert owned(agent) == ([] if agent.claim.slot is None else [agent.claim.slot])
    assert len({a.plan for a in agents}) == 1
    assert sorted(a.claim.slot for a in agents if a.claim.slot is not None) == list(range(n))
    assert not any(a.rejected for a in agents)


@cases(6)
@given(seed=st.integers(0, 2**32), n=st.integers(2, 7), junk=st.lists(st.binary(max_size=300), max_size=20))
def test_junk_on_the_radio_changes_nothing(seed: int, n: int, junk: list[bytes]) -> None:
    rng = np.random.default_rng(seed)
    positions = chain(n, rng)
    agents = swarm(n, positions, rng)
    agents[0].handle(CommRoundBegan())  # the first of a round carries the heartbeats
    before = agents[0].handle(CommRoundBegan())
    for payload in junk:
        agents[0].handle(Received(payload))
    agents[0].handle(CommRoundEnded())
    assert agents[0].handle(CommRoundBegan()) == before
    assert sum(agents[0].rejected.values()) == len(junk)


def test_literal_rule_gives_ten_robots_no_distinct_goals() -> None:
    """The paper's rule on its own case, some starts in radio range of each other: never one plan and distinct goals."""
    good = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        positions = rng.uniform(0, 40, (10, 2))
        near = graph.neighbors(positions, 15.0)
        agents = swarm(10, positions, rng, InfluenceConsensus, NearestAssignment)
        transport = MemoryTransport(10, LinkFaults(), rng)
        for _ in range(25):
            exchange(agents, transport, near)
        good += len({a.plan for a in agents}) == 1 and len({a.claim.slot for a in agents}) == 10
    assert good == 0


def test_links_lose_delay_duplicate_and_reorder_as_configured() -> None:
    rng = np.random.default_rng(0)
    transport = MemoryTransport(2, LinkFaults(loss=0.3, delay=2, duplicate=0.5), rng)
    arrivals: list[int] = []
    for _ in range(2000):
        transport.broadcast(b"x", (1,))
        arrivals.append(len(transport.deliver()))
    traffic = transport.traffic
    assert traffic.sent == 2000 and traffic.bytes == 2000
    assert traffic.delivered == sum(arrivals) == pytest.approx(2000 * 1.5 * 0.7, rel=0.05)
    assert traffic.lost == pytest.approx(2000 * 1.5 * 0.3, rel=0.1)
    assert max(arrivals) > 2


@pytest.mark.parametrize(("loss", "burst"), [(0.3, 1.0), (0.3, 5.0), (0.7, 20.0)])
def test_bursts_are_as_long_and_losses_as_many_as_asked(loss: float, burst: float) -> None:
    transport = MemoryTransport(3, LinkFaults(loss=loss, burst=burst), np.random.default_rng(1))
    lost: list[bool] = []
    for _ in range(40_000):
        transport.broadcast(b"x", (1,), 0)
        lost.append(not transport.deliver())
        transport.broadcast(b"x", (1,), 2)  # another link, which breaks no burst of the first
        transport.deliver()
    begins = sum(now and not before for before, now in pairwise(lost))
    assert sum(lost) / len(lost) == pytest.approx(loss, rel=0.07)
    assert sum(lost) / begins == pytest.approx(burst, rel=0.1)


def test_bursts_that_cannot_be_as_many_leave_a_message_between() -> None:
    transport = MemoryTransport(2, LinkFaults(loss=0.9, burst=1.0), np.random.default_rng(0))
    arrivals: list[int] = []
    for _ in range(6):
        transport.broadcast(b"x", (1,))
        arrivals.append(len(transport.deliver()))
    assert arrivals in ([0, 1, 0, 1, 0, 1], [1, 0, 1, 0, 1, 0])
    everything = LinkFaults(loss=1.0, burst=3.0)
    assert all(everything.is_lost(before, np.random.default_rng(0)) for before in (True, False))


def test_reordering_keeps_every_message() -> None:
    rng = np.random.default_rng(0)
    transport = MemoryTransport(2, LinkFaults(reorder=1.0), rng)
    payloads = [bytes([k]) for k in range(20)]
    for payload in payloads:
        transport.broadcast(payload, (1,))
    got = [payload for _, payload in transport.deliver()]
    assert got != payloads and sorted(got) == payloads


def test_links_may_change_in_flight() -> None:
    transport = MemoryTransport(2, LinkFaults(), np.random.default_rng(0))
    for loss, arrives in ((0.0, 1), (1.0, 0), (0.0, 1)):
        transport.faults = transport.faults.model_copy(update={"loss": loss})
        transport.broadcast(b"x", (1,))
        assert len(transport.deliver()) == arrives
    assert transport.traffic.lost == 1
