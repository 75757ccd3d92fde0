"""The team in ROS 2's graph: a node for each robot and one for the team, and their topics."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from llm_flock.errors import MessageError
from llm_flock.printable import one_line
from llm_flock.runtime import Ros2Config
from llm_flock_swarm._network.receiving import count_refusals
from llm_flock_swarm._ros2 import drawing, types
from llm_flock_swarm._ros2.drawing import LONGEST, OK, WARN, MarkerDrawer, PoseEncoder, Position, TeamView
from llm_flock_swarm._ros2.graph import Graph
from llm_flock_swarm._ros2.types import CLOCK, DIAGNOSTICS, MARKERS, PATH, POSE, TEXT, TRANSFORMS, message_class

TEAM_NODE = "team"  # name of the team's node
TOGETHER = 8  # poses that leave together: one by one they cost more, all together the first ones wait for the last
MARKERS_S = 0.5  # time between two drawings, and two states of the protocol [s]
DIAGNOSTICS_S = 1.0  # time between two diagnostics [s]
Finding = tuple[str, int, str, Mapping[str, object]]  # one line of diagnostics: name, level, message and values


class Refused:
    """Counts input from ROS that was not used, by reason, and keeps the last words about each. Any thread may add."""

    def __init__(self) -> None:
        self.counts = Counter[str]()
        self._last: dict[str, str] = {}
        self._told = 0

    def take(self, topic: str, error: MessageError) -> None:
        self.counts[error.reason] += 1
        self._last[error.reason] = f"{topic}: {error.detail}"

    def finding(self, name: str) -> Finding:
        """The line of diagnostics: a warning where something came since the last one."""
        counts, last = dict(self.counts), dict(self._last)
        total = sum(counts.values())
        new, self._told = total - self._told, total
        values: dict[str, object] = {f"refused {reason}": count for reason, count in sorted(counts.items())}
        values |= {f"last {reason}": one_line(summary, LONGEST) for reason, summary in sorted(last.items())}
        summary = f"{new} messages refused" if new else "nothing refused of late"
        return name, WARN if new else OK, summary, values


async def live(show: Callable[[bool], None], faults: Counter[str]) -> None:
    """Show what changes slowly until cancelled: calls `show` with whether diagnostics are due; counts its errors."""
    diagnosed_s = 0.0
    while True:
        await asyncio.sleep(MARKERS_S)
        with count_refusals(faults):  # an error in the drawing ends no flight
            now = time.monotonic()
            diagnose = now - diagnosed_s >= DIAGNOSTICS_S
            show(diagnose)
            diagnosed_s = now if diagnose else diagnosed_s


class TeamNodes:
    """Nodes of a team: `/flock/robot_3` has the node `robot` and its topics, `/flock` the node `team`."""

    def __init__(self, graph: Graph, config: Ros2Config, team: str, n_robots: int, *, clock: bool) -> None:
        space = self.namespace = config.namespace(team)
        self.frame = config.ros_frame
        spaces = [f"{space}/robot_{robot}" for robot in range(n_robots)]
        self.frames = [name[1:] for name in spaces]
        self.team = graph.node(space, TEAM_NODE)
        self.robots = [graph.node(name, "robot") for name in spaces]
        both = list(zip(self.robots, spaces, strict=True))
        self._poses = [
            node.publisher(f"{name}/pose", POSE, express=robot % TOGETHER == 0 or robot == n_robots - 1)
            for robot, (node, name) in enumerate(both)
        ]
        self._paths = [node.publisher(f"{name}/path", PATH) for node, name in both]
        self._transforms = self.team.publisher("/tf", TRANSFORMS)
        self._markers = self.team.publisher(f"{space}/markers", MARKERS)
        self._state = self.team.publisher(f"{space}/state", TEXT)
        self._diagnostics = self.team.publisher("/diagnostics", DIAGNOSTICS)
        self._clock = self.team.publisher("/clock", CLOCK) if clock else None
        self._drawer, self._encoder = MarkerDrawer(self.frame), PoseEncoder(self.frame)

    def show_clock(self, stamp_ns: int) -> None:
        """Publish the simulation's time, where it is this bridge that does so."""
        if self._clock is not None:
            self._clock.publish(message_class(CLOCK)(clock=types.time(stamp_ns)))

    def show_poses(self, positions: Sequence[Position], stamp_ns: int) -> None:
        for publisher, at in zip(self._poses, positions, strict=True):
            publisher.send(self._encoder.encode(at, stamp_ns))
        self._transforms.publish(drawing.transforms(positions, self.frames, stamp_ns, self.frame))

    def show_paths(self, view: TeamView, stamp_ns: int) -> None:
        for robot, publisher in enumerate(self._paths):
            publisher.publish(drawing.path(view, robot, stamp_ns, self.frame))

    def show_markers(self, view: TeamView, stamp_ns: int) -> None:
        self._markers.publish(self._drawer.draw(view, stamp_ns))

    def show_state(self, content: Mapping[str, Any]) -> None:
        self._state.publish(drawing.text(content))

    def show_diagnostics(self, found: Sequence[Finding], stamp_ns: int) -> None:
        """Publish lines of diagnostics, under the team's name."""
        named = [(f"{self.frame_of_team}: {name}", level, summary, values) for name, level, summary, values in found]
        self._diagnostics.publish(drawing.diagnostics(named, stamp_ns, self.frame_of_team))

    @property
    def frame_of_team(self) -> str:
        return self.namespace[1:]
