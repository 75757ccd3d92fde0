"""Several robots that lie together: places come free by more witnesses than may lie, whose words are passed on."""

from __future__ import annotations

from copy import deepcopy

import pytest

pytest.importorskip("llm_flock_lab")  # the benchmark draws its trials by it

from benchmarks.lies import fly
from gang import Gang
from lies import LIES, beside_lies, round_of_lies
from signed_team import SignedTeam, evidence_of, line_up
from tables import told
from toy_keys import ToyKeys

from llm_flock.message import NO_OWNER, UNSAID, Message
from llm_flock.mission import Mission
from llm_flock.protocol._agreement.auction import LAST_EXCHANGED
from llm_flock_swarm._signed.certificates import (
    LIARS,
    Certificate,
    Proofs,
    ReleaseGrant,
    claims_of,
    most_exchanges,
    word_statement,
)
from llm_flock_swarm._signed.words import MAX_PASSED_ON, in_turn

pytestmark = pytest.mark.slow

N, TWO = 7, 2
MISSION = Mission(shape="circle", n_robots=N, comm_range=40)
HUNTS = {
    "hunts one robot": 24,
    "takes the places of one robot": 40,
    "raises versions": 12,
    "moves on before others know": 30,
    "frames one robot": 20,
    "raises old claims": 12,
    "much to check": 12,
}
"""Lies that keep a robot from a place for a while, and rounds in which it has one at the latest."""
WORST = ("frees every place all the time", "frees every place and takes one", "blocks every place")


def flown(lie: str, tolerated: int, rounds: int = 15) -> SignedTeam:
    """Five honest robots and two that lie together; their bodies fly to a corner."""
    return beside_lies(lie, MISSION, line_up(N), liars=TWO, tolerated=tolerated, rounds=rounds)


@pytest.mark.no_cover
@pytest.mark.parametrize("lie", WORST)
def test_two_that_lie_together_change_nothing_where_two_may(lie: str) -> None:
    team = flown(lie, TWO)
    slots = [slot for slot in team.slots if slot is not None]
    assert len(set(slots)) == 5 and len({agent.plan for agent in team.agents}) == 1
    assert team.smallest >= MISSION.safe_distance - 1e-6
    assert team.counts("uncertified") > 0


@pytest.mark.no_cover
@pytest.mark.parametrize(("lie", "rounds"), HUNTS.items())
def test_every_robot_gets_a_place_in_the_end(lie: str, rounds: int) -> None:
    """However often it is driven away: bids are drawn by lot, and exchanges end long before claims do."""
    team = flown(lie, TWO, rounds)
    assert team.settled()
    assert team.smallest >= MISSION.safe_distance - 1e-6
    assert all(evidence_of(agent).excluded <= {5, 6} for agent in team.agents)
    assert all(version < LAST_EXCHANGED + 2**20 for version, _ in team.owners(0))


@pytest.mark.no_cover
def test_robot_that_is_told_first_has_no_right_to_a_place() -> None:
    """Three of ten that claim each freed place before others know of it left one to three without a place."""
    found = fly("moves on before others know", 10, 3, seed=2)
    assert found.formed is not None and found.separation >= MISSION.safe_distance - 1e-6


@pytest.mark.parametrize("tolerated", [1, TWO])
def test_exchanges_count_only_where_one_partner_is_surely_honest(tolerated: int) -> None:
    team = SignedTeam(MISSION, line_up(N), liars=TWO, tolerated=tolerated)
    gang = Gang({j: ToyKeys(j) for j in (5, 6)}, MISSION)
    team.begin()
    for _ in range(3):
        for payload in team.comm_round():
            gang.hear(payload)
    team.comm_round(said_by=[gang.message(5, gang.exchange(5, 6, 0, 1))])
    counts = tolerated == 1
    assert (team.owners(0)[:2] == ((1, 6), (1, 5))) is counts
    assert all(evidence_of(agent).rejected["uncertified"] == (not counts) for agent in team.agents)
    team.end()


@pytest.mark.no_cover
@pytest.mark.parametrize("tolerated", [1, TWO])
def test_robots_offer_exchanges_only_where_these_count(tolerated: int) -> None:
    team = SignedTeam(MISSION, line_up(N), liars=0, tolerated=tolerated)
    offered = False
    for _ in range(12):
        team.fly(1)
        offered |= any(agent.claim.offer is not None for agent in team.agents)
        offered |= any(version > 0 for version, _ in team.owners(0))
    assert offered is (tolerated == 1)


@pytest.mark.no_cover
def test_two_cannot_raise_a_version_above_every_number() -> None:
    """Not even where only one was reckoned with."""
    team = SignedTeam(MISSION, line_up(N), liars=TWO, tolerated=1)
    gang = Gang({j: ToyKeys(j) for j in (5, 6)}, MISSION)
    team.begin()
    for _ in range(3):
        for payload in team.comm_round():
            gang.hear(payload)
    highest = LAST_EXCHANGED - 1
    most = most_exchanges(N)
    for at, numbers in (((highest + 1, 0), (1, 2)), ((0, highest + 1), (1, 2)), ((0, 0), (most, most + 1))):
        team.comm_round(said_by=[gang.message(5, gang.exchange(5, 6, 0, 1, at, numbers))])
        assert all(version <= 1 and owner not in (5, 6) for version, owner in team.owners(0)[:2])
    team.comm_round(said_by=[gang.message(5, gang.exchange(5, 6, 0, 1, (highest, highest), (most - 1, most)))])
    assert team.owners(0)[:2] == ((highest + 1, 6), (highest + 1, 5))
    team.end()
    team.fly(30)  # both are silent, and their places are freed at still higher versions
    assert team.settled() and max(version for version, _ in team.owners(0)) > highest + 1


@pytest.mark.no_cover
def test_two_liars_stop_a_team_that_reckons_with_one() -> None:
    """What the number of witnesses is for: the same lie, and a team that was not told."""
    assert flown("blocks every place", LIARS).slots == [None] * 5


@pytest.mark.no_cover
def test_gang_can_tell_every_lie_of_the_library() -> None:
    told = dict.fromkeys(LIES, 0)
    flown = SignedTeam(MISSION, line_up(N), liars=TWO, tolerated=TWO)
    flown.fly(3)
    for lie in LIES:
        team = deepcopy(flown)
        gang = Gang({j: ToyKeys(j) for j in (5, 6)}, MISSION)
        assert round_of_lies(gang, lie) == [], "nothing is known yet"
        team.begin()
        for _ in range(5):
            said = round_of_lies(gang, lie)
            told[lie] += len(said)
            for payload in team.comm_round(said_by=said):
                gang.hear(payload)
    assert [lie for lie, count in told.items() if not count] == ["silence"]


def release(team: SignedTeam, slot: int, robots: tuple[int, ...]) -> Certificate:
    version = team.owners(0)[slot][0] + 1
    statement = word_statement(team.context, slot, version, NO_OWNER)
    return Certificate(number=0, grant=ReleaseGrant(tuple((j, ToyKeys(j).sign(statement)) for j in robots)))


@pytest.mark.no_cover
def test_a_release_needs_one_witness_more_than_may_lie() -> None:
    team = SignedTeam(MISSION, line_up(N), liars=TWO, tolerated=TWO)
    team.fly(12)
    evidence = evidence_of(team.agents[0])
    slot = team.slots[1]
    assert slot is not None
    table = team.agents[0].claim.table or ()
    entry = (table[slot][0] + 1, 0.0, NO_OWNER)

    def admits(robots: tuple[int, ...]) -> bool:
        claims, grants = claims_of({slot: release(team, slot, robots)})
        said = tuple(entry if a == slot else UNSAID for a in range(N))
        message = Message(sender=5, sequence=0, degree=0, plan=team.agents[0].plan, **told(said))
        admitted = evidence.admit(message, Proofs(claims=claims, grants=grants), table).table
        return admitted is not None and admitted[slot] == entry

    for robots in ((5, 6), (5, 5, 6), (2, 5, 6, 6), (1, 2, 5, 6)):
        assert not admits(robots), robots
    assert admits((2, 5, 6))


@pytest.mark.no_cover
def test_robots_that_were_taken_for_dead_stay_where_they_are() -> None:
    """Two liars and one honest robot that has not heard of the others for too long are enough witnesses."""
    team = SignedTeam(MISSION, line_up(N), liars=TWO, tolerated=TWO)
    gang = Gang({j: ToyKeys(j) for j in (5, 6)}, MISSION)
    team.fly(12)
    team.begin()
    for payload in team.comm_round():
        gang.hear(payload)
    before = team.slots
    table = team.agents[0].claim.table or ()
    places = [slot for slot in before if slot is not None]
    freed = {slot: ((table[slot][0] + 1, 0.0, NO_OWNER), release(team, slot, (2, 5, 6))) for slot in places}
    team.comm_round(said_by=[gang.message(5, freed)])
    team.fly(1)
    assert team.slots == before and team.settled()
    assert all(team.owners(0)[slot] == (table[slot][0] + 1, robot) for robot, slot in enumerate(places))


def test_words_passed_on_tell_a_far_robot_that_a_place_is_free() -> None:
    """In a row, the neighbours of a dead robot are too few; with passed-on words all others agree that it is gone."""
    row = Mission(shape="line", n_robots=N, comm_range=15)
    team = SignedTeam(row, [(20.0 + 10.0 * k, 50.0) for k in range(N)], liars=TWO, tolerated=TWO)
    team.fly(40)
    freed = {team.owners(robot) for robot in range(5)}
    assert len(freed) == 1
    assert all(owner not in (5, 6) for _, owner in team.owners(0))
    words = [word for agent in team.agents for word in in_turn(evidence_of(agent)._page.words.of_others(), 0)]
    assert len(words) <= MAX_PASSED_ON * len(team.agents)


def test_many_words_take_turns() -> None:
    team = SignedTeam(MISSION, line_up(N), liars=TWO, tolerated=TWO)
    team.fly(3)
    evidence = evidence_of(team.agents[0])
    words = evidence._page.words
    words._said = {(slot, 9, NO_OWNER): {j: bytes([slot, j]) for j in range(20)} for slot in range(N)}
    told = [{(word.slot, word.witness) for word in in_turn(words.of_others(), turn)} for turn in range(8)]
    assert all(len(one) == MAX_PASSED_ON for one in told)
    assert len(set[tuple[int, int]]().union(*told)) > 100
