"""Reads missions from ROS, checks them, and gives them to the swarm as its operator does.

With keys, the operator's key signs them: every node that may publish on the topics speaks for the operator.
"""

from __future__ import annotations

import json
import math
import time
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, cast

from llm_flock.arrays import MAX_COORDINATE
from llm_flock.bounds import MAX_ROBOTS
from llm_flock.errors import InputError, MessageError
from llm_flock.members import OPERATOR
from llm_flock.message import MISSION_FIELDS, MissionStamp, OperatorClock
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.connection import open_link
from llm_flock_swarm._network.mission_orders import mission_order, mission_verifier
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.watch import FREE_PORT
from llm_flock_swarm._network.wire import pack
from llm_flock_swarm._ros2.drawing import Position

ORDERED = MISSION_FIELDS - {"velocity", "since"}
"""Fields that an order may change. Formations of a swarm of processes stand still."""

MAX_TEXT_LENGTH = 1 << 16  # longest text of a mission [characters]
TAKERS = 3  # robots that are given an order: one is enough, if it lives
RATE, POSE_RATE = 1.0, 500.0  # orders a second, in the long run, on each topic; and poses of one robot


def mission_fields(text: str) -> dict[str, Any]:
    """Fields of a mission in JSON or TOML, in a table `mission` or without [units]; a MessageError `bad_mission`."""
    if len(text) > MAX_TEXT_LENGTH:
        raise MessageError("bad_mission", f"{len(text)} characters, more than {MAX_TEXT_LENGTH}")
    try:
        found: object = json.loads(text) if text.lstrip().startswith("{") else tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise MessageError("bad_mission", f"neither a JSON object nor TOML: {error}") from None
    whole = cast("dict[str, Any]", found)
    inner: object = whole["mission"] if whole.keys() == {"mission"} else whole
    fields = cast("dict[str, Any]", inner) if isinstance(inner, dict) else {}
    if not fields:
        raise MessageError("bad_mission", "no field of a mission")
    if not fields.keys() <= ORDERED:
        strange = next(name for name in fields if name not in ORDERED)
        raise MessageError("bad_mission", f"{strange!a} is none of {', '.join(sorted(ORDERED))}")
    return fields


def checked_position(point: Any) -> Position:
    """The coordinates of a geometry_msgs/Point [m]; a MessageError `not_finite` or `out_of_range`."""
    found = float(point.x), float(point.y), float(point.z)
    if not all(map(math.isfinite, found)):
        raise MessageError("not_finite", f"position {found}")
    if max(map(abs, found)) > MAX_COORDINATE:
        raise MessageError("out_of_range", f"position {found}")
    return found


def check_frame(message: Any, frame: str) -> None:
    """A MessageError `wrong_frame` unless a message's header names this frame, or none."""
    if message.header.frame_id.lstrip("/") not in ("", frame):
        raise MessageError("wrong_frame", f"{message.header.frame_id!a} instead of {frame!a}")


def places_fields(message: Any, frame: str, unit_m: float, dim: int) -> dict[str, Any]:
    """The fields of a mission whose places are the poses of a PoseArray [m]; their mean is its centre."""
    check_frame(message, frame)
    if not 1 <= len(message.poses) <= MAX_ROBOTS:
        raise MessageError("bad_mission", f"{len(message.poses)} points, not 1 to {MAX_ROBOTS}")
    rows = [checked_position(pose.position) for pose in message.poses]
    points = [[x / unit_m for x in row[:dim]] for row in rows]
    return {"points": points, "center": [math.fsum(column) / len(points) for column in zip(*points, strict=True)]}


class MissionGiver:
    """Gives missions to a running swarm. Call in a running event loop; `close` leaves the network."""

    def __init__(self, config: SwarmConfig, observer: Observer) -> None:
        self._signed = mission_verifier(config, OPERATOR)
        self._config, self._observer = config, observer
        self._clock = OperatorClock(lambda: time.time_ns() // 1_000_000)
        self._link = open_link(config, OPERATOR, FREE_PORT)

    def give(self, fields: Mapping[str, Any]) -> Sequence[int]:
        """Change these fields of the team's mission. MessageError: `bad_mission`, or `nobody` if no robot is there."""
        observer = self._observer
        try:
            observer.mission.change(**fields)
        except (InputError, RecursionError) as error:
            raise MessageError("bad_mission", str(error)) from None
        takers = sorted(observer.robots, key=lambda robot: -observer.heard_s[robot])[:TAKERS]
        if not takers:
            raise MessageError("nobody", "no robot of the swarm is there")
        for report in observer.reports.values():
            if self._signed is None or self._signed(MissionStamp(*report.mission), report.order):
                self._clock.witness(report.mission[0])
        now = self._config.model_copy(update={"mission": observer.mission})
        order = pack(mission_order(now, dict(fields), self._clock.next()))
        for robot in takers:
            self._link.publish("mission", robot, order)
        return takers

    def close(self) -> None:
        self._link.close()
