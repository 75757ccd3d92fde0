"""Keys, tokens, attachments, hashes and payloads are those that other programs write for rmw_zenoh, byte by byte."""

from __future__ import annotations

import contextlib
import importlib
from typing import Any

import pytest

pytest.importorskip("zenoh_ros2_sdk")

from hypothesis import given
from hypothesis import strategies as st
from ros2_messages import SAMPLES, definitions, read_elsewhere, same, written_elsewhere
from rosbags.typesys import Stores, get_typestore

from llm_flock.errors import MessageError
from llm_flock_swarm._ros2.types import TEXT, USED, from_cdr, to_cdr, type_hash
from llm_flock_swarm._ros2.wire import (
    DEPTH,
    PUBLISHER,
    QOS,
    SUBSCRIBER,
    Attachment,
    NodeName,
    dds_type,
    gid_of,
    topic_key,
)


def oracle(module: str) -> Any:
    """A module of zenoh-ros2-sdk, whose types a type checker does not see."""
    return importlib.import_module(f"zenoh_ros2_sdk.{module}")


TheirAttachment = oracle("attachment").Attachment
entities, keys, utils = oracle("entity"), oracle("keyexpr"), oracle("utils")
QosProfile = oracle("qos").QosProfile

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
SESSION = "8b20917502ee955ac4476e0266340d5c"
NAMES = st.from_regex(r"(/[a-z_][a-z0-9_]{0,8}){1,4}", fullmatch=True)


def test_the_example_of_the_format_s_description() -> None:
    node = NodeName(domain=0, session=SESSION, number=0, namespace="/", name="talker")
    token = node.endpoint_token(10, PUBLISHER, "/chatter", TEXT, STRING_HASH)
    type_name = "std_msgs::msg::dds_::String_"
    assert node.token == f"@ros2_lv/0/{SESSION}/0/0/NN/%/%/talker"
    assert token == f"@ros2_lv/0/{SESSION}/0/10/MP/%/%/talker/%chatter/{type_name}/{STRING_HASH}/::,10:,:,:,,"
    assert topic_key(0, "/chatter", TEXT, STRING_HASH) == f"0/chatter/{type_name}/{STRING_HASH}"
    assert type_hash(TEXT) == STRING_HASH


@given(NAMES, NAMES, st.integers(0, 232), st.sampled_from(USED))
def test_keys_and_tokens_are_the_oracle_s(topic: str, namespace: str, domain: int, name: str) -> None:
    hashed, dds = type_hash(name), utils.ros2_to_dds_type(name)
    assert dds_type(name) == dds
    assert topic_key(domain, topic, name, hashed) == keys.topic_keyexpr(domain, topic, dds, hashed)
    ours = NodeName(domain=domain, session=SESSION, number=3, namespace=namespace, name="robot")
    node = entities.NodeEntity(domain_id=domain, session_id=SESSION, node_id=3, node_name="robot", namespace=namespace)
    assert ours.token == keys.node_liveliness_keyexpr(node)
    for kind in (PUBLISHER, SUBSCRIBER):
        theirs = entities.EndpointEntity(
            node=node,
            entity_id=7,
            kind=entities.EntityKind(kind),
            name=topic,
            dds_type_name=dds,
            type_hash=hashed,
            qos=QosProfile(history_depth=DEPTH).encode(),
        )
        assert ours.endpoint_token(7, kind, topic, name, hashed) == keys.endpoint_liveliness_keyexpr(theirs)


def test_the_qos_is_reliable_and_volatile() -> None:
    assert QosProfile.decode(QOS) == QosProfile(history_depth=DEPTH)


@given(st.integers(1, 2**62), st.integers(0, 2**62), st.text())
def test_attachments_are_the_oracle_s_both_ways(sequence: int, stamp_ns: int, token: str) -> None:
    gid = gid_of(token)
    data = Attachment(sequence, stamp_ns, gid).encode()
    assert data == TheirAttachment(sequence_id=sequence, timestamp_ns=stamp_ns, gid=gid).to_bytes()
    theirs = TheirAttachment.from_bytes(data)
    assert (theirs.sequence_id, theirs.timestamp_ns, theirs.gid) == (sequence, stamp_ns, gid)
    assert Attachment.decode(data) == Attachment(sequence, stamp_ns, gid)


def test_attachments_of_older_texts_are_refused() -> None:
    older = b"\x0fsequence_number" + bytes(8) + b"\x10source_timestamp" + bytes(8) + b"\x0asource_gid\x10" + bytes(16)
    good = Attachment(1, 2, bytes(16)).encode()
    for wrong in (b"", older, good[:-1], good + b"\0", good[:16] + b"\x0f" + good[17:]):
        with pytest.raises(MessageError, match="attachment"):
            Attachment.decode(wrong)


@pytest.mark.parametrize("name", USED)
def test_hashes_agree_elsewhere_and_in_three_distributions(name: str) -> None:
    own, *_ = parts = definitions(name)
    others = {part: text for part, text in parts.items() if part != own}
    assert utils.compute_type_hash_from_msg(name, parts[own], others) == type_hash(name)
    for store in (Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL):
        assert get_typestore(store).hash_rihs01(name) == type_hash(name)


@pytest.mark.parametrize("name", USED)
def test_payloads_are_read_and_written_alike_elsewhere(name: str) -> None:
    message = SAMPLES[name]
    data = to_cdr(message, name)
    assert data[:4] == b"\x00\x01\x00\x00"
    theirs = read_elsewhere(data, name)
    assert same(message, theirs)
    assert written_elsewhere(theirs, name) == data
    assert to_cdr(from_cdr(data, name), name) == data


@given(st.sampled_from(USED), st.data())
def test_mangled_payloads_are_refused_or_read(name: str, data: st.DataObject) -> None:
    sent = bytearray(to_cdr(SAMPLES[name], name))
    for _ in range(data.draw(st.integers(1, 4))):
        sent[data.draw(st.integers(0, len(sent) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(sent)))
    for mangled in (bytes(sent), bytes(sent[:cut]), bytes(sent) + bytes(cut)):
        with contextlib.suppress(MessageError):
            from_cdr(mangled, name)


def test_an_endless_sequence_is_refused_at_once() -> None:
    for wrong in (b"\x00\x01\x00\x00" + b"\xff" * 64, b"\x00\x07\x00\x00" + bytes(8), b""):
        with pytest.raises(MessageError, match="bad_cdr"):
            from_cdr(wrong, TEXT)
