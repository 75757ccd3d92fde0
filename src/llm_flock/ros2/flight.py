"""Shows a flight in ROS 2 while it happens: no fault here reaches a drone.

Nothing comes in but the drones' poses, and those only with `pose_source = "ros2"`.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, closing
from typing import Any

from llm_flock.record.schema import BodySample, Entry, FlightEvent
from llm_flock.record.writer import RecordSink
from llm_flock.ros2.bridge import DIAGNOSTICS_S, MARKERS_S
from llm_flock.ros2.drawing import ERROR, OK, WARN
from llm_flock.ros2.graph import Graph
from llm_flock.ros2.nodes import TEAM_NODE, Finding, Refused, TeamNodes
from llm_flock.ros2.poses import RosPoses
from llm_flock.ros2.recorded import RecordedTeam, positions_of
from llm_flock.runtime.flight.config import FlightConfig
from llm_flock.runtime.network.connection import refusing

TEAM = "flock"
"""Namespace of a flight's topics, unless configured."""


class FlightShow:
    """A sink that shows the entries of a flight."""

    def __init__(self, graph: Graph, config: FlightConfig) -> None:
        self.faults = Refused()
        n_robots = config.mission.n_robots
        self._nodes = TeamNodes(graph, config.ros2, TEAM, n_robots, clock=False)
        self._team = RecordedTeam(config.frame.to_world, config.world.scale_m)
        self._names = [drone.name for drone in config.fleet.drones] or [str(robot) for robot in range(n_robots)]
        self._safety = config.safety
        self._period_s, self._due_s = 1.0 / config.ros2.ros_rate_hz, 0.0
        self._sample: BodySample | None = None
        self._event: FlightEvent | None = None

    def write(self, entry: Entry) -> None:
        """Take an entry; an error is counted, and logged, and nothing else."""
        with refusing(self.faults.counts):
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

    async def live(self) -> None:
        """Show markers, state and diagnostics, until cancelled."""
        diagnosed_s = 0.0
        while True:
            await asyncio.sleep(MARKERS_S)
            now = time.monotonic()
            with refusing(self.faults.counts):
                if (view := self._team.view()) is not None:
                    self._nodes.show_markers(view, time.time_ns())
                    self._nodes.show_state({**self._team.state_json(), "flight": self._told()})
                if now - diagnosed_s >= DIAGNOSTICS_S:
                    diagnosed_s = now
                    self._nodes.show_diagnostics(self._findings(), time.time_ns())

    def _told(self) -> dict[str, Any] | None:
        event = self._event
        return None if event is None else event.model_dump(mode="json", exclude_none=True)

    def _findings(self) -> list[Finding]:
        event, sample = self._event, self._sample
        found: list[Finding] = [("flight", OK, "" if event is None else event.kind, {})]
        found.append(self.faults.finding("bridge"))
        if sample is None:
            return found
        for name, up, volts, link in zip(self._names, sample.flying, sample.battery_v, sample.link, strict=True):
            low = volts is not None and volts < self._safety.low_battery_v
            level = ERROR if link == 0.0 else WARN if low else OK
            said = "link lost" if link == 0.0 else "flying" if up else "on the ground"
            found.append((name, level, said, {"battery [V]": volts, "link": link}))
        return found


def poses_of(config: FlightConfig) -> RosPoses | None:
    """The source of a flight's poses in ROS 2; None where they come from elsewhere."""
    if config.positions.pose_source != "ros2":
        return None
    return RosPoses(config.ros2, TEAM, [drone.name for drone in config.fleet.drones])


@asynccontextmanager
async def showing_flight(config: FlightConfig) -> AsyncGenerator[RecordSink | None]:
    """A sink that shows a flight in ROS 2; None where no router is configured.

    Raises:
        InputError: the router does not answer, or the extra is not installed, or another bridge shows this team.
    """
    if config.ros2.router is None:
        yield None
        return
    with closing(Graph(config.ros2.router, config.ros2.ros_domain)) as graph:
        graph.check_free(config.ros2.namespace(TEAM), TEAM_NODE)
        show = FlightShow(graph, config)
        task = asyncio.create_task(show.live())
        try:
            yield show
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
