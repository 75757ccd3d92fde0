"""Who leaves place after place without cause, how that is told from being outbid, and what becomes of it."""

from __future__ import annotations

import msgspec
import pytest
from gang import Gang
from lies import round_of_lies
from signed_team import SignedTeam, evidence_of, line_up
from toy_keys import ToyKeys

from llm_flock.mission import Mission
from llm_flock.protocol.membership.occupancy import Occupancy
from llm_flock.protocol.messages.message import BLOCKED, NO_OWNER, UNSAID, BidEntry, BidTable
from llm_flock.protocol.signed.certificates import (
    Certificate,
    Context,
    ExchangeGrant,
    ReleaseGrant,
    RestlessWord,
    most_exchanges,
    restless_statement,
    unwrap,
    wrap,
)
from llm_flock.protocol.signed.departures import MOST_DEPARTURES, Departures
from llm_flock.protocol.signed.evidence import Evidence

N, TWO, PLACES = 7, 2, 4
MISSION = Mission(shape="circle", n_robots=N, comm_range=40)
RELEASED = ReleaseGrant(((0, b""), (1, b"")))
EXCHANGED = ExchangeGrant(0, 1, 0, 1, 0, 0, -1.0, 1, b"", -1.0, 1, b"")


class Looks:
    """Tables of one robot, round by round."""

    def __init__(self, *, exchanges: bool = False) -> None:
        self.departures = Departures(TWO + 1, exchanges=exchanges)

    def see(self, claims: dict[int, tuple[int, int, int]], grant: ReleaseGrant | ExchangeGrant | None = RELEASED):
        """A round in which places have these versions, owners and numbers of claims; returns who leaves too often."""
        entries: list[BidEntry] = [UNSAID] * PLACES
        held: dict[tuple[int, BidEntry], Certificate] = {}
        for slot, (version, owner, number) in claims.items():
            entries[slot] = (version, -1.0, owner)
            held[slot, entries[slot]] = Certificate(number=number, grant=grant)
        return [*self.departures.look(tuple(entries), held)]

    def leave(self, times: int, *, owner: int = 3, first: int = 1) -> list[int]:
        """This owner goes to and fro."""
        last = first + times
        found = [self.see({number % 2: (number, owner, number)}) for number in (*range(first, last + 1), last)]
        return found[-1]


def test_who_leaves_too_often_is_named_and_nobody_before() -> None:
    looks = Looks()
    assert looks.leave(MOST_DEPARTURES) == []
    assert looks.leave(1, first=MOST_DEPARTURES + 1) == [3]


def test_where_exchanges_count_as_many_more_may_come_to_nothing() -> None:
    looks, most = Looks(exchanges=True), MOST_DEPARTURES + most_exchanges(PLACES)
    assert looks.leave(most) == []
    assert looks.leave(1, first=most + 1) == [3]


@pytest.mark.parametrize("now", [(1, 5), (2, BLOCKED)])
@pytest.mark.parametrize("late", [False, True])
def test_who_is_outbid_or_finds_its_place_blocked_leaves_with_cause(now: tuple[int, int], late: bool) -> None:
    """The news of it may come a round after the robot is seen elsewhere."""
    looks = Looks()
    for turn in range(3 * MOST_DEPARTURES):
        here, there = turn % 2, 1 - turn % 2
        version = turn + 1
        looks.see({here: (version, 3, turn + 1)})
        moved = {there: (version + 1, 3, turn + 2)}
        cause = (version + now[0] - 1, now[1] if now[1] == BLOCKED else now[1] + turn, 1)
        assert looks.see(moved if late else {**moved, here: cause}) == []
        assert looks.see({**moved, here: cause}) == []


def test_a_claim_that_outbid_it_and_does_not_count_any_more_is_a_cause() -> None:
    looks = Looks()
    for turn in range(3 * MOST_DEPARTURES):
        here, version = turn % 2, turn + 1
        looks.see({here: (version, 3, turn + 1)})
        looks.departures.outbid(here, (version, -1.0, 3), (version, -0.5, 5))
        assert looks.see({1 - here: (version + 1, 3, turn + 2)}) == []
    found: list[int] = []
    for turn in range(3 * MOST_DEPARTURES, 5 * MOST_DEPARTURES):  # one of another version is none
        here, version = turn % 2, turn + 1
        looks.departures.outbid(here, (version, -1.0, 3), (version + 1, -0.5, 5))
        found = looks.see({1 - here: (version + 1, 3, turn + 2)})
    assert found == [3]


def test_exchanges_new_numbers_and_older_claims_are_no_departures() -> None:
    looks = Looks()
    for turn in range(3 * MOST_DEPARTURES):
        number = 2 * turn + 2
        looks.see({turn % 2: (turn + 1, 3, number)}, EXCHANGED)
        assert looks.see({turn % 2: (turn + 2, 3, number + 1)}) == []
        assert looks.see({3: (0, 3, number - 1)}) == []
        assert looks.see({2: (turn, 3, number), turn % 2: (turn + 2, 3, number + 1)}) == []
        assert looks.see({}) == []


def test_words_of_enough_exclude_and_no_more_are_kept() -> None:
    departures = Departures(TWO + 1, exchanges=False)
    for witness in range(5):
        assert departures.excluded == (frozenset() if witness < 3 else {6})
        if not departures.knows(6, witness):
            departures.keep(6, witness, bytes([witness]))
    assert departures.knows(6, 0) and not departures.knows(5, 0)
    assert departures.words() == [RestlessWord(6, witness, bytes([witness])) for witness in range(3)]


def settled_team(liars: int = TWO) -> tuple[SignedTeam, Gang]:
    team = SignedTeam(MISSION, line_up(N), liars=liars, tolerated=TWO)
    gang = Gang({j: ToyKeys(j) for j in range(N - liars, N)}, MISSION)
    team.fly(4)
    team.begin()
    for payload in team.comm_round():
        gang.hear(payload)
    return team, gang


def words_about(team: SignedTeam, robot: int, witnesses: range) -> tuple[RestlessWord, ...]:
    statement = restless_statement(team.context, robot)
    return tuple(RestlessWord(robot, j, ToyKeys(j).sign(statement)) for j in witnesses)


def told(team: SignedTeam, gang: Gang, words: tuple[RestlessWord, ...], entries=None) -> None:
    """A liar passes these words on."""
    sender, payload, _ = gang.message(5, entries)
    content, proofs = unwrap(payload, N)
    team.comm_round(said_by=[(sender, wrap(content, msgspec.structs.replace(proofs, restless=words)), None)])


def tables(team: SignedTeam) -> list[BidTable]:
    return [agent.claim.table or () for agent in team.agents]


def test_the_places_of_who_is_excluded_are_free_at_once_and_its_claims_count_for_nothing() -> None:
    team, gang = settled_team()
    free = next(slot for slot in gang.places if slot not in team.slots)
    team.comm_round(said_by=[gang.message(6, {free: gang.claim(6, free)}, slot=free)])
    assert all(table[free][2] == 6 for table in tables(team))
    told(team, gang, words_about(team, 6, range(TWO)))
    assert all(table[free][2] == 6 for table in tables(team)), "as many words as there may be liars exclude nobody"
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


def test_a_version_of_which_no_words_are_held_is_freed_by_witnesses() -> None:
    team, gang = settled_team()
    evidence = evidence_of(team.agents[0])
    free = [slot for slot in gang.places if slot not in team.slots]
    table = list(tables(team)[0])
    table[free[0]], table[free[1]] = (1, -1.0, 6), (2, -1.0, 6)
    evidence._freed[free[1], 2, NO_OWNER] = RELEASED
    told(team, gang, words_about(team, 6, range(TWO + 1)))
    kept = evidence.without_excluded(tuple(table))
    assert (kept[free[0]], kept[free[1]]) == ((1, -1.0, 6), (2, 0.0, NO_OWNER))
    entry = kept[free[0]]
    evidence._held[free[0], entry] = Certificate(number=1)
    evidence._last[6] = (1, free[0])
    evidence.witness(kept, Occupancy())
    assert (free[0], 2, NO_OWNER) in evidence._words


def test_an_honest_robot_that_is_excluded_claims_nothing() -> None:
    team, gang = settled_team()
    told(team, gang, words_about(team, 0, range(1, 4)))
    team.comm_round()
    assert team.slots[0] is None and all(entry[2] != 0 for table in tables(team) for entry in table)
    assert None not in team.slots[1:]


def test_a_word_that_nobody_signed_ends_the_message() -> None:
    team, gang = settled_team()
    forged = tuple(RestlessWord(0, word.witness, word.signature) for word in words_about(team, 6, range(TWO + 1)))
    told(team, gang, forged)
    assert not any(evidence_of(agent).excluded for agent in team.agents)
    assert team.counts("uncertified") == len(team.agents)


def test_who_moves_on_again_and_again_is_excluded_by_all() -> None:
    team = SignedTeam(MISSION, line_up(N), liars=TWO, tolerated=TWO)
    gang = Gang({j: ToyKeys(j) for j in (5, 6)}, MISSION)
    said: list[bytes] = []
    for _ in range(30):
        team.begin()
        for _ in range(5):
            for payload in said:
                gang.hear(payload)
            said = team.comm_round(said_by=round_of_lies(gang, "moves on before others know"))
        team.end(moves={j: (5.0 * j, 2.0) for j in gang.members})
    assert all(evidence_of(agent).excluded == {5} for agent in team.agents) and team.settled()


def test_evidence_of_another_plan_excludes_nobody() -> None:
    team, gang = settled_team()
    told(team, gang, words_about(team, 6, range(TWO + 1)))
    evidence: Evidence = evidence_of(team.agents[0])
    assert evidence.excluded == {6}
    evidence.turn_to(Context(team.context.mission, "another"))
    assert evidence.excluded == frozenset()
