"""The team as ROS 2 messages, for live topics and bags: in metres, x forward, y left, z up (REP 103), no headings."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from llm_flock import graph
from llm_flock.arrays import Point
from llm_flock.printable import one_line
from llm_flock.record import DEAD, NO_PLAN, PALETTE, SILENT, State
from llm_flock_swarm._ros2.types import (
    DIAGNOSTICS,
    MARKERS,
    NS,
    PATH,
    POSE,
    TEXT,
    TRANSFORMS,
    header,
    message_class,
    to_cdr,
)

Position = tuple[float, float, float]  # a point in the frame [m]
ToWorld = Callable[[Point], Position]  # turns a point of the mission [units] into one of the frame [m]
OK, WARN, ERROR = 0, 1, 2  # levels of diagnostic_msgs/DiagnosticStatus
LONGEST = 500  # longest text of a diagnostic value [characters]: part of it may come from outside

_STAMP, _POINT = struct.Struct("<iI"), struct.Struct("<3d")
_POSE_BYTES = 7 * 8  # position and quaternion, as doubles

_SPHERE_LIST, _LINE_LIST, _TEXT = 7, 5, 9
_ADD, _DELETE = 0, 2
_LINK_WIDTH = 0.1  # as a share of the safe distance


def scaled(unit_m: float) -> ToWorld:
    """The frame of a mission whose unit is this long [m], and whose origin is that of the frame."""

    def to_world(point: Point) -> Position:
        x, y, z = (*point, 0.0, 0.0)[:3]
        return (unit_m * x, unit_m * y, unit_m * z)

    return to_world


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamView:
    """A team at one moment, in metres, all sequences by robot id."""

    positions: Sequence[Position]
    waypoints: Sequence[Position | None]
    goals: Sequence[Position | None]
    phases: Sequence[str]
    plan_ids: Sequence[str | None]
    places: Sequence[Position]  # of the plan that most robots follow
    links: Sequence[tuple[int, int]]  # pairs in radio contact
    safe_m: float
    downwash: float


def view_of(
    state: State,
    to_world: ToWorld,
    *,
    safe_m: float,
    downwash: float,
    comm_range: float,
    places: Mapping[str, Sequence[Point]],
) -> TeamView:
    """A recorded or observed state in metres; `places` are those of known plans by their ids [units]."""

    def to_world_rows(rows: Sequence[Sequence[float] | None]) -> list[Position | None]:
        return [None if row is None else to_world(tuple(row)) for row in rows]

    adjacent = graph.adjacency(np.array(state.positions), comm_range)
    silent = [robot for robot, phase in enumerate(state.phases) if phase in SILENT]
    adjacent[silent, :] = adjacent[:, silent] = False
    pairs: list[list[int]] = np.argwhere(np.triu(adjacent)).tolist()
    plans = [plan for plan in state.plan_ids if plan is not None]
    common = max(sorted(set(plans)), key=plans.count, default="")
    return TeamView(
        positions=[to_world(tuple(row)) for row in state.positions],
        waypoints=to_world_rows(state.waypoints),
        goals=to_world_rows(state.goals),
        phases=state.phases,
        plan_ids=state.plan_ids,
        places=[to_world(tuple(point)) for point in places.get(common, ())],
        links=[(a, b) for a, b in pairs],
        safe_m=safe_m,
        downwash=downwash,
    )


def _point(at: Position) -> Any:
    return message_class("geometry_msgs/msg/Point")(x=at[0], y=at[1], z=at[2])


def _upright() -> Any:
    return message_class("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0)


def _pose(at: Position) -> Any:
    return message_class("geometry_msgs/msg/Pose")(position=_point(at), orientation=_upright())


def pose(at: Position, stamp_ns: int, frame: str) -> Any:
    """A PoseStamped."""
    return message_class(POSE)(header=header(stamp_ns, frame), pose=_pose(at))


class PoseEncoder:
    """Encodes what `pose` gives as CDR, in a tenth of the time: poses are most of the work.

    Only the stamp, behind the header of the CDR, and the position, 56 bytes before the end, change.
    """

    def __init__(self, frame: str) -> None:
        self._data = bytearray(to_cdr(pose((0.0, 0.0, 0.0), 0, frame), POSE))
        self._point = len(self._data) - _POSE_BYTES

    def encode(self, at: Position, stamp_ns: int) -> bytes:
        """A PoseStamped as CDR."""
        _STAMP.pack_into(self._data, 4, *divmod(max(0, stamp_ns), NS))
        _POINT.pack_into(self._data, self._point, *at)
        return bytes(self._data)


def path(view: TeamView, robot: int, stamp_ns: int, frame: str) -> Any:
    """A Path: from where the robot is by its waypoint to its goal, as far as it has them."""
    here, waypoint, goal = view.positions[robot], view.waypoints[robot], view.goals[robot]
    stops = [here, *(stop for stop in (waypoint, goal) if stop is not None)]
    return message_class(PATH)(header=header(stamp_ns, frame), poses=[pose(at, stamp_ns, frame) for at in stops])


def transforms(positions: Sequence[Position], names: Sequence[str], stamp_ns: int, frame: str) -> Any:
    """A TFMessage with a frame for each robot."""
    vector = message_class("geometry_msgs/msg/Vector3")
    transform = message_class("geometry_msgs/msg/Transform")
    stamped = message_class("geometry_msgs/msg/TransformStamped")
    return message_class(TRANSFORMS)(
        transforms=[
            stamped(
                header=header(stamp_ns, frame),
                child_frame_id=name,
                transform=transform(translation=vector(x=at[0], y=at[1], z=at[2]), rotation=_upright()),
            )
            for at, name in zip(positions, names, strict=True)
        ]
    )


def _colour(code: str, alpha: float = 1.0) -> Any:
    red, green, blue = (int(code[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return message_class("std_msgs/msg/ColorRGBA")(r=red, g=green, b=blue, a=alpha)


class MarkerDrawer:
    """Draws a team as a MarkerArray. Robots have the colour of their plan, without one white, dead ones black."""

    def __init__(self, frame: str) -> None:
        self._frame = frame
        self._plans: dict[str, int] = {}

    def draw(self, view: TeamView, stamp_ns: int) -> Any:
        """All markers of one moment; a list that is empty deletes its marker."""
        looks = [self._look(view, robot) for robot in range(len(view.positions))]
        goals = [(goal, look) for goal, look in zip(view.goals, looks, strict=True) if goal is not None]
        ends = [view.positions[robot] for pair in view.links for robot in pair]
        # Name, kind, size over the safe distance, points, their colours and opacity.
        drawn: list[tuple[str, int, float, Sequence[Position], Sequence[str], float]] = [
            ("robots", _SPHERE_LIST, 1 / 2, view.positions, looks, 1.0),
            ("safe_distance", _SPHERE_LIST, 1.0, view.positions, looks, 0.2),
            ("goals", _SPHERE_LIST, 1 / 4, [goal for goal, _ in goals], [look for _, look in goals], 0.6),
            ("places", _SPHERE_LIST, 1 / 3, view.places, [], 1.0),
            ("links", _LINE_LIST, _LINK_WIDTH, ends, [], 1.0),
        ]
        made: list[Any] = []
        for name, kind, size, points, codes, alpha in drawn:
            colours = [_colour(code, alpha) for code in codes]
            plain = "#7F7F7F" if name in ("places", "links") else "#FFFFFF"
            tall = view.downwash if name == "safe_distance" else 1.0
            size *= view.safe_m
            made.append(self._marker(name, 0, kind, size, stamp_ns, points, colours, plain, tall=tall))
        for robot, (x, y, z) in enumerate(view.positions):
            above = (x, y, z + view.safe_m / 2)
            made.append(self._marker("ids", robot, _TEXT, view.safe_m / 2, stamp_ns, at=above, text=str(robot)))
        return message_class(MARKERS)(markers=made)

    def _look(self, view: TeamView, robot: int) -> str:
        plan = view.plan_ids[robot]
        if view.phases[robot] == DEAD:
            return "#000000"
        if plan is None:
            return NO_PLAN
        return PALETTE[self._plans.setdefault(plan, len(self._plans)) % len(PALETTE)]

    def _marker(
        self,
        name: str,
        number: int,
        kind: int,
        size: float,
        stamp_ns: int,
        points: Sequence[Position] = (),
        colours: Sequence[Any] = (),
        colour: str = "#FFFFFF",
        *,
        at: Position = (0.0, 0.0, 0.0),
        text: str = "",
        tall: float = 1.0,
    ) -> Any:
        empty = np.zeros(0, dtype=np.uint8)
        return message_class("visualization_msgs/msg/Marker")(
            header=header(stamp_ns, self._frame),
            ns=name,
            id=number,
            type=kind,
            action=_ADD if points or text else _DELETE,
            pose=_pose(at),
            scale=message_class("geometry_msgs/msg/Vector3")(x=size, y=size, z=size * tall),
            color=_colour(colour, 0.6),
            lifetime=message_class("builtin_interfaces/msg/Duration")(sec=0, nanosec=0),
            frame_locked=False,
            points=[_point(point) for point in points],
            colors=list(colours),
            texture_resource="",
            texture=message_class("sensor_msgs/msg/CompressedImage")(header=header(0, ""), format="", data=empty),
            uv_coordinates=[],
            text=text,
            mesh_resource="",
            mesh_file=message_class("visualization_msgs/msg/MeshFile")(filename="", data=empty),
            mesh_use_embedded_materials=False,
        )


def text(content: Mapping[str, Any]) -> Any:
    """A String with JSON."""
    return message_class(TEXT)(data=json.dumps(content, allow_nan=False, separators=(",", ":")))


def diagnostics(found: Sequence[tuple[str, int, str, Mapping[str, object]]], stamp_ns: int, hardware: str) -> Any:
    """A DiagnosticArray from names, levels, messages and values."""
    status = message_class("diagnostic_msgs/msg/DiagnosticStatus")
    pair = message_class("diagnostic_msgs/msg/KeyValue")
    return message_class(DIAGNOSTICS)(
        header=header(stamp_ns, ""),
        status=[
            status(
                level=level,
                name=name,
                message=one_line(summary, LONGEST),
                hardware_id=hardware,
                values=[pair(key=key, value=one_line(str(value), LONGEST)) for key, value in values.items()],
            )
            for name, level, summary, values in found
        ],
    )
