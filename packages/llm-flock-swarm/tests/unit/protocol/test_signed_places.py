"""What a keyed robot that lies cannot do with claims of others: free or block their places, exchange or change them."""

from __future__ import annotations

import itertools
import math

import msgspec
import pytest
from signed_team import Liar, SignedTeam, evidence_of, free_slot, line_up
from toy_keys import ToyKeys

from llm_flock.message import BLOCKED, NO_OWNER, BidEntry, Message, Offer
from llm_flock.mission import Mission
from llm_flock_swarm._signed.certificates import (
    Certificate,
    ExchangeGrant,
    Proofs,
    ReleaseGrant,
    WitnessStatement,
    acceptance_statement,
    drawn_bid,
    offer_statement,
    unwrap,
    wrap,
)

MISSION = Mission(shape="circle", n_robots=5)


def versions(team: SignedTeam) -> int:
    return max(entry[0] for agent in team.agents for entry in agent.claim.table or ())


@pytest.mark.parametrize("version", [1, 7, 2**39])
def test_no_robot_raises_a_version_alone(team: SignedTeam, liar: Liar, version: int) -> None:
    before = team.slots
    team.fly(2, lambda: [liar.says({a: liar.claim(a, version) for a in range(5)})])
    assert team.slots == before
    assert versions(team) < version or version == 1
    assert team.held_by_liar() == 0


def test_places_of_the_living_are_not_released_by_one(team: SignedTeam, liar: Liar) -> None:
    before, owners, table = team.slots, team.owners(0), team.agents[0].claim.table
    assert table is not None
    # One a communication round: a robot decides on the newest message of each sender.
    turn = itertools.cycle(
        [
            lambda words, twice, forged: liar.says(words=words),
            lambda words, twice, forged: liar.says(twice),
            lambda words, twice, forged: liar.says(forged),
        ]
    )

    def silence() -> list[bytes]:
        words = [liar.word(a, table[a][0] + 1) for a in range(5)]
        twice = {
            a: (
                (table[a][0] + 1, 0.0, NO_OWNER),
                Certificate(
                    number=0, grant=ReleaseGrant(((team.liar, words[a].signature), (team.liar, words[a].signature)))
                ),
            )
            for a in range(5)
        }
        forged = {
            a: (
                entry,
                Certificate(number=0, grant=ReleaseGrant(((0, words[a].signature), (team.liar, words[a].signature)))),
            )
            for a, (entry, _) in twice.items()
        }
        return [next(turn)(words, twice, forged)]

    team.fly(3, silence)
    assert team.slots == before
    assert team.owners(0) == owners
    assert team.counts("uncertified") > 0


def test_two_witnesses_free_a_place_of_the_dead(team: SignedTeam) -> None:
    slot = team.slots[3]
    assert slot is not None
    team.agents.pop()
    team.fly(16)
    table = team.agents[0].claim.table
    assert table is not None and table[slot][2] in (NO_OWNER, BLOCKED)
    assert team.settled()


def test_two_witnesses_block_a_place_with_a_body_on_it(team: SignedTeam) -> None:
    team.fly(10)
    slot, plan = team.slots[3], team.agents[0].plan
    assert slot is not None and plan is not None
    assert math.dist(team.positions[3], plan.points[slot]) < 0.5
    team.agents.pop()
    team.fly(20)
    table = team.agents[0].claim.table
    assert table is not None and table[slot][2] == BLOCKED


def test_false_witness_statements_do_not_count(team: SignedTeam, liar: Liar) -> None:
    table = team.agents[0].claim.table
    assert table is not None
    good = liar.word(0, table[0][0] + 1)
    for word in (
        WitnessStatement(team.liar, 0, table[0][0] + 1, NO_OWNER, bytes(64)),
        WitnessStatement(team.liar, 0, table[0][0] + 2, NO_OWNER, good.signature),
        WitnessStatement(team.liar, 99, 1, NO_OWNER, good.signature),
    ):
        team.tell(0, liar.says(words=[word]), team.liar)
        team.comm_round()
    team.tell(1, liar.says(words=[good, good]), team.liar)
    team.comm_round()
    first, second = evidence_of(team.agents[0]), evidence_of(team.agents[1])
    assert first._page.words._said == {}
    assert first.rejected["uncertified"] == 1
    assert [list(words) for words in second._page.words._said.values()] == [[team.liar]]


def test_liar_cannot_change_entries_that_others_signed(team: SignedTeam, liar: Liar) -> None:
    agent = team.agents[0]
    table, evidence = agent.claim.table, evidence_of(agent)
    assert table is not None
    before, owned = team.slots, [entry for entry in table if entry[2] >= 0]
    lies = {}
    for a, entry in enumerate(table):
        if entry[2] >= 0:
            lies[a] = ((entry[0], 0.0, entry[2]), evidence._page.held[a, entry])
    team.fly(2, lambda: [liar.says(lies)])
    assert team.slots == before
    assert [entry for entry in agent.claim.table or () if entry[2] >= 0] == owned
    assert team.counts("uncertified") > 0


def test_old_claims_of_others_are_no_news() -> None:
    """Everything ever said is said again by the liar, as it was."""
    team = SignedTeam(MISSION, line_up(5))
    liar = Liar(team)
    seen: list[dict[int, tuple[BidEntry, Certificate]]] = []
    for _ in range(6):
        team.begin()
        for _ in range(5):
            team.comm_round()
            for agent in team.agents:
                evidence = evidence_of(agent)
                held = {a: (e, evidence._page.held[a, e]) for a, e in enumerate(agent.claim.table or ()) if e[2] >= 0}
                seen.append(held)
        team.end()
    assert team.settled()
    before = team.slots
    plan = team.agents[0].plan
    again = [liar.says(held) for held in seen if held]
    team.fly(1, lambda: again)
    team.fly(3)
    assert team.settled()
    assert (team.slots, team.agents[0].plan) == (before, plan)


def test_one_place_offered_to_two_is_one_exchange(team: SignedTeam, liar: Liar) -> None:
    """Both accept, as both gain; the liar ends with one of the two places."""
    slot = free_slot(team)
    team.fly(2, lambda: [liar.says({slot: liar.claim(slot, number=1)}, slot=slot)])
    assert team.held_by_liar() == 1
    team.begin()
    for victim in (1, 2):
        table, theirs = team.agents[victim].claim.table, team.slots[victim]
        assert table is not None and theirs is not None
        offer = Offer(
            to=victim,
            give=slot,
            take=theirs,
            give_version=table[slot][0],
            take_version=table[theirs][0],
            bid=drawn_bid(team.context, theirs, table[theirs][0] + 1, team.liar),
        )
        # For this communication round the victim believes to be where the exchange pays.
        assert team.agents[0].plan is not None
        team.agents[victim]._agreement.position = team.agents[0].plan.points[slot]
        there = {**team.agents[victim]._agreement.sensed, team.liar: team.agents[0].plan.points[theirs]}
        team.agents[victim]._agreement.sensed = there
        team.tell(victim, liar.says(offer=offer, offer_number=liar.number + victim, slot=slot), team.liar)
    team.comm_round()
    assert [team.slots[1], team.slots[2]] == [slot, slot]
    for _ in range(4):
        team.comm_round()
    team.end()
    team.fly(8)
    assert team.held_by_liar() <= 1
    assert team.settled()
    assert team.counts("uncertified") == 0


def test_offers_without_a_signature_are_not_heard(team: SignedTeam, liar: Liar) -> None:
    take = team.slots[1] or 0
    bid = drawn_bid(team.context, take, 1, team.liar)
    offer = Offer(to=1, give=0, take=take, give_version=0, take_version=0, bid=bid)
    good = unwrap(liar.says(offer=offer), 5)
    table = team.agents[0].claim.table
    assert table is not None
    evidence = evidence_of(team.agents[0])
    message = Message(
        sender=4, sequence=0, degree=0, plan=team.agents[0].plan, provenance=team.agents[0].provenance, offer=offer
    )
    assert evidence.admit(message, good[1], table).offer == offer
    statement = offer_statement(team.context, 4, offer, 10**6)
    for proof in (None, (0, b""), (2, good[1].offer[1]), (10**6, ToyKeys(4).sign(statement))):  # type: ignore[index]
        assert evidence.admit(message, Proofs(offer=proof), table).offer is None
    generous = msgspec.structs.replace(
        message, offer=Offer(to=1, give=0, take=1, give_version=0, take_version=0, bid=1.0)
    )
    assert evidence.admit(generous, good[1], table).offer is None


def test_exchanges_need_both(team: SignedTeam, liar: Liar) -> None:
    """An exchange with oneself, with a forged partner, or of other places than it says; one that both signed counts."""
    table = team.agents[0].claim.table
    assert table is not None
    numbers = itertools.count(max(evidence_of(agent)._page.number for agent in team.agents) + 1)

    def of(
        maker: int = team.liar, to: int = 0, give: int = 0, take: int = 1, partner: int = team.liar
    ) -> ExchangeGrant:
        versions = table[give][0], table[take][0]
        done = ExchangeGrant(
            maker=maker,
            to=to,
            give=give,
            take=take,
            give_version=versions[0],
            take_version=versions[1],
            bid=drawn_bid(team.context, take, versions[1] + 1, maker),
            number=next(numbers),
            signature=b"",
            accepted_bid=drawn_bid(team.context, give, versions[0] + 1, to),
            accepted_number=next(numbers),
            accepted=b"",
        )
        signature = liar.keys.sign(offer_statement(team.context, done.maker, done.offer(), done.number))
        done = msgspec.structs.replace(done, signature=signature)
        return msgspec.structs.replace(done, accepted=ToyKeys(partner).sign(acceptance_statement(team.context, done)))

    def say(*exchanges: ExchangeGrant) -> list[tuple[tuple[int, int], ...]]:
        for done in exchanges:
            lies = {a: (entry, Certificate(number=number, grant=done)) for a, (entry, number) in done.entries().items()}
            team.fly(1, lambda lies=lies: [liar.says(lies)])
        return [tuple(team.owners(j)) for j in range(4)]

    before = say()
    assert say(of(), of(to=4), of(take=0), of(maker=2, partner=0)) == before
    other = {3: ((table[0][0] + 1, 0.0, 4), Certificate(number=1, grant=of()))}
    team.fly(1, lambda: [liar.says(other)])
    assert say() == before
    assert say(of(partner=0)) != before


def test_entries_that_no_honest_robot_writes_are_rejected(team: SignedTeam, liar: Liar) -> None:
    slot = free_slot(team)
    before = team.owners(0)
    for lie in (
        ((0, 1e6, NO_OWNER), Certificate(number=0)),
        ((0, -1.0, NO_OWNER), Certificate(number=0, grant=None)),
        ((1, 0.0, BLOCKED), Certificate(number=0)),
        ((1, 1.0, BLOCKED), Certificate(number=0)),
        ((0, 0.0, BLOCKED), Certificate(number=0)),
        ((0, 1.0, team.liar), Certificate(number=1)),
        ((0, 0.0, team.liar), Certificate(number=1)),
        ((0, 1.0, NO_OWNER), Certificate(number=0, grant=ReleaseGrant(((0, b""), (1, b""))))),
    ):
        team.fly(1, lambda lie=lie: [liar.says({slot: lie})])
        assert team.owners(0) == before
    without = liar.says({slot: liar.claim(slot)})
    message, proofs = unwrap(without, 5)
    team.fly(1, lambda: [wrap(message, msgspec.structs.replace(proofs, claims=()))])
    assert team.owners(0) == before
