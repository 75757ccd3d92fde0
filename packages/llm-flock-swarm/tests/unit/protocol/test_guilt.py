"""What a message proves about its sender: nothing about the honest, and who sent it about most lies."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
from gang import Gang
from lies import LIES, round_of_lies
from signed_team import SignedTeam, line_up
from toy_keys import ToyKeys

from llm_flock.events import MissionGiven
from llm_flock.message import MissionStamp
from llm_flock.mission import Mission
from llm_flock.protocol._messages.channel import Authorization
from llm_flock.protocol._verification.validator import Validator
from llm_flock_swarm._signed.certificates import OPERATOR, WIRE_SIGNED, mission_statement
from llm_flock_swarm._signed.guilt import guilt

N = 5
MISSION = Mission(shape="circle", n_robots=N, comm_range=40)
LATER = MISSION.change(spacing=6.0)
ORDERED_AT = 10**12
VALIDATOR = Validator(shield_on=True)

SHOWN = {
    "claims every place": {None, "uncertified"},  # the latter without the words that freed it
    "claims at huge versions": {"uncertified"},
    "claims in the name of others": {"uncertified"},
    "frees every place and takes one": {None},  # says what it sees
    "frees every place all the time": {None},
    "blocks every place": {None},
    "exchanges what others own": {"uncertified"},
    "raises versions": {"uncertified"},
    "hunts one robot": {None, "uncertified"},  # the latter without the words that freed a place
    "takes the places of one robot": set[str | None](),  # takes two
    "frames one robot": {None},
    "raises old claims": {None},
    "moves on before others know": {None},  # each claim is as an honest robot would make it
    "much to check": {"uncertified"},
    "offers one place to all": {None, "uncertified"},  # more than an honest robot makes
    "plans of its own": {None, "unverified_plan", "many_plans"},  # faultless, but for the mission before
    "plan after plan": {None, "unverified_plan"},  # two messages together show it
    "plans for ever": {None, "unverified_plan"},
    "another plan to each half": {None, "unverified_plan"},
    "a plan in one place": {"unverified_plan"},
    "another mission": {"no_order"},
    "heartbeats of others": {"uncertified"},
    "speaks for others": {"impostor"},
    "noise": {None, "malformed", "impostor", "forged_origin", "uncertified"},
    "far too large": {"oversized"},
    "equivocates": {None, "uncertified"},
    "asks for ways and stays": {None},
    "asks for ways to and fro": {None},
    "silence": set[str | None](),
}


@dataclass(frozen=True)
class Public:
    """The keys of a team, for somebody who is no member."""

    def check(self, member: int, statement: bytes, signature: bytes) -> bool:
        return ToyKeys(0).check(member, statement, signature)


def found(payload: bytes, sender: int) -> str | None:
    return guilt(payload, sender, [MISSION, LATER], VALIDATOR, Public())


TRACED = ("another mission", "speaks for others", "a plan in one place", "heartbeats of others")
"""Lies whose flights are measured for coverage: a message is found guilty in each of the ways that there are."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "lie", [pytest.param(lie, marks=() if lie in TRACED else pytest.mark.no_cover) for lie in LIES]
)
def test_lies_are_shown_and_nothing_is_shown_about_the_honest(lie: str) -> None:
    """Messages are lost, and the mission changes in flight."""
    team = SignedTeam(MISSION, line_up(N), loss=0.2, seed=1)
    gang = Gang({N - 1: ToyKeys(N - 1)}, MISSION)
    reasons: set[str | None] = set()
    said: list[bytes] = []
    for number in range(9):
        team.begin()
        if number == 4:
            stamp = MissionStamp(ORDERED_AT, LATER.digest)
            signed = Authorization(counter=ORDERED_AT, signature=ToyKeys(OPERATOR).sign(mission_statement(stamp)))
            team.agents[0].handle(MissionGiven(mission=LATER, ordered_at=ORDERED_AT, authorization=signed))
        for _ in range(5):
            for payload in said:
                gang.hear(payload)
            lies = round_of_lies(gang, lie)
            reasons |= {found(payload, sender) for sender, payload, _ in lies}
            said = team.comm_round(said_by=lies)
            for sender, payload in enumerate(said):
                assert found(payload, sender) is None
        team.end()
    assert team.agents[-1].mission == LATER
    assert reasons <= SHOWN[lie] and (reasons != {None} or SHOWN[lie] == {None}), reasons


def test_another_version_proves_nothing() -> None:
    assert found(bytes([WIRE_SIGNED + 1]) + b"anything", 0) is None


def test_a_word_in_the_name_of_another_is_shown() -> None:
    team = SignedTeam(MISSION, line_up(N))
    gang = Gang({N - 1: ToyKeys(N - 1)}, MISSION)
    team.begin()
    for payload in team.comm_round():
        gang.hear(payload)
    word = gang.word(N - 1, 0, -1)
    forged = type(word)(0, word.slot, word.version, word.owner, word.signature)
    assert found(gang.message(N - 1, words=(word,))[1], N - 1) is None
    assert found(gang.message(N - 1, words=(forged,))[1], N - 1) == "uncertified"


@pytest.mark.parametrize("first", [-0.0, 0.0])
def test_zero_bids_of_either_sign_never_incriminate_the_honest(first: float) -> None:
    """One liar claims a place with a bid of 0.0 and one of -0.0, each rightly signed: equal, but not the same bytes."""
    team = SignedTeam(MISSION, line_up(N))
    gang = Gang({N - 1: ToyKeys(N - 1)}, MISSION)
    team.begin()
    for payload in team.comm_round():
        gang.hear(payload)
    slot = 3
    for bid in (first, -first):
        lie = gang.message(N - 1, {slot: gang.claim(N - 1, slot, bid=bid)}, slot=slot)
        shown = found(lie[1], N - 1)
        assert shown == ("uncertified" if math.copysign(1.0, bid) < 0.0 else None)
        for _ in range(3):
            for sender, payload in enumerate(team.comm_round(said_by=[lie])):
                assert found(payload, sender) is None
