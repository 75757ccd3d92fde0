"""Envelopes: who has no key, speaks for another or repeats what was said is refused by name."""

from __future__ import annotations

import random
from dataclasses import dataclass

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from toy_keys import ToyKeys

from llm_flock.errors import MessageError
from llm_flock.members import OPERATOR
from llm_flock_swarm._trust.envelope import OVERHEAD, WINDOW, Envelope


def pair(**kwargs: int) -> tuple[Envelope, Envelope]:
    return Envelope(ToyKeys(1), 7, max_payload=1000), Envelope(ToyKeys(2), kwargs.get("session", 7), max_payload=1000)


def refused(reader: Envelope, sealed: bytes, topic: str = "") -> str:
    with pytest.raises(MessageError) as error:
        reader.open(sealed, topic)
    return error.value.reason


def test_sealed_message_is_opened_once() -> None:
    writer, reader = pair()
    sealed = writer.seal(b"hello", "gossip")
    assert len(sealed) <= 5 + OVERHEAD
    assert reader.open(sealed, "gossip") == (1, b"hello")
    assert refused(reader, sealed, "gossip") == "replayed"


def test_a_topic_is_part_of_what_is_signed() -> None:
    writer, reader = pair()
    assert refused(reader, writer.seal(b"hello", "beacon"), "gossip") == "bad_signature"


@given(st.binary(max_size=200), st.data())
def test_no_changed_bit_is_accepted(payload: bytes, data: st.DataObject) -> None:
    writer, reader = pair()
    sealed = bytearray(writer.seal(payload))
    bit = data.draw(st.integers(0, 8 * len(sealed) - 1))
    sealed[bit // 8] ^= 1 << bit % 8
    assert refused(reader, bytes(sealed))
    assert reader.open(Envelope(ToyKeys(1), 7, max_payload=1000).seal(payload)) == (1, payload)


@given(st.binary(max_size=300))
def test_noise_is_refused(noise: bytes) -> None:
    assert refused(pair()[1], noise)
    assert refused(pair()[1], b"\2" + noise)


def test_envelope_in_the_name_of_another_is_rejected() -> None:
    @dataclass(frozen=True)
    class Impostor(ToyKeys):
        def sign(self, statement: bytes) -> bytes:
            return ToyKeys(3).sign(statement)

    _, reader = pair()
    assert refused(reader, Envelope(Impostor(1), 7, max_payload=99).seal(b"x")) == "bad_signature"
    assert refused(reader, Envelope(ToyKeys(2), 7, max_payload=99).seal(b"x")) == "own_id"
    assert refused(reader, Envelope(ToyKeys(1, "another team"), 7, max_payload=99).seal(b"x")) == "bad_signature"


def test_size_is_bounded_before_anything_is_read() -> None:
    writer, reader = pair()
    assert reader.open(writer.seal(b"x" * 1000))[1] == b"x" * 1000
    assert refused(reader, writer.seal(b"x" * 1100)) == "oversized"


def test_reasons_have_names() -> None:
    _, reader = pair()
    assert refused(reader, b"") == "version"
    assert refused(reader, b"\1abc") == "version"
    assert refused(reader, b"\2abc") == "malformed"


def test_a_new_start_is_heard_and_the_old_one_is_not_heard_again() -> None:
    _, reader = pair()
    old, new = Envelope(ToyKeys(1), 7, max_payload=99), Envelope(ToyKeys(1), 8, max_payload=99)
    kept = old.seal(b"kept")
    assert reader.open(old.seal(b"a")) == (1, b"a")
    assert reader.open(new.seal(b"b")) == (1, b"b")
    assert refused(reader, kept) == "old_session"
    assert refused(reader, old.seal(b"c")) == "old_session"


def test_an_operator_is_heard_from_several_programs() -> None:
    _, reader = pair()
    bridge, command = (Envelope(ToyKeys(OPERATOR), session, max_payload=99) for session in (7, 8))
    first = bridge.seal(b"a")
    assert [reader.open(sealed)[1] for sealed in (first, command.seal(b"b"), bridge.seal(b"c"))] == [b"a", b"b", b"c"]
    assert refused(reader, first) == "replayed"


@given(st.integers(0, 2**32))
def test_each_is_taken_once_in_any_order_within_the_window(seed: int) -> None:
    rng = random.Random(seed)
    writer, reader = pair()
    sealed = [writer.seal(bytes([k])) for k in range(60)]
    sent = [item for item in sealed if rng.random() < 0.7]
    arriving = [*sent, *rng.choices(sent, k=20)] if sent else []
    rng.shuffle(arriving)
    opened = []
    reasons: set[str] = set()
    for item in arriving:
        try:
            opened.append(reader.open(item)[1])
        except MessageError as error:
            reasons.add(error.reason)
    assert reasons <= {"replayed"}
    assert sorted(opened) == sorted(bytes([k]) for k in range(60) if sealed[k] in sent)


def test_message_older_than_the_window_is_rejected() -> None:
    writer, reader = pair()
    sealed = [writer.seal(b"x") for _ in range(WINDOW + 2)]
    reader.open(sealed[0])
    reader.open(sealed[-1])
    assert refused(reader, sealed[0]) == "too_old"
    assert refused(reader, sealed[1]) == "too_old"
    assert reader.open(sealed[2]) == (1, b"x")


def test_an_unsigned_number_moves_no_window() -> None:
    writer, reader = pair()
    reader.open(writer.seal(b"x"))
    letter = msgspec.msgpack.encode([1, 2**61, 2**61, b"forged"])
    assert refused(reader, b"\2" + letter + bytes(64)) == "bad_signature"
    assert reader.open(writer.seal(b"y")) == (1, b"y")


def test_the_highest_numbers_cost_no_memory() -> None:
    writer, reader = pair()
    reader.open(writer.seal(b"x"))
    writer._sequence = 2**62 - 1
    assert reader.open(writer.seal(b"y")) == (1, b"y")
