"""A signed envelope around every payload: proves its sender and topic, and that it is new.

One byte for the version, a MessagePack array (sender, session, sequence, payload), and the sender's Ed25519 signature
on the team's name, the topic and all of that. A session is one start of a process. A receiver accepts each number once,
in any order within a window, and nothing from before the newest session.
"""

from __future__ import annotations

from typing import Annotated, Protocol

import msgspec

from llm_flock.errors import MessageError
from llm_flock.members import OPERATOR
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


class _Content(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    sender: Annotated[int, msgspec.Meta(ge=-128, lt=2**16)]
    session: Number
    sequence: Number
    payload: bytes


_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(_Content)


class _ReplayWindow:
    """The replay window of one sender: which sequence numbers were accepted."""

    def __init__(self) -> None:
        self.session = -1
        self.newest = -1
        self.accepted = 0  # bit k: newest - k was accepted

    def rejection_reason(self, content: _Content) -> str | None:
        """Why this content is not new, or None."""
        if content.session != self.session:
            return "old_session" if content.session < self.session else None
        behind = self.newest - content.sequence
        if behind >= WINDOW:
            return "too_old"
        return "replayed" if behind >= 0 and self.accepted >> behind & 1 else None

    def take(self, content: _Content) -> None:
        if content.session != self.session:
            self.session, self.newest, self.accepted = content.session, content.sequence, 1
            return
        ahead = content.sequence - self.newest
        if ahead > 0:
            # A jump past the window empties it; shifting by the jump itself would take memory for it.
            self.accepted = (self.accepted << ahead | 1) & ((1 << WINDOW) - 1) if ahead < WINDOW else 1
            self.newest = content.sequence
        else:
            self.accepted |= 1 << -ahead


class Envelope:
    """Seals payloads of one process, and opens others'. `session` must be higher than in every earlier start."""

    def __init__(self, keys: Signer, session: int, *, max_payload: int) -> None:
        self._keys = keys
        self._session = session
        self._max_payload = max_payload
        self._sequence = 0
        self._windows: dict[tuple[int, int], _ReplayWindow] = {}

    def seal(self, payload: bytes, topic: str = "") -> bytes:
        """The payload in an envelope that each receiver of the topic can open once."""
        content = _ENCODER.encode(_Content(self._keys.member, self._session, self._sequence, payload))
        self._sequence += 1
        body = bytes([ENVELOPE_VERSION]) + content
        return body + self._keys.sign(_statement(topic, body))

    def open(self, sealed: bytes, topic: str = "") -> tuple[int, bytes]:
        """The sender and the payload. Raises MessageError with a reason; an unknown sender gives `bad_signature`."""
        if len(sealed) > self._max_payload + OVERHEAD:
            raise MessageError("oversized", f"{len(sealed)} bytes")
        content = _decode(sealed)
        if content.sender == self._keys.member:
            raise MessageError("own_id", "an envelope from outside in one's own name")
        # Cheap checks come before the signature, but nothing is remembered before it.
        # Several programs may speak for the operator at once, each in a session: orders have a time of their own.
        key = content.sender, content.session if content.sender == OPERATOR else 0
        window = self._windows.get(key) or _ReplayWindow()
        reason = window.rejection_reason(content)
        if reason is not None:
            raise MessageError(reason, f"number {content.sequence} of session {content.session}")
        _check_signature(content, sealed, topic, self._keys)
        window.take(content)
        self._windows[key] = window
        return content.sender, content.payload


def signed_payload(sealed: bytes, topic: str, verifier: Verifier) -> tuple[int, bytes]:
    """The sender of an envelope and its payload. Does not check for replays: for judging messages after the fact."""
    content = _decode(sealed)
    _check_signature(content, sealed, topic, verifier)
    return content.sender, content.payload


def _decode(sealed: bytes) -> _Content:
    if sealed[:1] != bytes([ENVELOPE_VERSION]):
        raise MessageError("version", f"this program opens envelopes of version {ENVELOPE_VERSION}")
    try:
        return _DECODER.decode(memoryview(sealed)[1:-SIGNATURE_BYTES])
    except msgspec.DecodeError as error:
        raise MessageError("malformed", str(error)) from None


def _check_signature(content: _Content, sealed: bytes, topic: str, verifier: Verifier) -> None:
    body, signature = sealed[:-SIGNATURE_BYTES], sealed[-SIGNATURE_BYTES:]
    if not verifier.check(content.sender, _statement(topic, body), signature):
        raise MessageError("bad_signature", f"not signed by {content.sender}")


def _statement(topic: str, body: bytes) -> bytes:
    """The signed bytes: the length of the topic is included, so no two statements have the same bytes."""
    name = topic.encode()
    return b"envelope\0" + len(name).to_bytes(4) + name + body
