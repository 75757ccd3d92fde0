"""A signed envelope around everything that is sent: who says it, to whom of the topics, and that it is new.

One byte for the version, a MessagePack array (sender, session, sequence, payload), and the sender's Ed25519 signature
on the team's name, the topic and all of that. A session is one start of a process; within it every envelope has a
number. A receiver takes each number once, in any order within a window, and nothing from a session before the newest.
"""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Protocol

import msgspec

from llm_flock.errors import MessageError

ENVELOPE_VERSION = 1
SIGNATURE_BYTES = 64
WINDOW = 1024
"""So many numbers behind the newest are still taken, if they were not taken before."""

OVERHEAD = 128
"""No envelope is larger than its payload by more than this [bytes]."""

Number = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]


class Signer(Protocol):
    """Holds keys: signs as itself, and checks what others signed."""

    @property
    def member(self) -> int:
        """Own id."""
        ...

    def sign(self, statement: bytes) -> bytes:
        """The own signature on a statement."""
        ...

    def check(self, member: int, statement: bytes, signature: bytes) -> bool:
        """Whether a member signed this statement."""
        ...


class _Letter(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    sender: Annotated[int, msgspec.Meta(ge=-128, lt=2**16)]
    session: Number
    sequence: Number
    payload: bytes


_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(_Letter)


class _Heard:
    """Which numbers of one sender were taken."""

    def __init__(self) -> None:
        self.session = -1
        self.newest = -1
        self.taken = 0  # bit k: newest - k was taken

    def objection(self, letter: _Letter) -> str | None:
        """Why this letter is no news, or None."""
        if letter.session != self.session:
            return "old_session" if letter.session < self.session else None
        behind = self.newest - letter.sequence
        if behind >= WINDOW:
            return "too_old"
        return "replayed" if behind >= 0 and self.taken >> behind & 1 else None

    def take(self, letter: _Letter) -> None:
        """Remember a letter that is good."""
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
    """Seals what one process sends, opens what it receives, and counts what it refuses.

    Args:
        keys: own secret key and everybody's public ones.
        session: number of this start of the process, higher than that of every start before.
        max_payload: largest payload that is opened [bytes].
    """

    def __init__(self, keys: Signer, session: int, *, max_payload: int) -> None:
        self.refused: Counter[str] = Counter()
        self._keys = keys
        self._session = session
        self._max_payload = max_payload
        self._sequence = 0
        self._heard: dict[int, _Heard] = {}

    def seal(self, payload: bytes, topic: str = "") -> bytes:
        """The payload in an envelope that can be opened once by each receiver of that topic."""
        letter = _ENCODER.encode(_Letter(self._keys.member, self._session, self._sequence, payload))
        self._sequence += 1
        body = bytes([ENVELOPE_VERSION]) + letter
        return body + self._keys.sign(_statement(topic, body))

    def open(self, sealed: bytes, topic: str = "") -> tuple[int, bytes]:
        """Who sent it, and the payload.

        Raises:
            MessageError: with reason `oversized`, `version`, `malformed`, `own_id`, `old_session`, `too_old`,
                `replayed` or `bad_signature` (an unknown sender has none that is good).
        """
        try:
            return self._open(sealed, topic)
        except MessageError as error:
            self.refused[error.reason] += 1
            raise

    def _open(self, sealed: bytes, topic: str) -> tuple[int, bytes]:
        if len(sealed) > self._max_payload + OVERHEAD:
            raise MessageError("oversized", f"{len(sealed)} bytes")
        if sealed[:1] != bytes([ENVELOPE_VERSION]):
            raise MessageError("version", f"envelopes of version {ENVELOPE_VERSION} are opened here")
        body, signature = sealed[:-SIGNATURE_BYTES], sealed[-SIGNATURE_BYTES:]
        try:
            letter = _DECODER.decode(memoryview(body)[1:])
        except msgspec.DecodeError as error:
            raise MessageError("malformed", str(error)) from None
        if letter.sender == self._keys.member:
            raise MessageError("own_id", "an envelope from outside in one's own name")
        # What is cheap comes before the signature, but nothing is remembered before it.
        heard = self._heard.get(letter.sender) or _Heard()
        objection = heard.objection(letter)
        if objection is not None:
            raise MessageError(objection, f"number {letter.sequence} of session {letter.session}")
        if not self._keys.check(letter.sender, _statement(topic, body), signature):
            raise MessageError("bad_signature", f"not signed by {letter.sender}")
        heard.take(letter)
        self._heard[letter.sender] = heard
        return letter.sender, letter.payload


def _statement(topic: str, body: bytes) -> bytes:
    """What is signed: its kind and the topic have their length said, so no two statements run into each other."""
    name = topic.encode()
    return b"envelope\0" + len(name).to_bytes(4) + name + body
