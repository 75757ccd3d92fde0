"""Everything that may come over the radio: accepted exactly, or refused with a stable word."""

import json
import math

import pytest

from llm_flock.errors import MessageError
from llm_flock.protocol.messages import Message, Offer, Pedigree, decode, encode, max_payload_bytes
from llm_flock.protocol.plan import Plan

PLAN = Plan.of([[1.0, 2.0], [3.5, -4.25]])
ORIGIN = Pedigree(mission=0, mission_digest="ab" * 8, epoch=0, neighbors=1, proposer=1, sequence=0)
OFFER = {"to": 0, "give": 0, "take": 1, "give_version": 0, "take_version": 3, "bid": -2.5}
FULL = Message(
    sender=1,
    sequence=3,
    neighbors=1,
    plan=PLAN,
    pedigree=ORIGIN,
    slot=0,
    table=((0, -1.5, 1), (0, 0.0, -1)),
    offer=Offer(to=0, give=0, take=1, give_version=0, take_version=3, bid=-2.5),
)


def spoiled(**changes: object) -> bytes:
    """The full message with some fields replaced, as an enemy would send it."""
    return json.dumps({**json.loads(encode(FULL)), **changes}).encode()


@pytest.mark.parametrize("message", [FULL, Message(sender=0, sequence=0, neighbors=0)])
def test_what_is_said_is_heard(message: Message) -> None:
    assert decode(encode(message), 2, 2) == message


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", "malformed"),
        (b"\xff\x00", "malformed"),
        (b"[1, 2]", "malformed"),
        (b"x" * (max_payload_bytes(2) + 1), "oversized"),
        (spoiled(v=2), "version"),
        (spoiled(v="1"), "version"),
        (spoiled(v=True), "version"),
        (spoiled(v=1.5), "version"),
        (spoiled(table=[[2**40, -1.0, 1], [0, 0.0, -1]]), "malformed"),
        (spoiled(extra=1), "malformed"),
        (spoiled(sender="1"), "malformed"),
        (spoiled(sequence=-1), "malformed"),
        (spoiled(sequence=2**60), "malformed"),
        (spoiled(sender=2), "unknown_id"),
        (spoiled(neighbors=2), "unknown_id"),
        (spoiled(table=[[0, -1.0, 7], [0, 0.0, -1]]), "unknown_id"),
        (spoiled(table=[[0, -1.0, -2], [0, 0.0, -1]]), "unknown_id"),
        (spoiled(pedigree={**json.loads(encode(FULL))["pedigree"], "proposer": 9}), "unknown_id"),
        (spoiled(pedigree={**json.loads(encode(FULL))["pedigree"], "mission_digest": "no"}), "malformed"),
        (spoiled(pedigree=None), "malformed"),
        (spoiled(plan=None, pedigree=None), "malformed"),
        (spoiled(plan=[[1.0, 2.0]]), "wrong_length"),
        (spoiled(plan=[[1.0, 2.0], [1.0, 2.0, 3.0]]), "wrong_length"),
        (spoiled(slot=2), "wrong_length"),
        (spoiled(offer={**OFFER, "give": 2}), "wrong_length"),
        (spoiled(offer={**OFFER, "to": 2}), "unknown_id"),
        (spoiled(offer={**OFFER, "bid": math.inf}), "not_finite"),
        (spoiled(table=[[0, -1.0, 1]]), "wrong_length"),
        (spoiled(plan=[[math.nan, 2.0], [1.0, 2.0]]), "not_finite"),
        (spoiled(plan=[[math.inf, 2.0], [1.0, 2.0]]), "not_finite"),
        (spoiled(plan=[[1e300, 2.0], [1.0, 2.0]]), "malformed"),
        (spoiled(table=[[0, math.nan, 1], [0, 0.0, -1]]), "not_finite"),
    ],
)
def test_unacceptable_messages_are_refused_by_name(payload: bytes, reason: str) -> None:
    with pytest.raises(MessageError) as caught:
        decode(payload, 2, 2)
    assert caught.value.reason == reason


def test_a_full_table_of_a_large_team_fits() -> None:
    n = 1000
    plan = Plan.of([[12345.678901 + k, -98765.432109 - k] for k in range(n)])
    table = tuple((2**39, -123456.123456789, k) for k in range(n))
    message = Message(sender=0, sequence=0, neighbors=n - 1, plan=plan, pedigree=ORIGIN, slot=0, table=table)
    assert decode(encode(message), n, 2) == message


def test_equal_plans_are_equal_after_rounding() -> None:
    assert Plan.of([[0.1 + 0.2, -0.0]]) == Plan.of([[0.3, 0.0]])
    assert Plan.of([[1.0, 2.0]]) != Plan.of([[2.0, 1.0]])
    assert Plan.of([[1.0, 2.0]]) != "plan"
    assert len({Plan.of([[1.0, 2.0]]), Plan.of([[1.0, 2.0]])}) == 1
