"""What a keyed robot that lies cannot do: hold two places, raise versions, speak for others, stop their hearts."""

from __future__ import annotations

import itertools
import math

import msgspec
import pytest
from signed_team import Liar, SignedTeam, good_plan, line_up
from toy_keys import ToyKeys

from llm_flock.errors import MessageError
from llm_flock.mission import Mission
from llm_flock.protocol.assignment import Claim
from llm_flock.protocol.codec import encode
from llm_flock.protocol.events import MissionGiven
from llm_flock.protocol.messages import BLOCKED, NO_OWNER, Entry, Message, Offer, Stamp
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.signing import Signing
from llm_flock.protocol.warrants import (
    MOST_EPOCHS,
    OPERATOR,
    Context,
    Exchanged,
    Freed,
    Order,
    Proofs,
    Warrant,
    Word,
    beat_statement,
    mission_statement,
    most_claims,
    offer_statement,
    unwrap,
    word_statement,
    wrap,
)

MISSION = Mission(shape="circle", n_robots=5)


@pytest.fixture
def team() -> SignedTeam:
    made = SignedTeam(MISSION, line_up(5))
    made.fly(6)
    assert made.settled()
    return made


@pytest.fixture
def liar(team: SignedTeam) -> Liar:
    return Liar(team)


def free_slot(team: SignedTeam) -> int:
    table = team.agents[0].claim.table
    assert table is not None
    return next(a for a, entry in enumerate(table) if entry[2] == NO_OWNER)


def versions(team: SignedTeam) -> int:
    return max(entry[0] for agent in team.agents for entry in agent.claim.table or ())


def test_honest_robots_settle_as_they_do_without_signatures(team: SignedTeam) -> None:
    assert team.counts("unwarranted") == 0
    assert team.held_by_liar() == 0


def test_an_honest_fifth_finds_the_free_place(team: SignedTeam, liar: Liar) -> None:
    slot = free_slot(team)
    team.fly(3, lambda: [liar.says({slot: liar.claim(slot, number=1)}, slot=slot)])
    assert team.settled()
    assert team.held_by_liar() == 1


def test_who_claims_every_place_holds_one_at_most(team: SignedTeam, liar: Liar) -> None:
    """With the best of bids, over and over, until its claims are used up."""

    version = itertools.cycle(range(3))

    def everything() -> list[bytes]:
        said = next(version)
        return [liar.says({a: liar.claim(a, said) for a in range(5)})]

    for _ in range(30):
        team.fly(1, everything)
        for agent in team.agents:
            ledger = agent._talks._signing.ledger  # type: ignore[union-attr]
            last = ledger._last.get(team.liar)
            holding = [
                (ledger._held[a, e].number, a)
                for a, e in enumerate(agent.claim.table or ())
                if e[2] == team.liar and ledger.order(a, e) == last
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
        team.tick()  # one plan
    team.tick([liar.says({a: liar.claim(a) for a in range(5)})])
    assert team.held_by_liar() == 1


def test_claims_have_an_end(team: SignedTeam, liar: Liar) -> None:
    slot = free_slot(team)
    team.fly(1, lambda: [liar.says({slot: liar.claim(slot, number=most_claims(5) + 1)})])
    assert team.held_by_liar() == 0
    assert team.counts("unwarranted") > 0


@pytest.mark.parametrize("version", [1, 7, 2**39])
def test_nobody_raises_a_version_alone(team: SignedTeam, liar: Liar, version: int) -> None:
    before = team.slots
    team.fly(2, lambda: [liar.says({a: liar.claim(a, version) for a in range(5)})])
    assert team.slots == before
    assert versions(team) < version or version == 1
    assert team.held_by_liar() == 0


def test_places_of_the_living_are_not_released_by_one(team: SignedTeam, liar: Liar) -> None:
    before, owners, table = team.slots, team.owners(0), team.agents[0].claim.table
    assert table is not None
    # One a tick: a robot decides on the newest message of each sender.
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
                Warrant(number=0, grant=Freed(((team.liar, words[a].signature), (team.liar, words[a].signature)))),
            )
            for a in range(5)
        }
        forged = {
            a: (entry, Warrant(number=0, grant=Freed(((0, words[a].signature), (team.liar, words[a].signature)))))
            for a, (entry, _) in twice.items()
        }
        return [next(turn)(words, twice, forged)]

    team.fly(3, silence)
    assert team.slots == before
    assert team.owners(0) == owners
    assert team.counts("unwarranted") > 0


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


def test_false_words_do_not_count(team: SignedTeam, liar: Liar) -> None:
    table = team.agents[0].claim.table
    assert table is not None
    good = liar.word(0, table[0][0] + 1)
    for word in (
        Word(0, table[0][0] + 1, NO_OWNER, bytes(64)),
        Word(0, table[0][0] + 2, NO_OWNER, good.signature),
        Word(99, 1, NO_OWNER, good.signature),
    ):
        team.tell(0, liar.says(words=[word]), team.liar)
        team.tick()
    team.tell(1, liar.says(words=[good, good]), team.liar)
    team.tick()
    ledgers = [agent._talks._signing.ledger for agent in team.agents]  # type: ignore[union-attr]
    assert ledgers[0]._words == {}
    assert ledgers[0].refused["unwarranted"] == 1
    assert [list(words) for words in ledgers[1]._words.values()] == [[team.liar]]


def test_what_others_signed_cannot_be_changed_on_the_way(team: SignedTeam, liar: Liar) -> None:
    agent = team.agents[0]
    table, ledger = agent.claim.table, agent._talks._signing.ledger  # type: ignore[union-attr]
    assert table is not None
    before, owned = team.slots, [entry for entry in table if entry[2] >= 0]
    lies = {}
    for a, entry in enumerate(table):
        if entry[2] >= 0:
            lies[a] = ((entry[0], 0.0, entry[2]), ledger._held[a, entry])
    team.fly(2, lambda: [liar.says(lies)])
    assert team.slots == before
    assert [entry for entry in agent.claim.table or () if entry[2] >= 0] == owned
    assert team.counts("unwarranted") > 0


def test_old_claims_of_others_are_no_news() -> None:
    """Everything ever said is said again by the liar, as it was."""
    team = SignedTeam(MISSION, line_up(5))
    liar = Liar(team)
    seen: list[dict[int, tuple[Entry, Warrant]]] = []
    for _ in range(6):
        team.begin()
        for _ in range(5):
            team.tick()
            for agent in team.agents:
                ledger = agent._talks._signing.ledger  # type: ignore[union-attr]
                held = {a: (e, ledger._held[a, e]) for a, e in enumerate(agent.claim.table or ()) if e[2] >= 0}
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
            bid=-1.0,
        )
        # For this tick the victim believes to be where the exchange pays.
        assert team.agents[0].plan is not None
        team.agents[victim]._talks._position = team.agents[0].plan.points[slot]
        there = {**team.agents[victim]._talks._sensed, team.liar: team.agents[0].plan.points[theirs]}
        team.agents[victim]._talks._sensed = there
        team.tell(victim, liar.says(offer=offer, offer_number=liar.number + victim, slot=slot), team.liar)
    team.tick()
    assert [team.slots[1], team.slots[2]] == [slot, slot]
    for _ in range(4):
        team.tick()
    team.end()
    team.fly(8)
    assert team.held_by_liar() <= 1
    assert team.settled()
    assert team.counts("unwarranted") == 0


def test_offers_without_a_signature_are_not_heard(team: SignedTeam, liar: Liar) -> None:
    offer = Offer(to=1, give=0, take=team.slots[1] or 0, give_version=0, take_version=0, bid=-1.0)
    good = unwrap(liar.says(offer=offer), 5)
    table = team.agents[0].claim.table
    assert table is not None
    ledger = team.agents[0]._talks._signing.ledger  # type: ignore[union-attr]
    message = Message(
        sender=4, sequence=0, neighbors=0, plan=team.agents[0].plan, pedigree=team.agents[0].pedigree, offer=offer
    )
    assert ledger.admit(message, good[1], table).offer == offer
    statement = offer_statement(team.context, 4, offer, 10**6)
    for proof in (None, (0, b""), (2, good[1].offer[1]), (10**6, ToyKeys(4).sign(statement))):  # type: ignore[index]
        assert ledger.admit(message, Proofs(offer=proof), table).offer is None
    generous = msgspec.structs.replace(
        message, offer=Offer(to=1, give=0, take=1, give_version=0, take_version=0, bid=1.0)
    )
    assert ledger.admit(generous, good[1], table).offer is None


def test_exchanges_need_both(team: SignedTeam, liar: Liar) -> None:
    """An exchange with oneself, with a forged partner, or of other places than it says."""
    table = team.agents[0].claim.table
    assert table is not None
    fields = {
        "maker": 4,
        "to": 0,
        "give": 0,
        "take": 1,
        "give_version": table[0][0],
        "take_version": table[1][0],
        "bid": 0.0,
        "number": 1,
        "signature": bytes(64),
        "accepted_bid": 0.0,
        "accepted_number": 1,
        "accepted": bytes(64),
    }

    def of(**other: object) -> Exchanged:
        done = Exchanged(**{**fields, **other})
        signature = liar.keys.sign(offer_statement(team.context, done.maker, done.offer(), done.number))
        return msgspec.structs.replace(done, signature=signature)

    before = team.owners(0)
    for done in (of(), of(to=4), of(take=0), of(maker=2)):
        lies = {a: (entry, Warrant(number=number, grant=done)) for a, (entry, number) in done.entries().items()}
        team.fly(1, lambda lies=lies: [liar.says(lies)])
    other = {3: ((table[0][0] + 1, 0.0, 4), Warrant(number=1, grant=of()))}
    team.fly(1, lambda: [liar.says(other)])
    assert team.owners(0) == before


def test_entries_that_nobody_honest_writes_are_refused(team: SignedTeam, liar: Liar) -> None:
    slot = free_slot(team)
    before = team.owners(0)
    for lie in (
        ((0, 1e6, NO_OWNER), Warrant(number=0)),
        ((0, -1.0, NO_OWNER), Warrant(number=0, grant=None)),
        ((1, 0.0, BLOCKED), Warrant(number=0)),
        ((1, 1.0, BLOCKED), Warrant(number=0)),
        ((0, 0.0, BLOCKED), Warrant(number=0)),
        ((0, 1.0, team.liar), Warrant(number=1)),
        ((0, 0.0, team.liar), Warrant(number=1)),
        ((0, 1.0, NO_OWNER), Warrant(number=0, grant=Freed(((0, b""), (1, b""))))),
    ):
        team.fly(1, lambda lie=lie: [liar.says({slot: lie})])
        assert team.owners(0) == before
    without = liar.says({slot: liar.claim(slot)})
    message, proofs = unwrap(without, 5)
    team.fly(1, lambda: [wrap(message, msgspec.structs.replace(proofs, claims=()))])
    assert team.owners(0) == before


def test_a_vacant_place_may_be_looked_at(team: SignedTeam, liar: Liar) -> None:
    slot = free_slot(team)
    team.fly(1, lambda: [liar.says({slot: ((0, 2.0, NO_OWNER), Warrant(number=0))})])
    table = team.agents[0].claim.table
    assert table is not None and table[slot][1] >= 2.0


def test_a_page_is_turned_for_another_plan_only(team: SignedTeam) -> None:
    ledger, context = team.agents[0]._talks._signing.ledger, team.context  # type: ignore[union-attr]
    number = ledger._number
    ledger.attest(Claim(slot=None))
    ledger.turn_to(context)
    assert ledger._number == number > 0
    ledger.turn_to(Context(context.mission, "another"))
    assert ledger._number == 0


# ---------------------------------------------------------------- plans


def test_a_hallucinated_plan_dies_with_its_author(team: SignedTeam, liar: Liar) -> None:
    plan = team.agents[0].plan
    heap = Plan.of([(50.0, 50.0 + 0.1 * k) for k in range(5)])
    lie = liar.says(plan=heap, pedigree=liar.pedigree(epoch=3), table=None, slot=None)
    team.fly(2, lambda: [lie])
    assert team.agents[0].plan == plan
    assert team.counts("unverified_plan") > 0


def test_a_plan_in_the_name_of_another_is_refused(team: SignedTeam, liar: Liar) -> None:
    plan = team.agents[0].plan
    lie = liar.says(plan=good_plan(MISSION, 3), pedigree=liar.pedigree(epoch=3, proposer=0), table=None)
    assert team.tell(1, lie, team.liar) == ["forged_origin"]
    assert team.agents[1].plan == plan


def test_a_true_plan_of_a_liar_is_a_plan(team: SignedTeam, liar: Liar) -> None:
    plan = good_plan(MISSION, 3)
    lie = liar.says(plan=plan, pedigree=liar.pedigree(epoch=1), table=None)
    team.fly(6, lambda: [lie])
    assert team.agents[0].plan == plan
    assert team.settled()


@pytest.mark.parametrize(("epoch", "sequence"), [(MOST_EPOCHS + 1, 0), (1, 2), (2**40 - 1, 0)])
def test_plans_are_remade_so_often_and_not_oftener(team: SignedTeam, liar: Liar, epoch: int, sequence: int) -> None:
    lie = liar.says(plan=good_plan(MISSION, 3), pedigree=liar.pedigree(epoch=epoch, sequence=sequence), table=None)
    assert team.tell(1, lie, team.liar) == ["many_plans"]


def test_origins_are_remembered_in_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("llm_flock.protocol.signing.REMEMBERED_ORIGINS", 2)
    monkeypatch.setattr("llm_flock.protocol.ledger.REMEMBERED", 2)
    signing = Signing(0, ToyKeys(0))
    team = SignedTeam(MISSION, line_up(5))
    team.fly(1)
    for k in range(5):
        signing.propose(Liar(team).pedigree(epoch=k), "00")
        assert signing.ledger.signed_by(1, b"%d" % k, ToyKeys(1).sign(b"%d" % k))
    assert len(signing._origins) <= 2
    assert len(signing.ledger._good) <= 2


# ---------------------------------------------------------------- who speaks


def test_nobody_speaks_for_another(team: SignedTeam, liar: Liar) -> None:
    said = liar.says(sender=2)
    assert team.tell(1, said, team.liar) == ["impostor"]
    assert team.tell(1, liar.says(), 3) == ["impostor"]
    assert team.tell(1, liar.says(sender=1), team.liar) == ["own_id"]


def test_unsigned_and_broken_messages_are_refused(team: SignedTeam, liar: Liar) -> None:
    message, _ = unwrap(liar.says(), 5)
    assert team.tell(1, message, team.liar) == ["version"]
    assert team.tell(1, b"\3\xff", team.liar) == ["malformed"]
    assert team.tell(1, b"\3" + bytes(10**5), team.liar) == ["oversized"]
    with pytest.raises(MessageError, match="version"):
        unwrap(b"", 5)


# ---------------------------------------------------------------- heartbeats


def test_hearts_are_neither_stopped_nor_kept_beating_by_others(team: SignedTeam, liar: Liar) -> None:
    before = team.agents[0]._talks.liveness.beats
    high = tuple(2**40 - 1 for _ in range(5))
    team.tell(0, liar.says(beats=high), team.liar)
    team.begin()
    team.tick()
    after = team.agents[0]._talks.liveness.beats
    assert after[4] == before[4]
    assert max(after) < 100
    team.fly(2)
    assert team.settled()


def test_a_heart_that_beats_is_heard_through_others(team: SignedTeam, liar: Liar) -> None:
    message, proofs = unwrap(liar.says(beats=(0, 0, 0, 0, 9)), 5)
    signed = msgspec.structs.replace(proofs, beats=(b"", b"", b"", b"", liar.keys.sign(beat_statement(4, 9))))
    team.begin()
    team.tell(0, wrap(message, signed), team.liar)
    for _ in range(5):
        team.tick()
    team.end()
    team.fly(2)
    assert [agent._talks.liveness.beats[4] for agent in team.agents] == [9] * 4


# ---------------------------------------------------------------- missions


def test_only_the_operator_gives_missions(team: SignedTeam, liar: Liar) -> None:
    square = MISSION.change(center=(52.0, 50.0))
    stamp = Stamp(10**9, square.digest)
    forged = Order(counter=stamp.counter, signature=liar.keys.sign(mission_statement(stamp)))
    for order in (None, forged):
        (note,) = team.agents[0].handle(MissionGiven(mission=square, order=order))
        assert (note.kind, note.detail["reason"]) == ("rejected_message", "no_order")  # type: ignore[union-attr]
    text = square.model_dump_json(include={"shape", "points", "center", "spacing", "places", "velocity", "since"})
    lie = encode(Message(sender=4, sequence=0, neighbors=0, mission=stamp, mission_text=text))
    for proofs in (Proofs(), Proofs(mission=forged.signature)):
        assert team.tell(0, wrap(lie, proofs), team.liar) == ["no_order"]
    assert team.agents[0].mission == MISSION
    team.end()

    order = Order(counter=stamp.counter, signature=ToyKeys(OPERATOR).sign(mission_statement(stamp)))
    (note,) = team.agents[0].handle(MissionGiven(mission=square, order=order))
    assert note.kind == "mission"  # type: ignore[union-attr]
    (note,) = team.agents[0].handle(MissionGiven(mission=square, order=order))
    assert note.detail["reason"] == "old_mission"  # type: ignore[union-attr]
    team.fly(8)
    assert {agent.mission.center for agent in team.agents} == {(52.0, 50.0)}
    assert team.settled()


def test_signatures_of_one_kind_are_not_those_of_another() -> None:
    team = SignedTeam(MISSION, line_up(5))
    team.fly(1)
    kinds = [
        word_statement(team.context, 1, 1, -1),
        beat_statement(1, 1),
        mission_statement(team.context.mission),
        offer_statement(team.context, 1, Offer(to=1, give=1, take=1, give_version=1, take_version=1, bid=1.0), 1),
    ]
    assert len(set(kinds)) == len(kinds)
