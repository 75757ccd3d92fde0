"""ROS 2's message types by rosbags, and messages as CDR. Hashes are equal in jazzy, kilted and lyrical, as tested."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from llm_flock.errors import MessageError
from llm_flock.extras import require

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

CLOCK = "rosgraph_msgs/msg/Clock"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
MARKERS = "visualization_msgs/msg/MarkerArray"
PATH = "nav_msgs/msg/Path"
POINTS = "geometry_msgs/msg/PoseArray"
POSE = "geometry_msgs/msg/PoseStamped"
TEXT = "std_msgs/msg/String"
TRANSFORMS = "tf2_msgs/msg/TFMessage"

USED = (CLOCK, DIAGNOSTICS, MARKERS, PATH, POINTS, POSE, TEXT, TRANSFORMS)  # every type sent, received or in bags
MAX_BYTES = 1 << 20  # largest message that is read [bytes]

NS = 1_000_000_000
MAX_STAMP_NS = (
    2**31 * NS - 1
)  # latest time that a stamp can hold [ns]: its seconds have 32 bits, one of them for the sign


@cache
def type_store() -> Typestore:
    """The types of ROS 2; an InputError if rosbags is not installed."""
    require("ros2", "ROS 2")
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_LYRICAL)


def prepare() -> None:
    """Generate the code of all types now: otherwise the first message of each waits for it."""
    for name in USED:
        type_store().get_msgdef(name)


@cache
def type_hash(name: str) -> str:
    """The hash of a type, RIHS01 and 64 hexadecimal digits."""
    return type_store().hash_rihs01(name)


@cache
def message_class(name: str) -> Any:
    """The class of a type's messages; all fields are keywords."""
    return type_store().types[name]


def to_cdr(message: object, name: str) -> bytes:
    """A message as CDR, little-endian, with its header."""
    return bytes(type_store().serialize_cdr(message, name, little_endian=True))


def from_cdr(data: bytes, name: str) -> Any:
    """The message that these bytes are, at most `MAX_BYTES`; a MessageError `bad_cdr`."""
    from rosbags.serde import SerdeError

    try:
        return type_store().deserialize_cdr(data, name)
    except (SerdeError, AssertionError, IndexError, MemoryError, OverflowError, TypeError) as error:
        raise MessageError("bad_cdr", f"{name}: {error or type(error).__name__}") from None


def time(stamp_ns: int) -> Any:
    """A builtin_interfaces/Time."""
    seconds, nanoseconds = divmod(max(0, stamp_ns), NS)
    return message_class("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds)


def header(stamp_ns: int, frame: str) -> Any:
    """A std_msgs/Header."""
    return message_class("std_msgs/msg/Header")(stamp=time(stamp_ns), frame_id=frame)
