"""Votes on what to do after an event: who wins, and how they spread."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from llm_flock.bounds import MAX_ORDERS, max_payload_bytes
from llm_flock.errors import MessageError
from llm_flock.message import MAX_VOTES, Choice, Incident, Message, MissionStamp, Vote, decode, encode
from llm_flock.mission import Mission
from llm_flock.protocol._agreement.votes import Votes
from llm_flock.protocol._messages.dissemination import Dissemination

DEATH = Incident(kind="death", robot=1)
WEAK = Incident(kind="battery", robot=2, left=12.5, at=(3.0, 4.0))

ORDER = Incident(kind="order", robot=1, left=3.0, words="é" * 64)


def vote(voter: int, choice: Choice | None, *, degree: int = 0, incident: Incident = DEATH) -> Vote:
    return Vote(incident=incident, voter=voter, degree=degree, choice=choice)


def test_most_votes_win_and_votes_without_an_answer_do_not_count() -> None:
    votes = Votes()
    votes.take(vote(0, "replan"), vote(2, "leave"), vote(3, "replan"), vote(4, None), vote(5, None), vote(6, None))
    assert votes.choice(DEATH) == "replan" and votes.count(DEATH) == {"replan": 2, "leave": 1}
    assert votes.voters(DEATH) == {0, 2, 3, 4, 5, 6} and votes.voters(WEAK) == frozenset()


def test_ties_go_to_most_neighbours_then_the_highest_id() -> None:
    votes = Votes()
    votes.take(vote(0, "replan", degree=3), vote(5, "leave", degree=2))
    assert votes.choice(DEATH) == "replan"
    votes.take(vote(4, "leave", degree=3), vote(2, "replan", degree=1))
    assert votes.choice(DEATH) == "leave"


def test_only_the_first_vote_of_a_robot_counts() -> None:
    votes = Votes()
    votes.take(vote(0, "replan"), vote(0, "leave"), vote(3, None))
    assert votes.choice(DEATH) == "replan" and len(votes.pass_on() or ()) == 2


def test_without_usable_votes_there_is_no_choice() -> None:
    votes = Votes()
    assert votes.pass_on() is None and votes.choice(WEAK) is None
    votes.take(vote(0, None, incident=WEAK))
    assert votes.choice(WEAK) is None and votes.incidents == {("battery", 2): WEAK}


def test_each_order_is_voted_on_and_made_up_ones_are_bounded() -> None:
    votes = Votes()
    for number in range(MAX_ORDERS + 2):
        order = Incident(kind="order", robot=2, left=number, words="wait")
        votes.take(vote(0, "wait", incident=order), vote(1, "wait", incident=order))
    votes.take(vote(0, "continue", incident=WEAK))
    assert len(votes.incidents) == MAX_ORDERS + 1 and votes.choice(WEAK) == "continue"
    assert [votes.count(one)["wait"] for one in votes.incidents.values() if one.words] == [2] * MAX_ORDERS


choices = st.sampled_from([None, "leave", "close", "replan"])
casts = st.lists(st.tuples(choices, st.integers(0, 3)), min_size=1, max_size=10)


@settings(deadline=None, max_examples=30)
@given(casts, st.randoms())
def test_robots_that_know_the_same_votes_choose_alike(cast: list[tuple[Choice | None, int]], rng: object) -> None:
    given_votes = [vote(j, choice, degree=degree) for j, (choice, degree) in enumerate(cast)]
    shuffled = list(given_votes)
    rng.shuffle(shuffled)  # pyright: ignore[reportAttributeAccessIssue]
    one, other = Votes(), Votes()
    one.take(*given_votes)
    other.take(*shuffled, *shuffled[:3])
    assert one.choice(DEATH) == other.choice(DEATH)


@settings(deadline=None, max_examples=30)
@given(casts, st.integers(0, 2**31))
def test_votes_reach_every_robot_of_a_connected_team(cast: list[tuple[Choice | None, int]], lost: int) -> None:
    """A chain of robots; some messages are lost, and all know all votes in the end."""
    team = [Votes() for _ in cast]
    for j, (choice, degree) in enumerate(cast):
        team[j].take(vote(j, choice, degree=degree))
    for number in range(4 * len(cast)):
        said = [votes.pass_on() for votes in team]
        for j, k in [*itertools.pairwise(range(len(team))), *((k, j) for j, k in itertools.pairwise(range(len(team))))]:
            if (lost + number + j) % 3:
                team[k].take(*said[j] or ())
    assert {votes.voters(DEATH) for votes in team} == {frozenset(range(len(cast)))}
    assert len({votes.choice(DEATH) for votes in team}) == 1


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 30), st.integers(0, 29), st.lists(st.sampled_from(["leave", "close"]), max_size=30))
def test_the_right_choice_wins_over_smaller_groups(right: int, silent: int, wrong: list[Choice]) -> None:
    """Theorem 18: more right votes than wrong ones alike, and the right choice is made."""
    votes = Votes()
    good: list[Choice | None] = ["replan"] * right
    cast = [*good, *[None] * silent, *wrong]
    votes.take(*(vote(j, choice, degree=j % 5) for j, choice in enumerate(cast)))
    if right > max(wrong.count("leave"), wrong.count("close")):
        assert votes.choice(DEATH) == "replan"


def test_of_many_votes_new_ones_go_first_and_all_come_again() -> None:
    votes, n = Votes(), 3 * MAX_VOTES
    votes.take(*(vote(j, "leave") for j in range(n)))
    first = votes.pass_on() or ()
    assert [one.voter for one in first] == list(range(MAX_VOTES))
    sent = [votes.pass_on() or () for _ in range(6)]
    assert {one.voter for message in sent for one in message} == set(range(n))
    assert max(map(len, sent)) == MAX_VOTES


MESSAGE = Message(sender=0, sequence=0, degree=1, stamp=MissionStamp(0, "0" * 16), votes=(vote(2, "close"),))


def test_votes_come_through_the_wire() -> None:
    sent = replace(
        MESSAGE, votes=(vote(2, "close", degree=1), vote(0, None, incident=WEAK), vote(1, "wait", incident=ORDER))
    )
    assert decode(encode(sent), 4, 2).votes == sent.votes
    assert decode(encode(replace(MESSAGE, votes=None)), 4, 2).votes is None


@pytest.mark.parametrize(
    ("votes", "reason"),
    [
        ((vote(4, "close"),), "unknown_id"),
        ((vote(1, "close", degree=4),), "unknown_id"),
        ((vote(1, "close", incident=Incident(kind="death", robot=7)),), "unknown_id"),
        ((vote(1, "swap", incident=replace(WEAK, at=(1.0, 2.0, 3.0))),), "wrong_length"),
        ((vote(1, "swap", incident=replace(WEAK, left=-1.0)),), "malformed"),
        ((vote(1, "wait", incident=replace(ORDER, words="é" * 65)),), "wrong_length"),
        ((vote(1, "wait", incident=replace(ORDER, words="")),), "wrong_length"),
        ((vote(1, "wait", incident=replace(WEAK, words="wait")),), "wrong_length"),
        ((vote(1, "land"),), "malformed"),  # pyright: ignore[reportArgumentType]
        ((vote(1, "close"),) * (MAX_VOTES + 1), "malformed"),
    ],
)
def test_votes_that_cannot_be_are_rejected(votes: tuple[Vote, ...], reason: str) -> None:
    with pytest.raises(MessageError, match=r".") as caught:
        decode(encode(replace(MESSAGE, votes=votes)), 4, 2)
    assert caught.value.reason == reason


def test_a_message_without_room_leaves_the_votes_for_later() -> None:
    mission = Mission(shape="triangle", n_robots=3)
    for robots, sent in ((1, MAX_VOTES), (120, 0)):
        positions = dict.fromkeys(range(robots), (0, (1.5, 2.5), (3.5, 4.5)))
        whole = replace(MESSAGE, votes=(vote(2, "close"),) * MAX_VOTES, positions=positions)
        payload = Dissemination().compose(whole, None, mission)
        assert (len(payload) > max_payload_bytes(3)) is (robots == 120)  # only positions could be left out, too
        assert payload.count(b"close") == sent
