"""A signed envelope around every payload: proves its sender and topic, and that it is new.

One byte for the version, a MessagePack array (sender, session, sequence, payload), and the sender's Ed25519 signature
on the team's name, the topic and all of that. A session is one start of a process. A receiver accepts each number once,
in any order within a window, and nothing from before the newest session.
"""

from __future__ import annotations

from typing import Annotated, Protocol

import msgspec

from llm_flock.errors import MessageError
from llm_flock_swarm._signed.certificates import Authenticator, Verifier

ENVELOPE_VERSION = 2
SIGNATURE_BYTES = 64
WINDOW = 1024  # numbers up to this far behind the newest are still accepted, once
OVERHEAD = 128  # no envelope is larger than its payload by more than this [bytes]

Number = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]


class Signer(Authenticator, Protocol):
    """Signs as a member, and checks the signatures of others."""

    @property
    def member(self) -> int: ...


class _Letter(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    sender: Annotated[int, msgspec.Meta(ge=-128, lt=2**16)]
    session: Number
    sequence: Number
    payload: bytes


_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(_Letter)


class _Heard:
    """Numbers of one sender that were accepted."""

    def __init__(self) -> None:
        self.session = -1
        self.newest = -1
        self.taken = 0  # bit k: newest - k was accepted

    def objection(self, letter: _Letter) -> str | None:
        """Why this letter is not new, or None."""
        if letter.session != self.session:
            return "old_session" if letter.session < self.session else None
        behind = self.newest - letter.sequence
        if behind >= WINDOW:
            return "too_old"
        return "replayed" if behind >= 0 and self.taken >> behind & 1 else None

    def take(self, letter: _Letter) -> None:
        if letter.session != self.session:
            self.session, self.newest, self.taken = letter.session, letter.sequence, 1
            return
        ahead = letter.sequence - self.newest
        if ahead > 0:
            # A jump past the window empties it; shifting by the jump itself would take memory for it.
            self.taken = (self.taken << ahead | 1) & ((1 << WINDOW) - 1) if ahead < WINDOW else 1
            self.newest = letter.sequence
        else:
            self.taken |= 1 << -ahead


class Envelope:
    """Seals payloads of one process, and opens others'; its session's number must be higher than all before."""

    def __init__(self, keys: Signer, session: int, *, max_payload: int) -> None:
        self._keys = keys
        self._session = session
        self._max_payload = max_payload
        self._sequence = 0
        self._heard: dict[int, _Heard] = {}

    def seal(self, payload: bytes, topic: str = "") -> bytes:
        """The payload in an envelope that each receiver of the topic can open once."""
        letter = _ENCODER.encode(_Letter(self._keys.member, self._session, self._sequence, payload))
        self._sequence += 1
        body = bytes([ENVELOPE_VERSION]) + letter
        return body + self._keys.sign(_statement(topic, body))

    def open(self, sealed: bytes, topic: str = "") -> tuple[int, bytes]:
        """The sender, and the payload; a MessageError says why not (`bad_signature` also for an unknown sender)."""
        if len(sealed) > self._max_payload + OVERHEAD:
            raise MessageError("oversized", f"{len(sealed)} bytes")
        letter = _letter(sealed)
        if letter.sender == self._keys.member:
            raise MessageError("own_id", "an envelope from outside in one's own name")
        # Cheap checks come before the signature, but nothing is remembered before it.
        heard = self._heard.get(letter.sender) or _Heard()
        objection = heard.objection(letter)
        if objection is not None:
            raise MessageError(objection, f"number {letter.sequence} of session {letter.session}")
        _check_signature(letter, sealed, topic, self._keys)
        heard.take(letter)
        self._heard[letter.sender] = heard
        return letter.sender, letter.payload


def signed_payload(sealed: bytes, topic: str, verifier: Verifier) -> tuple[int, bytes]:
    """The sender of an envelope, and its payload, new or not: for whoever judges messages afterwards."""
    letter = _letter(sealed)
    _check_signature(letter, sealed, topic, verifier)
    return letter.sender, letter.payload


def _letter(sealed: bytes) -> _Letter:
    if sealed[:1] != bytes([ENVELOPE_VERSION]):
        raise MessageError("version", f"this program opens envelopes of version {ENVELOPE_VERSION}")
    try:
        return _DECODER.decode(memoryview(sealed)[1:-SIGNATURE_BYTES])
    except msgspec.DecodeError as error:
        raise MessageError("malformed", str(error)) from None


def _check_signature(letter: _Letter, sealed: bytes, topic: str, verifier: Verifier) -> None:
    body, signature = sealed[:-SIGNATURE_BYTES], sealed[-SIGNATURE_BYTES:]
    if not verifier.check(letter.sender, _statement(topic, body), signature):
        raise MessageError("bad_signature", f"not signed by {letter.sender}")


def _statement(topic: str, body: bytes) -> bytes:
    """The signed bytes: the length of the topic is included, so no two statements have the same bytes."""
    name = topic.encode()
    return b"envelope\0" + len(name).to_bytes(4) + name + body
