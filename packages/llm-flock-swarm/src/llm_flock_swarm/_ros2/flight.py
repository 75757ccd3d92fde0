"""Shows a flight in ROS 2. No fault here reaches a drone. Poses are read only with `pose_source = "ros2"`."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager, closing
from typing import Any

from llm_flock.errors import MessageError
from llm_flock.record import BodySample, Entry, FlightEvent, RecordSink
from llm_flock.robots import Pose, PoseFrame
from llm_flock.runtime import ROBOT, MissionFrame, Ros2Config
from llm_flock_swarm._network.receiving import count_refusals
from llm_flock_swarm._ros2.drawing import ERROR, OK, WARN
from llm_flock_swarm._ros2.graph import Graph
from llm_flock_swarm._ros2.nodes import TEAM_NODE, Finding, Refused, TeamNodes, live
from llm_flock_swarm._ros2.orders import POSE_RATE, check_frame, checked_position
from llm_flock_swarm._ros2.recorded import RecordedTeam, positions_of
from llm_flock_swarm._ros2.types import POSE, prepare
from llm_flock_swarm._ros2.wire import Attachment

__all__ = ["poses_of", "prepare", "showing_flight"]  # the plug-in, see llm_flock_flight._flight.shown

TEAM = "flock"  # namespace of a flight's topics, unless configured
RECENT_S = 1.0  # a second publisher that was heard in this time is named [s]


class FlightShow:
    """A sink that shows the entries of a flight."""

    def __init__(
        self, graph: Graph, config: Ros2Config, drones: Sequence[str], frame: MissionFrame, low_battery_v: float
    ) -> None:
        self.faults = Refused()
        self._nodes = TeamNodes(graph, config, TEAM, len(drones), clock=False)
        self._team = RecordedTeam(frame.to_world, frame.scale_m)
        self._names, self._low_battery_v = drones, low_battery_v
        self._period_s, self._due_s = 1.0 / config.ros_rate_hz, 0.0
        self._sample: BodySample | None = None
        self._event: FlightEvent | None = None

    def write(self, entry: Entry) -> None:
        """Take an entry; an error is counted, and logged, and nothing else."""
        with count_refusals(self.faults.counts):
            self._team.take(entry)
            if isinstance(entry, FlightEvent):
                self._event = entry
            elif isinstance(entry, BodySample):
                self._sample = entry
                self._show_sample(entry)

    def _show_sample(self, sample: BodySample) -> None:
        now = time.monotonic()
        if now >= self._due_s:
            self._due_s = max(self._due_s + self._period_s, now)
            stamp_ns = time.time_ns()
            self._nodes.show_poses(positions_of(sample), stamp_ns)
            if (view := self._team.view()) is not None:
                self._nodes.show_paths(view, stamp_ns)

    def show_rest(self, diagnose: bool) -> None:
        if (view := self._team.view()) is not None:
            self._nodes.show_markers(view, time.time_ns())
            self._nodes.show_state({**self._team.state_json(), "flight": self._event_fields()})
        if diagnose:
            self._nodes.show_diagnostics(self._findings(), time.time_ns())

    def _event_fields(self) -> dict[str, Any] | None:
        event = self._event
        return None if event is None else event.model_dump(mode="json", exclude_none=True)

    def _findings(self) -> list[Finding]:
        event, sample = self._event, self._sample
        found: list[Finding] = [("flight", OK, "" if event is None else event.kind, {})]
        found.append(self.faults.finding("bridge"))
        if sample is None:
            return found
        for name, up, volts, link in zip(self._names, sample.flying, sample.battery_v, sample.link, strict=True):
            low = volts is not None and volts < self._low_battery_v
            level = ERROR if link == 0.0 else WARN if low else OK
            summary = "link lost" if link == 0.0 else "flying" if up else "on the ground"
            found.append((name, level, summary, {"battery [V]": volts, "link": link}))
        return found


class RosPoses:
    """A source of poses for the drones' estimators: one topic for each drone, by its number in `names`."""

    def __init__(self, config: Ros2Config, team: str, names: Sequence[str]) -> None:
        self.refused: Counter[str] = Counter()
        self._config, self._namespace = config, config.namespace(team)
        self._topic, self._names = config.pose_topic(team), names
        self._graph: Graph | None = None
        self._sources: dict[str, bytes] = {}
        self._others: dict[str, tuple[bytes, float]] = {}

    async def open(self, take: Callable[[PoseFrame], None]) -> None:
        router = self._config.router
        assert router is not None, "the flight's configuration sees to that"
        graph = self._graph = Graph(router, self._config.ros_domain)
        head, _, tail = self._topic.partition(ROBOT)
        node = graph.node(self._namespace, "poses")

        for robot, name in enumerate(self._names):
            topic = f"{head}{robot}{tail}"
            node.listens(topic, POSE)

            def on_pose(_topic: str, message: Any, attached: Attachment, name: str = name) -> None:
                take(self.frame(name, message, attached))

            graph.subscribe(topic, POSE, on_pose, self._refuse, rate=POSE_RATE)

    def frame(self, name: str, message: Any, attached: Attachment) -> PoseFrame:
        """The frame with one drone's message; a MessageError says why it is refused."""
        check_frame(message, self._config.ros_frame)
        if self._sources.setdefault(name, attached.gid) != attached.gid:
            self._others[name] = attached.gid, time.monotonic()
            raise MessageError("second_source", f"{name}: two publishers tell where it is")
        pose = Pose(checked_position(message.pose.position), _turn(message.pose.orientation))
        return PoseFrame(stamp_s=attached.stamp_ns / 1e9, poses={name: pose})

    def senders(self, now: float) -> tuple[str, ...]:
        """The two publishers of the first drone that has two, by the beginnings of their gids; else none."""
        for name, (other, heard_s) in self._others.items():
            if now - heard_s < RECENT_S:
                return tuple(f"publisher {gid.hex()[:8]} of {name}" for gid in (self._sources[name], other))
        return ()

    def _refuse(self, _topic: str, error: MessageError) -> None:
        self.refused[error.reason] += 1

    async def close(self) -> None:
        graph, self._graph = self._graph, None
        if graph is not None:
            graph.close()


def _turn(found: Any) -> tuple[float, float, float, float] | None:
    """A message's orientation; None where it is none, such as the zeros of a message without one."""
    turn = float(found.x), float(found.y), float(found.z), float(found.w)
    length = sum(value * value for value in turn)
    return turn if 0.98 < length < 1.02 else None


def poses_of(config: Ros2Config, drones: Sequence[str]) -> RosPoses:
    return RosPoses(config, TEAM, drones)


@asynccontextmanager
async def showing_flight(
    config: Ros2Config, drones: Sequence[str], frame: MissionFrame, low_battery_v: float
) -> AsyncGenerator[RecordSink]:
    """A sink that shows a flight in ROS 2, with a warning below this voltage."""
    assert config.router is not None, "without a router, nothing is shown"
    with closing(Graph(config.router, config.ros_domain)) as graph:
        graph.check_free(config.namespace(TEAM), TEAM_NODE)
        show = FlightShow(graph, config, drones, frame, low_battery_v)
        task = asyncio.create_task(live(show.show_rest, show.faults.counts))
        try:
            yield show
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
