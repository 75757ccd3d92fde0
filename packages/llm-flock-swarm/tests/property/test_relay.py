"""A member that is the only path between two pieces of a team keeps back some of what it knows, or delays it."""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace
from signed_team import SignedTeam
from tables import told

from llm_flock import graph
from llm_flock.events import Broadcast, CommRoundBegan, CommRoundEnded
from llm_flock.message import UNSAID, Message, decode, encode
from llm_flock.mission import Mission
from llm_flock_swarm._signed.certificates import Proofs, claims_of, unwrap, wrap

N, HALF, RELAY = 7, 3, 6
MISSION = Mission(shape="circle", n_robots=N, comm_range=24.0)
STAYS, LONGEST = 30, 60
"""Rounds for which the relay's body stays between the pieces, and in which the honest are on their places."""

Kept = Callable[[Message, Proofs, random.Random], tuple[Message, Proofs] | None]


def plans(said: Message, proofs: Proofs, rng: random.Random) -> tuple[Message, Proofs]:
    alone = Message(sender=said.sender, sequence=said.sequence, degree=said.degree, stamp=said.mission)
    return replace(alone, beats=said.beats), Proofs(beats=proofs.beats)


def claims(said: Message, proofs: Proofs, rng: random.Random) -> tuple[Message, Proofs]:
    shown, grants = claims_of({})
    empty = told((UNSAID,) * said.places)
    proofs = replace(proofs, claims=shown, grants=grants, words=(), offer=None)
    return replace(said, offer=None, slot=None, **empty), proofs


def words(said: Message, proofs: Proofs, rng: random.Random) -> tuple[Message, Proofs]:
    return said, replace(proofs, words=())


def everything(said: Message, proofs: Proofs, rng: random.Random) -> None:
    return None


class Relayed(SignedTeam):
    """A team whose last robot is honest but for what it says to the second piece."""

    def comm_round_with(self, kept: Kept | None, rng: random.Random, late: list[tuple[int, int, bytes]]) -> None:
        said = [one for agent in self.agents for one in agent.handle(CommRoundBegan()) if isinstance(one, Broadcast)]
        for i, effect in enumerate(said):
            for j in self.links[i]:
                if i != RELAY or j < HALF:
                    self.tell(j, effect.payload, i)
                elif kept is None:  # it delays what it says, out of order
                    late.append((self.round + rng.randrange(1, 12), j, effect.payload))
                else:
                    content, proofs = unwrap(effect.payload, N)
                    message = decode(content, N, 2)
                    changed = kept(message, proofs, rng) if message.plan is not None else (message, proofs)
                    if changed is not None:
                        self.tell(j, wrap(encode(changed[0]), changed[1]), i)
        for one in [one for one in late if one[0] <= self.round]:
            late.remove(one)
            self.tell(one[1], one[2], RELAY)
        for agent in self.agents:
            agent.handle(CommRoundEnded())


@pytest.mark.parametrize("kept", [plans, claims, words, everything, None])
def test_relay_that_keeps_back_divides_no_team(kept: Kept | None) -> None:
    rng = random.Random(1)
    halves = [(x + 8.0 * (k % 2) + rng.random(), 44.0 + 6.0 * (k // 2)) for x in (22.0, 72.0) for k in range(HALF)]
    places = [*halves, (51.0, 48.0)]
    links = graph.neighbors(places, MISSION.comm_range)
    assert not any(j in links[i] for i in range(HALF) for j in range(HALF, RELAY)) and len(links[RELAY]) > 1
    team, late = Relayed(MISSION, places, liars=0), list[tuple[int, int, bytes]]()
    for number in range(LONGEST):
        team.begin()
        for _ in range(5):
            team.comm_round_with(kept, rng, late)
        team.end(moves={RELAY: places[RELAY]} if number < STAYS else None)
    honest = team.agents[:RELAY]
    slots = [agent.claim.slot for agent in honest]
    assert len({agent.plan for agent in honest}) == 1 and None not in slots and len(set(slots)) == RELAY
    goals = np.array([agent.goal for agent in honest])
    assert float(np.linalg.norm(goals - np.array(team.positions[:RELAY]), axis=1).max()) < 0.5
    assert team.smallest >= MISSION.safe_distance - 1e-6
