"""Proves by the public keys of a team that the sender of a message lies.

A message of an honest robot has passed its own checks, and carries every signature that they need. So a message that
these checks reject comes from a liar. A robot that changes its mind, or sees wrongly, passes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import msgspec

from llm_flock.errors import MessageError
from llm_flock.message import UNSAID, Message
from llm_flock.mission import Mission
from llm_flock.protocol import Checker, Inbound, TeamMembership
from llm_flock_swarm._signed.certificates import (
    LIARS,
    Authenticator,
    Context,
    Proofs,
    Verifier,
    beat_statement,
    restless_statement,
    word_statement,
)
from llm_flock_swarm._signed.channel import SignedChannel
from llm_flock_swarm._signed.evidence import Evidence

OUTSIDER = -1  # id of a judge that is no robot


def guilt(
    payload: bytes,
    sender: int,
    missions: Sequence[Mission],
    validator: Checker,
    verifier: Verifier,
    liars: int = LIARS,
) -> str | None:
    """Why no honest robot sends this message, as a reason to reject it (docs/reference/wire.md); None if one could.

    `sender` has signed the payload as a whole. Plans are checked for these missions only. A message of another version
    proves nothing, nor do more claims than count: liars can drive an honest robot from place to place.
    """
    # Nothing is ever signed by who only judges.
    mission, authenticator = missions[0], cast("Authenticator", verifier)
    evidence = Evidence(OUTSIDER, authenticator, liars)
    membership = TeamMembership(0, mission)
    channel = SignedChannel(OUTSIDER, mission, authenticator, evidence, membership, replans=validator.any_size)
    try:
        inbound = channel.open(payload, sender)
        _check_order(channel, inbound)
    except MessageError as error:
        return None if error.reason == "version" else error.reason
    channel.hold([inbound.message])
    if evidence.rejected:
        return next(iter(evidence.rejected))
    message, proofs = inbound.message, inbound.message.proofs
    assert isinstance(proofs, Proofs), "a signed channel leaves them there"
    asked = next((m for m in missions if m.digest == message.mission.digest), None)
    if asked is not None and validator.objection(asked, message.plan) is not None:
        return "unverified_plan"
    return _forgery(message, proofs, evidence)


def _check_order(channel: SignedChannel, inbound: Inbound) -> None:
    """Check that the operator gave a mission that is spelled out; the first one has no order."""
    if inbound.message.mission_text is not None and inbound.message.mission.counter > 0:
        channel.check_mission(inbound.message.mission, inbound.authorization)


def _forgery(message: Message, proofs: Proofs, evidence: Evidence) -> str | None:
    """Whether the message states something in the name of a robot that has not signed it."""
    for robot, (count, signature) in enumerate(zip(message.beats or (), proofs.beats or (), strict=False)):
        if signature and not evidence.signed_by(robot, beat_statement(robot, count), signature):
            return "uncertified"
    if message.plan_digest is None:
        return None
    about = Context(message.mission, message.plan_digest, message.provenance)
    evidence.turn_to(about)
    evidence.admit(message, msgspec.structs.replace(proofs, words=(), restless=()), (UNSAID,) * message.places)
    words = all(
        evidence.signed_by(word.witness, word_statement(about, word.slot, word.version, word.owner), word.signature)
        for word in proofs.words
    )
    words = words and all(
        evidence.signed_by(word.witness, restless_statement(about, word.robot), word.signature)
        for word in proofs.restless
    )
    return None if words and not evidence.rejected["uncertified"] else "uncertified"
