"""Accusations: a robot shows observers each message that no honest robot sends, sealed by its sender.

Robots ignore accusations: lies lose without them, and false sensor readings, which slow a team, have no proof.
"""

from __future__ import annotations

import base64
import hashlib
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Any

from llm_flock.errors import MessageError
from llm_flock.events import Note
from llm_flock.mission import Mission
from llm_flock.protocol import Checker, Validator
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.wire import BeaconedMessage, unpack
from llm_flock_swarm._signed.certificates import Verifier
from llm_flock_swarm._signed.guilt import guilt
from llm_flock_swarm._zenoh import sealed_topic

MAX_PROOF_BYTES = 1 << 18  # largest message that is shown: reports have a limit too
MAX_JUDGED = 64  # messages of one sender that a robot judges for a mission: each takes several signatures
REMEMBERED = 4  # newest messages of each sender between two exchanges that may be judged


def contexts(config: SwarmConfig) -> dict[str, str]:
    """Contexts that seals on protocol messages cover besides the topic: everything on which a verdict depends."""
    network, protocol, mission = config.network, config.protocol, config.mission
    about = (network.swarm, mission.n_robots, mission.dim, network.liars, protocol.gaps, protocol.verify)
    return {"say": hashlib.blake2b(repr(about).encode(), digest_size=8).hexdigest()}


class Judge:
    """Decides by public keys alone whether a sealed message shows that its sender lies."""

    def __init__(self, verifier: Verifier, config: SwarmConfig) -> None:
        protocol = config.protocol
        self._verifier, self._liars = verifier, config.network.liars
        self._contexts = contexts(config)
        any_size = protocol.gaps == "replan"
        self._validator = Checker(any_size=any_size)
        if protocol.verify:
            self._validator = Validator(shield_on=bool(protocol.shield), any_size=any_size)

    def topic(self, robot: int) -> str:
        """The topic that a robot's seals on its messages cover."""
        return sealed_topic(f"say/{robot}", self._contexts)

    def verdict(self, robot: int, sealed: bytes, missions: Sequence[Mission]) -> str | None:
        """The reason why no honest robot seals this message; None if nothing is proven."""
        from llm_flock_swarm._trust.envelope import signed_payload

        try:
            sender, payload = signed_payload(sealed, self.topic(robot), self._verifier)
        except MessageError:
            return None
        if sender != robot:
            return None
        try:
            message = unpack(BeaconedMessage, payload).message
        except MessageError as error:
            return None if error.reason == "version" else error.reason
        return guilt(message, robot, missions, self._validator, self._verifier, self._liars)

    def confirms(self, detail: Mapping[str, Any], missions: Sequence[Mission]) -> tuple[int, str] | None:
        """The robot that an accusation proves to lie, and the reason; None if it proves nothing."""
        robot, proof = detail.get("robot"), detail.get("proof")
        if type(robot) is not int or not isinstance(proof, str) or len(proof) > 2 * MAX_PROOF_BYTES:
            return None
        try:
            sealed = base64.b64decode(proof, validate=True)
        except ValueError:
            return None
        reason = self.verdict(robot, sealed, missions)
        return None if reason is None else (robot, reason)


class Accuser:
    """One robot's: hears what others send, and accuses each liar once, by a note for its next report."""

    def __init__(self, judge: Judge) -> None:
        self.accused: set[int] = set()
        self._judge = judge
        self._heard: dict[int, deque[bytes]] = {}
        self._judged = Counter[tuple[int, str]]()
        self._refused = 0

    def hear(self, sender: int, sealed: bytes) -> None:
        """Keep a message until the next exchange."""
        if sender not in self.accused and len(sealed) <= MAX_PROOF_BYTES:
            self._heard.setdefault(sender, deque(maxlen=REMEMBERED)).append(sealed)

    def accuse(self, refused: int, mission: Mission) -> Note | None:
        """Call at each exchange with the number of refusals so far; judges messages if something was refused since."""
        heard, self._heard = self._heard, {}
        before, self._refused = self._refused, refused
        if refused <= before:
            return None
        for sender, messages in heard.items():
            for sealed in messages:
                if self._judged[sender, mission.digest] >= MAX_JUDGED:
                    break
                self._judged[sender, mission.digest] += 1
                reason = self._judge.verdict(sender, sealed, [mission])
                if reason is not None:
                    self.accused.add(sender)
                    proof = base64.b64encode(sealed).decode("ascii")
                    return Note("accused", {"robot": sender, "reason": reason, "proof": proof})
        return None
