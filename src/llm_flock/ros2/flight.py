"""Shows a flight in ROS 2 while it happens: no fault here reaches a drone.

Nothing comes in but the drones' poses, and those only with `pose_source = "ros2"`.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Sequence
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
from llm_flock.ros2.types import prepare
from llm_flock.runtime.mission_frame import MissionFrame
from llm_flock.runtime.network.connection import refusing
from llm_flock.runtime.ros2_config import Ros2Config

__all__ = ["poses_of", "prepare", "showing_flight"]  # the plug-in, see llm_flock.runtime.flight.shown

TEAM = "flock"
"""Namespace of a flight's topics, unless configured."""


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
            low = volts is not None and volts < self._low_battery_v
            level = ERROR if link == 0.0 else WARN if low else OK
            said = "link lost" if link == 0.0 else "flying" if up else "on the ground"
            found.append((name, level, said, {"battery [V]": volts, "link": link}))
        return found


def poses_of(config: Ros2Config, drones: Sequence[str]) -> RosPoses:
    """The source of these drones' poses."""
    return RosPoses(config, TEAM, drones)


@asynccontextmanager
async def showing_flight(
    config: Ros2Config, drones: Sequence[str], frame: MissionFrame, low_battery_v: float
) -> AsyncGenerator[RecordSink]:
    """A sink that shows a flight in ROS 2, with a warning below this voltage.

    Raises:
        InputError: the router does not answer, or the extra is not installed, or another bridge shows this team.
    """
    assert config.router is not None, "without a router, nothing is shown"
    with closing(Graph(config.router, config.ros_domain)) as graph:
        graph.check_free(config.namespace(TEAM), TEAM_NODE)
        show = FlightShow(graph, config, drones, frame, low_battery_v)
        task = asyncio.create_task(show.live())
        try:
            yield show
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
