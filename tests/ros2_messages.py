"""A message of each type that goes to or comes from ROS 2, and other programs' readers and writers of them."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic

from llm_flock_swarm._ros2 import drawing
from llm_flock_swarm._ros2.drawing import MarkerDrawer, TeamView
from llm_flock_swarm._ros2.types import (
    CLOCK,
    DIAGNOSTICS,
    MARKERS,
    PATH,
    POINTS,
    POSE,
    TEXT,
    TRANSFORMS,
    header,
    message_class,
    time,
    type_store,
)

STAMP_NS = 1_700_000_000_123_456_789
HERE = (1.5, -2.25, 0.0)

TEAM = TeamView(
    positions=[HERE, (4.0, 5.0, 6.0), (7.0, 8.0, 9.0)],
    waypoints=[(2.0, 3.0, 0.0), None, None],
    goals=[(3.0, 3.0, 0.0), (4.0, 4.0, 4.0), None],
    phases=["flying", "dead", "deciding"],
    plan_ids=["a", "b", None],
    places=[(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)],
    links=[(0, 2)],
    safe_m=3.0,
    downwash=2.0,
)


def points(*rows: tuple[float, float, float], frame: str = "world") -> Any:
    poses = [drawing.pose(row, 0, "").pose for row in rows]
    return message_class(POINTS)(header=header(STAMP_NS, frame), poses=poses)


def text(content: str) -> Any:
    return message_class(TEXT)(data=content)


SAMPLES: dict[str, Any] = {
    CLOCK: message_class(CLOCK)(clock=time(STAMP_NS)),
    DIAGNOSTICS: drawing.diagnostics([("robot", 1, "läuft", {"a": 1, "b": "x"})], STAMP_NS, "team"),
    MARKERS: MarkerDrawer("world").draw(TEAM, STAMP_NS),
    PATH: drawing.path(TEAM, 0, STAMP_NS, "world"),
    POINTS: points(HERE, (1.0, 2.0, 3.0)),
    POSE: drawing.pose(HERE, STAMP_NS, "world"),
    TEXT: drawing.text({"a": [1, None, True], "b": "ü"}),
    TRANSFORMS: drawing.transforms([HERE], ["flock/robot_0"], STAMP_NS, "world"),
}


@cache
def definition(name: str) -> str:
    """A type's definition, those of the types in it behind lines of `=`, as bags hold it."""
    return type_store().generate_msgdef(name, ros_version=2)[0]


@cache
def definitions(name: str) -> dict[str, str]:
    """The same, apart, by whole names."""
    first, *rest = re.split(r"={80}\nMSG: ", definition(name))
    found = {name: first}
    for part in rest:
        title, _, body = part.partition("\n")
        package, message = title.split("/")[0], title.split("/")[-1]
        found[f"{package}/msg/{message}"] = body
    return found


def read_elsewhere(data: bytes, name: str) -> Any:
    """The message as the reader of mcap-ros2-support sees it."""
    return generate_dynamic(name, definition(name))[name](data)


def written_elsewhere(message: Any, name: str) -> bytes:
    """The message as its writer writes it."""
    return bytes(serialize_dynamic(name, definition(name))[name](message))


def same(one: Any, other: Any) -> bool:
    """Whether two programs' objects hold the same values."""
    names = [field for field in getattr(one, "__dataclass_fields__", {}) if field.islower() and field[0] != "_"]
    if names:
        return all(same(getattr(one, field), getattr(other, field)) for field in names)
    if isinstance(one, str | bytes | int | float):
        return one == other or (isinstance(one, float) and abs(one - other) < 1e-6)
    return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
