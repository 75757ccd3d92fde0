"""The `/scene` channel: the team as a `foxglove.SceneUpdate`, for viewers that show such scenes.

Field names and meanings are those of https://docs.foxglove.dev/docs/sdk/schemas/scene-update.
Robots are spheres as wide as the safe distance, so two that touch have come too near. One unit is one metre.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from pydantic_core import to_json

from llm_flock import graph
from llm_flock.record._schema import DEAD, SILENT, MissionInfo, State
from llm_flock.record._words import NO_PLAN, PALETTE

FRAME = "world"
DECIMALS = 3


def rgba(colour: str, alpha: float = 1.0) -> dict[str, float]:
    """A colour such as #0072B2 in Foxglove's form, each part from 0 to 1."""
    red, green, blue = (round(int(colour[i : i + 2], 16) / 255, DECIMALS) for i in (1, 3, 5))
    return {"r": red, "g": green, "b": blue, "a": alpha}


_SOLID = [rgba(colour) for colour in PALETTE]
_FAINT = [rgba(colour, 0.35) for colour in PALETTE]
_WHITE = rgba(NO_PLAN)
_BLACK = rgba("#000000")
_LINK = rgba("#7F7F7F", 0.5)
_UPRIGHT = {"x": 0, "y": 0, "z": 0, "w": 1}
ORIGIN: dict[str, Any] = {"position": {"x": 0, "y": 0, "z": 0}, "orientation": _UPRIGHT}
_PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
LINE_STRIP, LINE_LOOP, LINE_LIST = 0, 1, 2
"""Kinds of lines."""


class SceneDrawer:
    """Turns states into scenes, and keeps the colour of every plan. The mission gives sizes and ranges."""

    def __init__(self, mission: MissionInfo) -> None:
        self._diameter = float(mission.mission["safe_distance"])
        self._tall = float(mission.mission.get("downwash", 1.0))
        self._comm_range = float(mission.mission["comm_range"])
        self._plans: dict[str, int] = {}

    def know(self, plan_ids: Iterable[str | None]) -> None:
        """Give each new plan the next colour."""
        for plan_id in plan_ids:
            if plan_id is not None:
                self._plans.setdefault(plan_id, len(self._plans))

    def draw(self, state: State) -> bytes:
        """One scene: robots and their ids, goals, and radio links."""
        self.know(state.plan_ids)
        points = [xyz(row) for row in state.positions]
        colours = [None if p is None else self._plans[p] % len(PALETTE) for p in state.plan_ids]
        looks = [
            _BLACK if phase == DEAD else _WHITE if colour is None else _SOLID[colour]
            for phase, colour in zip(state.phases, colours, strict=True)
        ]
        robots = [_sphere(point, self._diameter, look, self._tall) for point, look in zip(points, looks, strict=True)]
        goals = [
            _sphere(xyz(goal), self._diameter / 2, _WHITE if colour is None else _FAINT[colour])
            for goal, colour in zip(state.goals, colours, strict=True)
            if goal is not None
        ]
        ids = [
            {
                "pose": _pose({**point, "z": point["z"] + self._diameter * (self._tall + 1.0) / 2}),
                "billboard": True,
                "font_size": self._diameter / 2,
                "scale_invariant": False,
                "color": _BLACK,
                "text": str(robot),
            }
            for robot, point in enumerate(points)
        ]
        time = {"sec": state.round, "nsec": 0}
        entities = (
            entity("robots", time, spheres=robots, texts=ids),
            entity("goals", time, spheres=goals),
            entity("links", time, lines=self._links(state, points)),
        )
        return to_json({"deletions": (), "entities": entities})

    def _links(self, state: State, points: list[dict[str, float]]) -> list[dict[str, Any]]:
        adjacent = graph.adjacency(np.array(state.positions), self._comm_range)
        silent = [robot for robot, phase in enumerate(state.phases) if phase in SILENT]
        adjacent[silent, :] = adjacent[:, silent] = False
        pairs: list[list[int]] = np.argwhere(np.triu(adjacent)).tolist()
        if not pairs:
            return []
        return [
            {
                "type": LINE_LIST,
                "pose": ORIGIN,
                "thickness": 1,
                "scale_invariant": True,
                "points": points,
                "color": _LINK,
                "colors": (),
                "indices": [robot for pair in pairs for robot in pair],
            }
        ]


def xyz(row: list[float]) -> dict[str, float]:
    """A position in Foxglove's form; a plane lies at height 0."""
    x, y, z = (round(value, DECIMALS) for value in (*row, 0.0)[:3])
    return {"x": x, "y": y, "z": z}


def _pose(position: dict[str, float]) -> dict[str, Any]:
    return {"position": position, "orientation": _UPRIGHT}


def _sphere(at: dict[str, float], diameter: float, color: dict[str, float], tall: float = 1.0) -> dict[str, Any]:
    return {"pose": _pose(at), "size": {"x": diameter, "y": diameter, "z": diameter * tall}, "color": color}


def entity(name: str, time: dict[str, int], **primitives: list[dict[str, Any]]) -> dict[str, Any]:
    """An entity that replaces the last one of its name; viewers expect every list of primitives."""
    return {
        "timestamp": time,
        "frame_id": FRAME,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        "metadata": (),
        **{kind: primitives.get(kind, ()) for kind in _PRIMITIVES},
    }


def scene_schema() -> dict[str, Any]:
    """JSON schema of `foxglove.SceneUpdate`."""
    number, integer, text, flag = ({"type": kind} for kind in ("number", "integer", "string", "boolean"))
    time = _object("time", sec=integer, nsec=integer)
    vector = _object("foxglove.Vector3", x=number, y=number, z=number)
    point = _object("foxglove.Point3", x=number, y=number, z=number)
    turn = _object("foxglove.Quaternion", x=number, y=number, z=number, w=number)
    pose = _object("foxglove.Pose", position=vector, orientation=turn)
    color = _object("foxglove.Color", r=number, g=number, b=number, a=number)
    mesh = {"points": _array(point), "color": color, "colors": _array(color), "indices": _array(integer)}
    solid = {"pose": pose, "size": vector, "color": color}
    line = {"type": _choice("LINE_STRIP", "LINE_LOOP", "LINE_LIST"), "thickness": number, "scale_invariant": flag}
    label = {"billboard": flag, "font_size": number, "scale_invariant": flag, "color": color, "text": text}
    shaft = {"shaft_length": number, "shaft_diameter": number, "head_length": number, "head_diameter": number}
    data = {"type": "string", "contentEncoding": "base64"}
    model = {"scale": vector, "color": color, "override_color": flag, "url": text, "media_type": text, "data": data}
    one_entity = _object(
        "foxglove.SceneEntity",
        timestamp=time,
        frame_id=text,
        id=text,
        lifetime=_object("duration", sec=integer, nsec=integer),
        frame_locked=flag,
        metadata=_array(_object("foxglove.KeyValuePair", key=text, value=text)),
        arrows=_array(_object("foxglove.ArrowPrimitive", pose=pose, **shaft, color=color)),
        cubes=_array(_object("foxglove.CubePrimitive", **solid)),
        spheres=_array(_object("foxglove.SpherePrimitive", **solid)),
        cylinders=_array(_object("foxglove.CylinderPrimitive", **solid, bottom_scale=number, top_scale=number)),
        lines=_array(_object("foxglove.LinePrimitive", pose=pose, **line, **mesh)),
        triangles=_array(_object("foxglove.TriangleListPrimitive", pose=pose, **mesh)),
        texts=_array(_object("foxglove.TextPrimitive", pose=pose, **label)),
        models=_array(_object("foxglove.ModelPrimitive", pose=pose, **model)),
    )
    deletion = _object("foxglove.SceneEntityDeletion", timestamp=time, type=_choice("MATCHING_ID", "ALL"), id=text)
    return _object("foxglove.SceneUpdate", deletions=_array(deletion), entities=_array(one_entity))


def _object(title: str, **properties: Any) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _array(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


def _choice(*names: str) -> dict[str, Any]:
    return {"oneOf": [{"title": name, "const": number} for number, name in enumerate(names)]}
