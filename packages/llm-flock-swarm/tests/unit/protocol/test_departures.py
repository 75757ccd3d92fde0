"""Who leaves place after place, how that is told from being outbid, and what becomes of it."""

from __future__ import annotations

import itertools
from copy import deepcopy
from functools import cache

import msgspec
import numpy as np
import pytest
from gang import Gang
from lies import beside_lies
from signed_team import SignedTeam, evidence_of, line_up
from toy_keys import ToyKeys

from llm_flock.arrays import Point
from llm_flock.message import BLOCKED, NO_OWNER, UNSAID, BidTable, Message, decode
from llm_flock.mission import Mission
from llm_flock.protocol._membership.occupancy import Occupancy
from llm_flock.simulate import start_positions
from llm_flock_swarm._signed.certificates import (
    Certificate,
    Context,
    LastClaim,
    Proofs,
    ReleaseGrant,
    RestlessWord,
    left_by,
    most_exchanges,
    restless_statement,
    unwrap,
    word_statement,
    wrap,
)
from llm_flock_swarm._signed.departures import MAX_DEPARTURES, Departures
from llm_flock_swarm._signed.evidence import Evidence
from llm_flock_swarm._signed.words import MAX_PASSED_ON

N, TWO, PLACES = 7, 2, 4
MISSION = Mission(shape="circle", n_robots=N, comm_range=40)
RELEASED = ReleaseGrant(((0, b""), (1, b"")))


@pytest.mark.parametrize("exchanges", [False, True])
def test_only_a_robot_that_leaves_too_often_is_named(exchanges: bool) -> None:
    """Where exchanges count, those that come to nothing may look like departures."""
    departures = Departures(TWO + 1, exchanges=exchanges)
    most = MAX_DEPARTURES + exchanges * most_exchanges(PLACES)

    def leaves(robot: int, slot: int, version: int) -> None:
        table = tuple((version - 1, -1.0, robot) if a == slot else UNSAID for a in range(PLACES))
        departures.count(robot, slot, version, table)

    for version in range(1, most + 1):
        leaves(3, 0, version)
        leaves(3, 0, version)  # heard of once more
        leaves(4, version % PLACES, 1)
        assert not departures.restless(PLACES)
    leaves(3, 1, 1)
    assert departures.restless(PLACES) == [3] and departures.suspects(4) and not departures.suspects(5)


def test_departure_from_a_taken_place_is_not_counted() -> None:
    departures = Departures(TWO + 1, exchanges=False)
    table: BidTable = ((0, -1.0, 3), (2, -1.0, 3), (0, -1.0, 5), UNSAID)
    departures.explain(LastClaim(0, 0, -0.5, 5, 1, b"", None))
    for slot, version in ((0, 1), (1, 1), (1, 2), (1, 4), (2, 1), (3, 1)):
        departures.count(3, slot, version, table)
    assert not departures.suspects(3)
    departures.explain(LastClaim(1, 2, -0.9, 3, 1, b"", None))
    departures.count(3, 1, 3, table)
    assert departures.suspects(3)


def test_words_of_enough_exclude_and_no_more_are_kept() -> None:
    departures = Departures(TWO + 1, exchanges=False)
    for witness in range(5):
        assert departures.excluded == (frozenset() if witness < 3 else {6})
        if not departures.knows(6, witness):
            departures.keep(6, witness, bytes([witness]))
    assert departures.knows(6, 0) and not departures.knows(5, 0)
    assert departures.words() == [RestlessWord(6, witness, bytes([witness])) for witness in range(3)]


@cache
def flown(liars: int) -> SignedTeam:
    team = SignedTeam(MISSION, line_up(N), liars=liars, tolerated=TWO)
    team.fly(4)
    return team


def settled_team(liars: int = TWO) -> tuple[SignedTeam, Gang]:
    team = deepcopy(flown(liars))
    gang = Gang({j: ToyKeys(j) for j in range(N - liars, N)}, MISSION)
    team.begin()
    for payload in team.comm_round():
        gang.hear(payload)
    return team, gang


def words_about(team: SignedTeam, robot: int, witnesses: range) -> tuple[RestlessWord, ...]:
    statement = restless_statement(team.context, robot)
    return tuple(RestlessWord(robot, j, ToyKeys(j).sign(statement)) for j in witnesses)


def told(team: SignedTeam, gang: Gang, words: tuple[RestlessWord, ...], entries=None) -> None:
    """A liar passes these words on, about robots of which each has seen a departure."""
    for agent, word in itertools.product(team.agents, words):
        evidence_of(agent)._page.departures._left.setdefault(word.robot, {(0, 9)})
    sender, payload, _ = gang.message(5, entries)
    content, proofs = unwrap(payload, N)
    team.comm_round(said_by=[(sender, wrap(content, msgspec.structs.replace(proofs, restless=words)), None)])


def tables(team: SignedTeam) -> list[BidTable]:
    return [agent.claim.table or () for agent in team.agents]


def test_places_of_the_excluded_are_free_and_their_claims_void() -> None:
    team, gang = settled_team()
    free = next(slot for slot in gang.places if slot not in team.slots)
    team.comm_round(said_by=[gang.message(6, {free: gang.claim(6, free)}, slot=free)])
    assert all(table[free][2] == 6 for table in tables(team))
    told(team, gang, words_about(team, 6, range(TWO)))
    assert all(table[free][2] == 6 for table in tables(team)), "as many words as there may be liars exclude no robot"
    told(team, gang, words_about(team, 6, range(TWO + 1)))
    assert all(table[free] == UNSAID for table in tables(team))
    before = team.slots
    taken = [gang.message(6, {slot: gang.claim(6, slot)}, slot=slot) for slot in gang.places]
    for said in taken:  # with the best bid that may be
        team.comm_round(said_by=[said])
        assert team.slots == before
    assert all(table[free] == UNSAID for table in tables(team))
    assert all(evidence_of(agent).excluded == {6} for agent in team.agents) and not team.counts("uncertified")
    assert all(unwrap(payload, N)[1].restless for payload in team.comm_round())


def test_version_without_held_words_is_freed_by_witnesses() -> None:
    team, gang = settled_team()
    evidence = evidence_of(team.agents[0])
    free = [slot for slot in gang.places if slot not in team.slots]
    table = list(tables(team)[0])
    table[free[0]], table[free[1]] = (1, -1.0, 6), (2, -1.0, 6)
    evidence._page.freed[free[1], 2, NO_OWNER] = RELEASED
    told(team, gang, words_about(team, 6, range(TWO + 1)))
    kept = evidence.without_excluded(tuple(table))
    assert (kept[free[0]], kept[free[1]]) == ((1, -1.0, 6), (2, 0.0, NO_OWNER))
    evidence._page.held[free[0], kept[free[0]]] = Certificate(number=1)
    evidence._page.last[6] = (1, free[0])
    evidence.witness(kept, Occupancy())
    assert (free[0], 2, NO_OWNER) in evidence._page.words._said


def test_an_honest_robot_that_is_excluded_claims_nothing() -> None:
    team, gang = settled_team()
    told(team, gang, words_about(team, 0, range(1, 4)))
    team.comm_round()
    assert team.slots[0] is None and all(entry[2] != 0 for table in tables(team) for entry in table)
    assert None not in team.slots[1:]


def test_words_about_robots_that_left_nothing_are_not_kept() -> None:
    """Those that lie can sign as many of them as there are numbers."""
    team, gang = settled_team()
    sender, payload, _ = gang.message(5)
    content, proofs = unwrap(payload, N)
    words = words_about(team, 6, range(5, 7)) + words_about(team, 1999, range(5, 7))
    said = team.comm_round(said_by=[(sender, wrap(content, msgspec.structs.replace(proofs, restless=words)), None)])
    assert not any(evidence_of(agent)._page.departures.words() for agent in team.agents)
    assert not any(unwrap(one, N)[1].restless for one in said)


def test_own_words_are_in_each_message_those_of_others_in_turn() -> None:
    team, gang = settled_team()
    evidence, signature = evidence_of(team.agents[0]), b"x"
    for robot, witness in itertools.product(range(20, 60), (0, 5)):
        evidence._page.departures.keep(robot, witness, signature)
    content, _ = unwrap(team.comm_round()[0], N)
    message, others = decode(content, N, 2), set[int]()
    for said in [evidence.prove(message).restless for _ in range(3)]:
        assert len(said) == 40 + MAX_PASSED_ON
        assert {word.robot for word in said if word.witness == 0} == {*range(20, 60)}
        others |= {word.robot for word in said if word.witness == 5}
    assert others == {*range(20, 60)}
    assert gang.members == [5, 6]


def test_robot_that_may_hear_only_liars_blames_none() -> None:
    team, gang = settled_team()
    slot, *_ = claimed_in_secret(team, gang)
    evidence, table = evidence_of(team.agents[1]), tables(team)[1]
    evidence._page.departures._left[6] = {(0, version) for version in range(MAX_DEPARTURES + 1)}
    for alive, stated in ((2 * TWO, NO_OWNER), (2 * TWO + 1, left_by(6))):
        evidence._page.words._said, evidence._page.departures._words = {}, {}
        evidence._page.departures._causes[slot, 0] = LastClaim(slot, 0, -1e-9, 6, 1, b"", None)
        for _ in range(2):
            evidence._page.departures.outdate(slot, table[slot])
            evidence.witness(table, Occupancy(alive=alive))
        assert {*evidence._page.words._said} == {(slot, 1, stated)}
        assert bool(evidence._page.departures.words()) == (stated != NO_OWNER)


def test_unsigned_word_ends_the_message() -> None:
    team, gang = settled_team()
    forged = tuple(RestlessWord(0, word.witness, word.signature) for word in words_about(team, 6, range(TWO + 1)))
    told(team, gang, forged)
    assert not any(evidence_of(agent).excluded for agent in team.agents)
    assert team.counts("uncertified") == len(team.agents)


def spread(mission: Mission) -> list[Point]:
    """Starts in radio contact, over several hops."""
    rng = np.random.default_rng([3, mission.n_robots, 3])
    return [tuple(row) for row in start_positions(mission, None, "connected", rng).tolist()]


@pytest.mark.no_cover
def test_robot_that_moves_on_repeatedly_is_excluded_by_all() -> None:
    team = beside_lies("moves on before others know", MISSION, line_up(N), liars=TWO, rounds=40)
    assert {evidence_of(agent).excluded for agent in team.agents} == {frozenset({5})} and team.settled()


@pytest.mark.no_cover
def test_leaving_a_secretly_taken_place_is_not_blamed() -> None:
    """Only the framed robot hears a claim on its place; those out of its radio contact hear of the cause by others."""
    mission = Mission(shape="circle", n_robots=10)
    team = beside_lies("frames one robot", mission, spread(mission), liars=3, rounds=40)
    blamed = set[int]().union(*(evidence_of(agent)._page.departures._left for agent in team.agents))
    assert blamed and blamed <= {7, 8, 9} and None not in team.slots


def claimed_in_secret(team: SignedTeam, gang: Gang) -> tuple[int, Message, Proofs]:
    """A liar's claim on robot 0's place, which is told to it alone, and one on a free place, told to the others."""
    slot = next(a for a in gang.places if a == team.slots[0])
    free = next(a for a in gang.places if a not in team.slots)
    outbids, stays = gang.claim(6, slot, bid=-1e-9), gang.claim(6, free)
    team.comm_round(
        said_by=[
            gang.message(6, {slot: outbids}, slot=slot, hears=[0]),
            gang.message(6, {free: stays}, slot=free, hears=range(1, N)),
        ]
    )
    content, proofs = unwrap(gang.message(5, {})[1], N)
    entry, certificate = outbids
    cause = LastClaim(slot, *entry, certificate.number, certificate.signature, certificate.grant)
    return slot, decode(content, N, 2), msgspec.structs.replace(proofs, causes=(cause,))


def test_outdated_claim_is_passed_on_as_cause_of_a_departure() -> None:
    team, gang = settled_team()
    slot, _, proofs = claimed_in_secret(team, gang)
    assert team.slots[0] != slot and tables(team)[1][slot][2] == 0
    said = team.comm_round()
    assert not any(unwrap(payload, N)[1].causes for payload in said)
    said = team.comm_round()
    assert any(unwrap(payload, N)[1].causes == proofs.causes for payload in said)
    team.end()
    team.fly(3)
    stated = {what[2] for agent in team.agents for what in evidence_of(agent)._page.words._said}
    freed = [evidence_of(agent)._page.freed.get((slot, 1, NO_OWNER)) for agent in team.agents]
    assert all(grant is None or grant.by == 6 for grant in freed) and stated <= {NO_OWNER, left_by(6)}


def test_outdated_cause_is_checked_and_must_outbid_a_claim() -> None:
    team, gang = settled_team()
    slot, message, proofs = claimed_in_secret(team, gang)
    (cause,) = proofs.causes
    evidence, table = evidence_of(team.agents[2]), tables(team)[2]
    assert not evidence._page.departures.causes

    def hears(**changes: object) -> bool:
        evidence._page.departures._causes = {}
        told = msgspec.structs.replace(proofs, causes=(msgspec.structs.replace(cause, **changes),))
        evidence.admit(message, told, table)
        return bool(evidence._page.departures.causes)

    assert hears() and evidence._page.departures.causes == (cause,)
    assert not hears(slot=len(table)) and not hears(version=1) and not hears(bid=-99.0)
    assert not hears(number=10**6), "it may count"
    assert not evidence.rejected["uncertified"]
    assert not hears(signature=b"x" * 64) and not hears(bid=1.0)
    assert evidence.rejected["uncertified"] == 2
    evidence._page.departures._causes = {(slot, 0): cause}
    before = len(evidence._checks._good)
    evidence.admit(message, proofs, table)
    assert (
        len(evidence._checks._good) == before
        and (slot, (cause.version, cause.bid, cause.owner)) in evidence._page.departures._outdated
    )


def test_departure_words_count_only_of_possible_claimants() -> None:
    team, gang = settled_team()
    slot = next(a for a in gang.places if a == team.slots[0])
    words = [gang.word(6, slot, left_by(robot)) for robot in (0, 3)]
    team.comm_round(said_by=[gang.message(6, words=words)])
    heard = set(evidence_of(team.agents[1])._page.words._said)
    assert heard == {(slot, 1, left_by(0))}


def test_robot_that_left_a_place_has_not_blocked_it() -> None:
    team, gang = settled_team()
    slot = team.slots[0] or 0
    statement = word_statement(gang.about, slot, 1, left_by(0))
    grant = ReleaseGrant(tuple((j, ToyKeys(j).sign(statement)) for j in range(TWO + 1)), 0)
    evidence = evidence_of(team.agents[1])
    certificate = Certificate(number=0, grant=grant)
    assert evidence._holds(slot, (1, 0.0, NO_OWNER), certificate, N)
    assert not evidence._holds(slot, (1, 0.0, BLOCKED), certificate, N)


def test_silent_robot_claims_nothing() -> None:
    """Its heart does not beat, so the place would be freed again in the next round."""
    team, gang = settled_team()
    free = next(a for a in gang.places if a not in team.slots)
    for agent in team.agents:
        evidence_of(agent).witness(agent.claim.table or (), Occupancy(silent=frozenset({6})))
    team.comm_round(said_by=[gang.message(6, {free: gang.claim(6, free)}, slot=free)])
    assert all(table[free] == UNSAID for table in tables(team))
    for agent in team.agents:
        evidence_of(agent).witness(agent.claim.table or (), Occupancy())
    team.comm_round(said_by=[gang.message(6, {free: gang.claim(6, free)}, slot=free)])
    assert all(table[free][2] == 6 for table in tables(team))


def test_evidence_of_another_plan_excludes_no_robot() -> None:
    team, gang = settled_team()
    told(team, gang, words_about(team, 6, range(TWO + 1)))
    evidence: Evidence = evidence_of(team.agents[0])
    assert evidence.excluded == {6}
    evidence.turn_to(Context(team.context.mission, "another"))
    assert evidence.excluded == frozenset()
