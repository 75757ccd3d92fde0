"""Turns entries of a record into messages of the channels that Foxglove shows: the record's own, and drawings.

Besides the record's channels and `/scene` there are `/arena` (walls and obstacles), `/trails`, `/log` (events as lines
of text), and `/robots/ID/pose` for each robot. Names and fields are those of https://docs.foxglove.dev/docs/sdk/schemas.
Robots have no heading, so poses do not turn.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from pydantic_core import to_json

from llm_flock.errors import RecordError
from llm_flock.printable import one_line
from llm_flock.record import (
    CHANNELS,
    FRAME,
    LINE_LIST,
    LINE_LOOP,
    LINE_STRIP,
    ORIGIN,
    PALETTE,
    SCENE_TOPIC,
    TOPICS,
    Entry,
    FlightEvent,
    MissionInfo,
    PlanInfo,
    ProtocolEvent,
    SceneDrawer,
    State,
    channel_schema,
    entity,
    rgba,
    scene_schema,
    xyz,
)

ARENA, TRAILS, LOG = "/arena", "/trails", "/log"
MAX_TRAIL_ROUNDS = 24
"""Longest trail [rounds]."""

MAX_TRAIL_POINTS = 6000  # most points of all trails in one message: large teams have shorter trails
MAX_LOG_LINE = 300  # longest line of the log [characters]
OBSTACLE_HEIGHT = 1.0  # height of obstacles in a plane, so that they can be seen from the side [units]

_INFO, _WARNING = 2, 3
_WARNINGS = frozenset({"killed", "fallback", "no_plan", "accused", "rejected_message", "injected", "link_lost", "cut"})
_EDGE_COLOR = rgba("#56606B")
_OBSTACLE_COLOR = rgba("#7F7F7F", 0.8)
_BOX_EDGES = (0, 1, 1, 3, 3, 2, 2, 0, 4, 5, 5, 7, 7, 6, 6, 4, 0, 4, 1, 5, 2, 6, 3, 7)
"""Pairs of corners of a box; bit 0 of a corner's number chooses x, bit 1 y, bit 2 z."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelMessage:
    """One message: its channel, the round it belongs to, and its JSON."""

    topic: str
    round: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelKind:
    """The name and the JSON schema of a channel's messages."""

    name: str
    schema: dict[str, Any]


def pose_topic(robot: int) -> str:
    """The channel with a robot's position."""
    return f"/robots/{robot}/pose"


def channel_kinds(n_robots: int) -> dict[str, ChannelKind]:
    """Every channel of a team by its topic."""
    own = {topic: channel_schema(model) for topic, model in CHANNELS.items()}
    kinds = {topic: ChannelKind(name=f"llm_flock.{schema['title']}", schema=schema) for topic, schema in own.items()}
    for topic in (SCENE_TOPIC, ARENA, TRAILS):
        kinds[topic] = ChannelKind(name="foxglove.SceneUpdate", schema=scene_schema())
    kinds[LOG] = ChannelKind(name="foxglove.Log", schema=_log_schema())
    pose = ChannelKind(name="foxglove.PoseInFrame", schema=_pose_schema())
    return kinds | {pose_topic(robot): pose for robot in range(n_robots)}


class ChannelWriter:
    """Draws a run for Foxglove, entry by entry."""

    def __init__(self) -> None:
        self._scene: SceneDrawer | None = None
        self._trails: list[deque[dict[str, float]]] = []
        self._round = 0

    def messages(self, entry: Entry) -> Iterator[ChannelMessage]:
        """The entry itself, and its drawings."""
        self._round = number = getattr(entry, "round", self._round)
        yield ChannelMessage(topic=TOPICS[type(entry)], round=number, data=entry.encoded())
        match entry:
            case MissionInfo():
                # As in records: plans keep their colours in the next mission.
                self._scene = self._scene or SceneDrawer(entry)
                yield ChannelMessage(topic=ARENA, round=number, data=_arena(entry))
            case PlanInfo() if self._scene is not None:
                self._scene.know([entry.plan_id])
            case State():
                if self._scene is None:
                    raise RecordError("a state comes before the mission")
                yield ChannelMessage(topic=SCENE_TOPIC, round=number, data=self._scene.draw(entry))
                yield from self._pose_messages(entry)
            case ProtocolEvent() | FlightEvent():
                yield ChannelMessage(topic=LOG, round=number, data=_log(entry))
            case _:
                pass

    def _pose_messages(self, state: State) -> Iterator[ChannelMessage]:
        points = [xyz(row) for row in state.positions]
        if not self._trails:
            longest = max(2, min(MAX_TRAIL_ROUNDS, MAX_TRAIL_POINTS // len(points)))
            self._trails = [deque(maxlen=longest) for _ in points]
        time = {"sec": state.round, "nsec": 0}
        lines: list[dict[str, Any]] = []
        for robot, (trail, point) in enumerate(zip(self._trails, points, strict=True)):
            trail.append(point)
            if len(trail) > 1:
                lines.append(_line(LINE_STRIP, list(trail), rgba(PALETTE[robot % len(PALETTE)], 0.8)))
            where = {"position": point, "orientation": ORIGIN["orientation"]}
            pose = {"timestamp": time, "frame_id": FRAME, "pose": where}
            yield ChannelMessage(topic=pose_topic(robot), round=state.round, data=to_json(pose))
        drawn = {"deletions": (), "entities": (entity("trails", time, lines=lines),)}
        yield ChannelMessage(topic=TRAILS, round=state.round, data=to_json(drawn))


def _arena(info: MissionInfo) -> bytes:
    """Walls and obstacles; they reach from floor to ceiling in 3D, and are OBSTACLE_HEIGHT tall in 2D."""
    low, high = info.mission["arena"]
    floor, top = (low[2], high[2]) if len(low) == 3 else (0.0, OBSTACLE_HEIGHT)
    if len(low) == 3:
        corners = [xyz([(high if k >> axis & 1 else low)[axis] for axis in range(3)]) for k in range(8)]
        walls = {**_line(LINE_LIST, corners, _EDGE_COLOR), "indices": _BOX_EDGES}
    else:
        walls = _line(LINE_LOOP, [xyz(p) for p in (low, [high[0], low[1]], high, [low[0], high[1]])], _EDGE_COLOR)
    lines, cylinders = [walls], list[dict[str, Any]]()
    for obstacle in info.mission.get("obstacles", ()):
        polygon, center, radius = obstacle.get("polygon"), obstacle.get("center"), obstacle.get("radius")
        if polygon is not None:
            lines += [_line(LINE_LOOP, [xyz([*row[:2], z]) for row in polygon], _EDGE_COLOR) for z in (floor, top)]
        elif center is not None and radius is not None:
            middle = xyz([*center[:2], (floor + top) / 2])
            size = {"x": 2 * radius, "y": 2 * radius, "z": top - floor}
            pose = {"position": middle, "orientation": ORIGIN["orientation"]}
            cylinders.append({"pose": pose, "size": size, "color": _OBSTACLE_COLOR, "bottom_scale": 1, "top_scale": 1})
    time = {"sec": info.round, "nsec": 0}
    drawn = (entity("arena", time, lines=lines, cylinders=cylinders),)
    return to_json({"deletions": (), "entities": drawn})


def _line(kind: int, points: list[dict[str, float]], color: dict[str, float]) -> dict[str, Any]:
    return {
        "type": kind,
        "pose": ORIGIN,
        "thickness": 2,
        "scale_invariant": True,
        "points": points,
        "color": color,
        "colors": (),
        "indices": (),
    }


def _log(event: ProtocolEvent | FlightEvent) -> bytes:
    """An event as a line of text: the robot or team, the kind, and the details by name."""
    who = "team" if event.robot is None else f"robot {event.robot}"
    details = ", ".join(f"{name} {value}" for name, value in _scalar_details(event.detail) if value is not None)
    text = f"{who}: {event.kind.replace('_', ' ')}" + (f" ({details})" if details else "")
    line = {
        "timestamp": {"sec": event.round, "nsec": 0},
        "level": _WARNING if event.kind in _WARNINGS else _INFO,
        "message": one_line(text, MAX_LOG_LINE),
        "name": who,
        "file": "",
        "line": 0,
    }
    return to_json(line)


def _scalar_details(detail: dict[str, Any]) -> Iterable[tuple[str, Any]]:
    """Details that are short enough for a line; proofs and plans are in the record's own channel."""
    return [(name, value) for name, value in detail.items() if not isinstance(value, list | dict | tuple)]


def _pose_schema() -> dict[str, Any]:
    drawn = scene_schema()["properties"]["entities"]["items"]["properties"]
    pose = drawn["cubes"]["items"]["properties"]["pose"]
    properties = {"timestamp": drawn["timestamp"], "frame_id": {"type": "string"}, "pose": pose}
    return {"title": "foxglove.PoseInFrame", "type": "object", "properties": properties}


def _log_schema() -> dict[str, Any]:
    time = scene_schema()["properties"]["entities"]["items"]["properties"]["timestamp"]
    levels = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
    level = {"oneOf": [{"title": name, "const": number} for number, name in enumerate(levels)]}
    text, number = {"type": "string"}, {"type": "integer"}
    properties = {"timestamp": time, "level": level, "message": text, "name": text, "file": text, "line": number}
    return {"title": "foxglove.Log", "type": "object", "properties": properties}
