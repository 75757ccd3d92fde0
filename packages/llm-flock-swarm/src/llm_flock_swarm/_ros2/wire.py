"""The wire format of rmw_zenoh besides CDR, since April 2025 (jazzy 0.2.4, kilted, lyrical). See its design.md."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass

from llm_flock.errors import MessageError

DEPTH = 10  # History depth of all topics. Everything else of the QoS is the default: reliable, volatile, keep last.

QOS = f"::,{DEPTH}:,:,:,,"
"""That QoS as tokens write it: reliability, durability, history, deadline, lifespan, liveliness. Empty is default."""

NODE, PUBLISHER, SUBSCRIBER = "NN", "MP", "MS"  # kinds of entities in tokens

NO_ENCLAVE = "%"
_ADMIN = "@ros2_lv"
_HEAD = struct.Struct("<qqB")
GID_BYTES = 16


def mangle(name: str) -> str:
    """A name as one chunk of a key."""
    return name.replace("/", "%")


def dds_type(name: str) -> str:
    """The DDS name of a message type: `std_msgs::msg::dds_::String_` for `std_msgs/msg/String`."""
    package, kind, message = name.split("/")
    return f"{package}::{kind}::dds_::{message}_"


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """The key under which a topic's messages are sent; `topic` is the whole name, such as `/flock/mission`."""
    return f"{domain}/{topic.removeprefix('/')}/{dds_type(type_name)}/{type_hash}"


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeName:
    """A node of one session; `number` is unique among the session's nodes, publishers and subscribers."""

    domain: int
    session: str  # zenoh's id, hexadecimal
    number: int
    namespace: str  # begins with a slash
    name: str

    @property
    def token(self) -> str:
        """The liveliness token by which the node is in ROS 2's graph."""
        return self._chunks(self.number, NODE)

    def endpoint_token(self, number: int, kind: str, topic: str, type_name: str, type_hash: str) -> str:
        """The token of one of its publishers or subscribers."""
        chunks = self._chunks(number, kind), mangle(topic), dds_type(type_name), type_hash, QOS
        return "/".join(chunks)

    def _chunks(self, number: int, kind: str) -> str:
        place = mangle(self.namespace)
        return f"{_ADMIN}/{self.domain}/{self.session}/{self.number}/{number}/{kind}/{NO_ENCLAVE}/{place}/{self.name}"


def tokens_of(domain: int, namespace: str, name: str) -> str:
    """Key expression of the liveliness tokens of all nodes of this name, in any session."""
    return f"{_ADMIN}/{domain}/*/*/*/{NODE}/*/{mangle(namespace)}/{name}"


def gid_of(token: str) -> bytes:
    """An id of an endpoint: 16 bytes that its token determines. Readers only compare it."""
    return hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()


@dataclass(frozen=True, slots=True)
class Attachment:
    """The attachment of every message: its number from 1, its time, and its publisher."""

    sequence: int
    stamp_ns: int  # by the sender's wall clock
    gid: bytes

    def encode(self) -> bytes:
        """33 bytes, little-endian, the gid behind its length."""
        return _HEAD.pack(self.sequence, self.stamp_ns, len(self.gid)) + self.gid

    @classmethod
    def decode(cls, data: bytes) -> Attachment:
        """The attachment in these bytes; a MessageError `attachment` if they are none, or of an older rmw_zenoh."""
        if len(data) != _HEAD.size + GID_BYTES or data[_HEAD.size - 1] != GID_BYTES:
            raise MessageError("attachment", f"{len(data)} bytes: not in the format of rmw_zenoh since April 2025")
        sequence, stamp_ns, _ = _HEAD.unpack_from(data)
        return cls(sequence, stamp_ns, data[_HEAD.size :])
