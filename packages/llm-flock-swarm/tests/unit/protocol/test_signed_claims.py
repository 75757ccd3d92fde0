"""What a keyed robot that lies cannot do with claims of its own: hold two places, claim without end, choose its bid."""

from __future__ import annotations

import dataclasses
import itertools

import msgspec
import pytest
from signed_team import Liar, SignedTeam, channel_of, evidence_of, free_slot, line_up
from tables import told
from toy_keys import ToyKeys

from llm_flock.events import CommRoundEnded
from llm_flock.message import NO_OWNER, UNSAID, BidTable, Message, MissionStamp, Offer
from llm_flock.mission import Mission
from llm_flock.protocol._agreement.assignment import Claim
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock_swarm._signed.assignment import SignedAssignment
from llm_flock_swarm._signed.certificates import (
    Certificate,
    Context,
    LastClaim,
    Proofs,
    ReleaseGrant,
    claim_statement,
    claims_of,
    drawn_bid,
    most_claims,
    most_exchanges,
    plausible,
    word_statement,
)
from llm_flock_swarm._signed.checks import SPARE
from llm_flock_swarm._signed.evidence import Evidence

MISSION = Mission(shape="circle", n_robots=5)


def test_honest_robots_settle_as_they_do_without_signatures(team: SignedTeam) -> None:
    assert team.counts("uncertified") == 0
    assert team.held_by_liar() == 0


def test_an_honest_fifth_finds_the_free_place(team: SignedTeam, liar: Liar) -> None:
    slot = free_slot(team)
    team.fly(3, lambda: [liar.says({slot: liar.claim(slot, number=1)}, slot=slot)])
    assert team.settled()
    assert team.held_by_liar() == 1


@pytest.mark.no_cover
def test_a_robot_that_claims_every_place_holds_at_most_one(team: SignedTeam, liar: Liar) -> None:
    """With the best of bids, over and over, until its claims are used up."""

    version = itertools.cycle(range(3))

    def everything() -> list[bytes]:
        said = next(version)
        return [liar.says({a: liar.claim(a, said) for a in range(5)})]

    for _ in range(30):
        team.fly(1, everything)
        for agent in team.agents:
            evidence = evidence_of(agent)
            last = evidence._page.last.get(team.liar)
            holding = [
                (evidence._page.held[a, e].number, a)
                for a, e in enumerate(agent.claim.table or ())
                if e[2] == team.liar and evidence.precedence(a, e) == last
            ]
            assert len(holding) <= 1
    team.fly(12)
    assert team.held_by_liar() <= 1
    assert team.settled()
    assert team.smallest >= MISSION.safe_distance - 1e-9


def test_one_message_takes_one_place() -> None:
    team = SignedTeam(MISSION, line_up(5))
    liar = Liar(team)
    team.begin()
    for _ in range(4):
        team.comm_round()  # one plan
    team.comm_round([liar.says({a: liar.claim(a) for a in range(5)})])
    assert team.held_by_liar() == 1


def test_claims_have_an_end(team: SignedTeam, liar: Liar) -> None:
    slot = free_slot(team)
    team.fly(1, lambda: [liar.says({slot: liar.claim(slot, number=most_claims(5) + 1)})])
    assert team.held_by_liar() == 0
    assert team.counts("many_claims") > 0


def test_a_claim_made_again_counts_by_its_higher_number(team: SignedTeam, liar: Liar) -> None:
    slot, bid = free_slot(team), -0.5
    last = [evidence_of(agent)._page.last for agent in team.agents]
    team.fly(1, lambda: [liar.says({slot: liar.claim(slot, bid=bid, number=2)}, slot=slot)])
    assert {of[team.liar] for of in last} == {(2, slot)}
    team.fly(1, lambda: [liar.says({slot: liar.claim(slot, bid=bid, number=7)}, slot=slot)])
    assert {of[team.liar] for of in last} == {(7, slot)}
    team.fly(1, lambda: [liar.says({slot: liar.claim(slot, bid=bid, number=5)}, slot=slot)])
    team.fly(1, lambda: [liar.says({slot: liar.claim(slot, bid=bid, number=most_claims(5) + 1)}, slot=slot)])
    assert {of[team.liar] for of in last} == {(7, slot)}
    assert team.counts("uncertified") == 0


def test_claim_is_renewed_after_an_offer_without_effect(team: SignedTeam) -> None:
    """A robot that accepted it, unheard, takes the maker to be elsewhere under the offer's number."""
    agent = team.agents[0]
    evidence, claim, slot = evidence_of(agent), agent.claim, agent.claim.slot
    assert claim.table is not None
    assert slot is not None
    offer = Offer(to=1, give=slot, take=(slot + 1) % 5, give_version=0, take_version=0, bid=-1.0)
    offered = evidence._offer(offer)
    assert offered is not None
    evidence.attest(msgspec.structs.replace(claim, offer=offer))
    assert evidence.precedence(slot, claim.table[slot])[0] < offered[0]
    evidence.attest(msgspec.structs.replace(claim, offer=None))
    assert evidence.precedence(slot, claim.table[slot])[0] > offered[0]
    team.fly(2)
    assert {evidence_of(other)._page.last[0] for other in team.agents} == {evidence.precedence(slot, claim.table[slot])}


def test_restarted_robot_learns_its_last_number(team: SignedTeam, liar: Liar) -> None:
    """Its first claims count for nothing, as its former life has made later ones: it would claim in vain for long."""
    slot = free_slot(team)
    team.fly(1, lambda: [liar.says({slot: liar.claim(slot, bid=-1.0, number=41)}, slot=slot)])
    other, table = evidence_of(team.agents[1]), team.agents[1].claim.table or ()
    message = Message(sender=1, sequence=0, degree=0, plan=team.agents[1].plan, **told(table))
    assert other.prove(message).last == ()
    first = (slot + 1) % 5
    team.begin()
    team.tell(1, liar.says({first: liar.claim(first, number=1)}, slot=first), 4)
    team.agents[1].handle(CommRoundEnded())
    proofs = other.prove(message)
    assert [(last.owner, last.number, last.slot) for last in proofs.last] == [(4, 41, slot)]
    assert other.prove(message).last == (), "once"

    fresh = Evidence(4, ToyKeys(4))
    fresh.turn_to(team.context)
    fresh.admit(Message(sender=1, sequence=0, degree=0, plan=message.plan), proofs, (UNSAID,) * 5)
    assert fresh._page.number == 42


def test_robot_without_place_takes_a_given_one_despite_claims() -> None:
    team = SignedTeam(MISSION, line_up(5))
    team.fly(1)
    evidence, plan = Evidence(0, ToyKeys(0)), team.agents[0].plan
    evidence.turn_to(team.context)
    for slot, number in ((1, 7), (2, 3)):
        entry = (0, -1.0, 0)
        signature = ToyKeys(0).sign(claim_statement(team.context, slot, entry, number))
        claims, grants = claims_of({slot: Certificate(number=number, signature=signature)})
        said = tuple(entry if a == slot else UNSAID for a in range(5))
        message = Message(sender=1, sequence=0, degree=0, plan=plan, **told(said))
        assert evidence.admit(message, Proofs(claims=claims, grants=grants), (UNSAID,) * 5).table == said
        assert evidence._page.last[0] == (7, 1)
    assert evidence._page.number == 7


def test_robot_learns_its_number_only_from_its_own_claims(team: SignedTeam, liar: Liar) -> None:
    evidence, table = evidence_of(team.agents[0]), team.agents[0].claim.table or ()
    before, entry = evidence._page.number, (0, -1.0, 0)
    forged = LastClaim(1, *entry, 50, liar.keys.sign(claim_statement(team.context, 1, entry, 50)), None)
    own = ToyKeys(0).sign(claim_statement(team.context, 1, entry, 10**6))
    for last in (forged, msgspec.structs.replace(forged, owner=4), LastClaim(1, *entry, 10**6, own, None)):
        message = Message(sender=4, sequence=0, degree=0, plan=team.agents[0].plan)
        evidence.admit(message, Proofs(last=(last,)), table)
        assert evidence._page.number == before
    true = LastClaim(1, *entry, 50, ToyKeys(0).sign(claim_statement(team.context, 1, entry, 50)), None)
    evidence.admit(message, Proofs(last=(true,)), table)
    assert evidence._page.number == 51
    evidence.admit(message, Proofs(last=(true,)), table)
    assert evidence._page.number == 51


def test_robot_out_of_numbers_offers_and_accepts_nothing(team: SignedTeam) -> None:
    """Others would not hear it, and take it for a liar."""
    evidence = evidence_of(team.agents[0])
    evidence._page.number = most_exchanges(5) - SPARE
    assert evidence.may_exchange(5)
    evidence._page.number += 1
    assert not evidence.may_exchange(5)
    now = SignedAssignment(AuctionAssignment(), evidence)._admit(
        team.agents[0]._agreement._assignment_input(team.agents[0].plan, adopted=True, heard=[]),  # type: ignore[arg-type]
        team.agents[0].claim.table or (),
    )
    assert not now.exchanges


def test_old_claims_on_later_versions_are_no_reason_for_words(team: SignedTeam, liar: Liar) -> None:
    """Each would be a word of an honest robot, with it another version could be shown as freed, and so on."""
    evidence, table = evidence_of(team.agents[0]), team.agents[0].claim.table
    slot = free_slot(team)
    assert table is not None and table[slot] == UNSAID
    evidence._page.last[team.liar] = (1000, 0)

    def shown(version: int, table: BidTable) -> BidTable:
        words = [(j, ToyKeys(j).sign(word_statement(team.context, slot, version, NO_OWNER))) for j in (1, 2)]
        entry, certificate = liar.claim(slot, version)
        freed = dataclasses.replace(certificate, grant=ReleaseGrant(tuple(words)))
        inbound = channel_of(team.agents[0]).open(liar.says({slot: (entry, freed)}), team.liar)
        assert isinstance(inbound.message.proofs, Proofs)
        return evidence.admit(inbound.message, inbound.message.proofs, table).table or ()

    for version in range(1, 9):
        assert shown(version, table)[slot] == (version, 0.0, NO_OWNER), "its words count"
        assert evidence.freed(slot, version)
        assert not evidence._page.departures.causes and not evidence._page.departures._outdated
    # On the version in the table it is one.
    later = (*table[:slot], (8, -1e9, 0), *table[slot + 1 :])
    assert shown(8, later)[slot] == UNSAID and len(evidence._page.departures.causes) == 1
    assert {a for a, _ in evidence._page.departures._outdated} == {slot}


def test_the_bid_for_a_freed_place_is_drawn(team: SignedTeam, liar: Liar) -> None:
    """So no robot outbids another everywhere."""
    context = team.context
    draws = [drawn_bid(context, slot, version, robot) for slot in range(5) for version in (1, 2) for robot in range(5)]
    assert len(set(draws)) == len(draws) and all(-(2**20) <= bid <= -1.0 for bid in draws)
    entry = (1, drawn_bid(context, 0, 1, 4), 4)
    assert plausible(context, 0, entry, 1) and not plausible(context, 0, entry, 0)
    assert not plausible(context, 1, entry, 1) and not plausible(context, 0, (1, 0.0, 4), 1)
    assert plausible(context, 0, (0, -3.0, 4), 1) and not plausible(context, 0, (0, 1.0, 4), 1)


def test_of_two_places_none_is_claimed_again(team: SignedTeam, liar: Liar) -> None:
    slot = free_slot(team)
    evidence, table = evidence_of(team.agents[0]), team.agents[0].claim.table
    assert table is not None
    other = next(a for a in range(5) if a != slot)
    first, second = liar.claim(slot, number=2), liar.claim(other, number=3)
    evidence._keep(slot, *first)
    evidence._keep(other, *second)
    again = liar.claim(slot, number=4)[1]
    both = tuple({slot: first[0], other: second[0]}.get(a, entry) for a, entry in enumerate(table))
    evidence._renew(slot, both, again)
    assert evidence._page.last[team.liar] == (3, other)
    evidence._renew(slot, tuple(first[0] if a == slot else entry for a, entry in enumerate(table)), again)
    assert evidence._page.last[team.liar] == (4, slot)


def test_a_vacant_place_may_be_looked_at(team: SignedTeam, liar: Liar) -> None:
    slot = free_slot(team)
    team.fly(1, lambda: [liar.says({slot: ((0, 2.0, NO_OWNER), Certificate(number=0))})])
    table = team.agents[0].claim.table
    assert table is not None and table[slot][1] >= 2.0


def test_a_plan_that_comes_back_is_another_one() -> None:
    """Its old claims do not count: a robot that begins again would seem to leave one place after another."""
    team = SignedTeam(MISSION, line_up(5), gaps="replan")
    team.fly(2)
    liar = Liar(team)
    plan, before = team.agents[0].plan, team.context
    again = liar.provenance(epoch=3, sequence=1)
    team.fly(1, lambda: [liar.says(plan=plan, provenance=again, table=None)])
    assert all((agent.plan, agent.provenance) == (plan, again) for agent in team.agents)
    team.fly(3)
    slot = free_slot(team)
    assert team.settled() and plan is not None and (team.agents[0].claim.table or ())[slot] == UNSAID

    def replayed(context: Context) -> bytes:
        entry = (0, -1.0, 1)
        signature = ToyKeys(1).sign(claim_statement(context, slot, entry, 90))
        return liar.says({slot: (entry, Certificate(number=90, signature=signature))})

    def refused() -> int:
        return sum(evidence_of(agent).rejected["uncertified"] for agent in team.agents)

    owners, refusals = team.owners(0), refused()
    team.fly(1, lambda: [replayed(before)])
    assert team.owners(0) == owners and refused() > refusals
    team.comm_round([replayed(team.context)])
    assert team.owners(0) != owners, "signed about the plan in force it counts"


def test_evidence_is_about_one_plan(team: SignedTeam) -> None:
    """Of each proposer the last plan is remembered, until another mission comes."""
    evidence, context = evidence_of(team.agents[0]), team.context
    assert context.origin is not None
    number = evidence._page.number
    evidence.attest(Claim(slot=None))
    assert not evidence.turn_to(context)
    assert evidence._page.number == number > 0
    others = (
        msgspec.structs.replace(context.origin, proposer=4),
        msgspec.structs.replace(context.origin, epoch=1, sequence=1),
    )
    assert evidence.turn_to(Context(context.mission, "another", others[0]))
    assert evidence._page.number == 0
    assert not evidence.turn_to(context)
    assert evidence._page.number == number
    assert evidence.turn_to(Context(context.mission, context.plan, others[1]))
    assert evidence._page.number == 0
    assert not evidence.turn_to(Context(context.mission, "another", others[0]))
    assert not evidence.turn_to(Context(context.mission, context.plan, others[1]))
    assert evidence.turn_to(context), "its proposer has proposed another one since"
    assert evidence.turn_to(Context(MissionStamp(9, context.mission.digest), context.plan, others[0]))
    assert evidence.turn_to(context)
