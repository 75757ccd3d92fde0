"""Poses from ROS 2 for a flight's drones: the third source beside the external pose port and a motion capture.

A swarm takes poses from ROS as its robots' sensors (`llm_flock.ros2.sensors`). Here they go to the drones' estimators,
through the same gate as the poses of every source.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from llm_flock.errors import MessageError
from llm_flock.robots.pose import Pose, PoseFrame
from llm_flock.ros2.graph import Graph
from llm_flock.ros2.orders import check_frame, checked_position
from llm_flock.ros2.types import POSE
from llm_flock.ros2.wire import Attachment
from llm_flock.runtime.ros2_config import ROBOT, Ros2Config

POSE_RATE = 500.0
"""Most poses of one drone that are read in a second."""

RECENT_S = 1.0
"""A second publisher that was heard in this time is named [s]."""


class RosPoses:
    """A source of one topic for each drone, `geometry_msgs/PoseStamped`.

    Args:
        config: which names the topics and their frame.
        team: namespace, if none is configured.
        names: of the drones, by the number that stands in their topics.
    """

    def __init__(self, config: Ros2Config, team: str, names: Sequence[str]) -> None:
        self.refused: Counter[str] = Counter()
        self._config, self._namespace = config, config.namespace(team)
        self._topic, self._names = config.pose_topic(team), names
        self._graph: Graph | None = None
        self._sources: dict[str, bytes] = {}
        self._others: dict[str, tuple[bytes, float]] = {}

    async def open(self, take: Callable[[PoseFrame], None]) -> None:
        """Listen from now on.

        Raises:
            InputError: the router does not answer, or the extra is not installed.
        """
        router = self._config.router
        assert router is not None, "the flight's configuration sees to that"
        graph = self._graph = Graph(router, self._config.ros_domain)
        head, _, tail = self._topic.partition(ROBOT)
        node = graph.node(self._namespace, "poses")

        for robot, name in enumerate(self._names):
            topic = f"{head}{robot}{tail}"
            node.listens(topic, POSE)

            def heard(_topic: str, message: Any, attached: Attachment, name: str = name) -> None:
                take(self.frame(name, message, attached))

            graph.subscribe(topic, POSE, heard, self._refuse, rate=POSE_RATE)

    def frame(self, name: str, message: Any, attached: Attachment) -> PoseFrame:
        """The frame with one drone's message.

        Raises:
            MessageError: `wrong_frame`, `not_finite`, `out_of_range`, or `second_source`.
        """
        check_frame(message, self._config.ros_frame)
        if self._sources.setdefault(name, attached.gid) != attached.gid:
            self._others[name] = attached.gid, time.monotonic()
            raise MessageError("second_source", f"{name}: two publishers tell where it is")
        pose = Pose(checked_position(message.pose.position), _turn(message.pose.orientation))
        return PoseFrame(stamp_s=attached.stamp_ns / 1e9, poses={name: pose})

    def senders(self, now: float) -> tuple[str, ...]:
        """The two publishers of the first drone that has two, by the beginnings of their gids; else nobody."""
        for name, (other, heard_s) in self._others.items():
            if now - heard_s < RECENT_S:
                return tuple(f"publisher {gid.hex()[:8]} of {name}" for gid in (self._sources[name], other))
        return ()

    def _refuse(self, _topic: str, error: MessageError) -> None:
        self.refused[error.reason] += 1

    async def close(self) -> None:
        """Leave the graph."""
        graph, self._graph = self._graph, None
        if graph is not None:
            graph.close()


def _turn(found: Any) -> tuple[float, float, float, float] | None:
    """A message's orientation; None where it is none, such as the zeros of a message without one."""
    turn = float(found.x), float(found.y), float(found.z), float(found.w)
    length = sum(value * value for value in turn)
    return turn if 0.98 < length < 1.02 else None
