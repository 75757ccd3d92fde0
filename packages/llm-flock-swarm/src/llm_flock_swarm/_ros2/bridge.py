"""Shows a running swarm in ROS 2, and takes missions and poses from there.

Poses and paths are published with each reading of the sensors, at most `ros_rate_hz` times a second.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager, closing
from typing import Any

from llm_flock.errors import InputError, MessageError
from llm_flock.mission import MISSION_FIELDS
from llm_flock.record import ASLEEP, DEAD, Guarded
from llm_flock.runtime import ROBOT
from llm_flock_swarm._network.config import SwarmConfig, endpoints
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.wire import WorldState
from llm_flock_swarm._ros2.drawing import ERROR, OK, WARN, TeamView, scaled, view_of
from llm_flock_swarm._ros2.graph import Graph
from llm_flock_swarm._ros2.nodes import TEAM_NODE, Finding, Refused, TeamNodes, live
from llm_flock_swarm._ros2.orders import (
    POSE_RATE,
    RATE,
    MissionGiver,
    check_frame,
    checked_position,
    mission_fields,
    places_fields,
)
from llm_flock_swarm._ros2.sensors import SensedBodies
from llm_flock_swarm._ros2.types import CLOCK, MAX_STAMP_NS, NS, POINTS, POSE, TEXT
from llm_flock_swarm._ros2.wire import Attachment

Show = Callable[[SwarmConfig, Observer], None]  # begins to show a swarm that an observer follows
ROUTER = "tcp/127.0.0.1:7447"  # where rmw_zenohd listens unless told otherwise
EARLY = 0.1  # share of a period by which a reading of the sensors may come early and still counts for it


def with_router(config: SwarmConfig) -> SwarmConfig:
    ros = config.ros2.model_copy(update={"router": config.ros2.router or ROUTER})
    return config.model_copy(update={"ros2": ros})


def check_router(config: SwarmConfig) -> str:
    """The router's endpoint; an InputError if the swarm itself uses it."""
    router = config.ros2.router or ROUTER
    own = {_plain(end) for end in (*endpoints(config.network.connect), *endpoints(config.network.listen))}
    if _plain(router) in own:
        allowed = f"another endpoint than that of the ROS 2 router, {router}: one of the two has to move"
        raise InputError("connect", config.network.connect, allowed)
    return router


def _plain(endpoint: str) -> str:
    return endpoint.rpartition("/")[2].replace("localhost", "127.0.0.1").replace("[::]", "127.0.0.1")


class Stamps:
    """The time in headers [ns]: the wall clock's, since the first reading, or what /clock says."""

    def __init__(self, *, sim: bool, follow: bool) -> None:
        self._sim, self._follow = sim, follow
        self._began_ns: int | None = None
        self._told_ns = 0

    def follow(self, stamp_ns: int) -> None:
        self._told_ns = min(max(0, stamp_ns), MAX_STAMP_NS)

    def of(self, wall_s: float) -> int:
        wall_ns = round(wall_s * NS)
        if not self._sim:
            return wall_ns
        if self._follow:
            return self._told_ns
        self._began_ns = wall_ns if self._began_ns is None else self._began_ns
        return max(0, wall_ns - self._began_ns)


class Bridge:
    """Shows one swarm. Give it every reading of the sensors, and run `live`."""

    def __init__(self, graph: Graph, config: SwarmConfig, observer: Observer) -> None:
        ros = config.ros2
        team = config.network.swarm
        sim, follow = ros.use_sim_time, ros.ros_poses
        self.refused = Refused()
        self.stamps = Stamps(sim=sim, follow=follow)
        self.nodes = TeamNodes(graph, ros, team, config.mission.n_robots, clock=sim and not follow)
        self.to_world = scaled(ros.unit_m or 1.0)
        self.unit_m = ros.unit_m or 1.0
        self.config, self.observer = config, observer
        self.bodies: SensedBodies | None = None
        self._graph = graph
        self._period_s = 1.0 / ros.ros_rate_hz
        self._due_s = 0.0
        self._stamp_ns: int | None = None
        self._giver: MissionGiver | None = None
        self._shown = 0
        if sim and follow:
            self.nodes.team.listens("/clock", CLOCK)
            graph.subscribe("/clock", CLOCK, self._take_clock, self.refused.take, rate=10_000.0)

    def take_missions(self) -> None:
        """Take missions from ROS; an InputError if the swarm has keys, and the operator's are not here."""
        self._giver = MissionGiver(self.config, self.observer)
        for topic, kind, handler in (("mission", TEXT, self._take_mission), ("places", POINTS, self._take_places)):
            name = f"{self.nodes.namespace}/{topic}"
            self.nodes.team.listens(name, kind)
            self._graph.subscribe(name, kind, handler, self.refused.take, rate=RATE)

    def take_poses(self, bodies: SensedBodies) -> None:
        self.bodies = bodies
        topic = self.config.ros2.pose_topic(self.config.network.swarm)
        head, _, tail = topic.partition(ROBOT)
        for robot, node in enumerate(self.nodes.robots):
            node.listens(f"{head}{robot}{tail}", POSE)

        def take(name: str, message: Any, attached: Attachment) -> None:
            number = name.removeprefix(head).removesuffix(tail)
            if not (number.isascii() and number.isdecimal()) or str(int(number[:9])) != number:
                raise MessageError("unknown_robot", f"{number!a} is no id")
            check_frame(message, self.nodes.frame)
            at = checked_position(message.pose.position)
            point = tuple(x / self.unit_m for x in at[: self.config.mission.dim])
            bodies.sense(int(number), point, attached)

        self._graph.subscribe(f"{head}$*{tail}", POSE, take, self.refused.take, rate=POSE_RATE)

    def _take_clock(self, _topic: str, message: Any, _attached: Attachment) -> None:
        self.stamps.follow(message.clock.sec * NS + message.clock.nanosec)

    def _take_mission(self, _topic: str, message: Any, _attached: Attachment) -> None:
        self._give(mission_fields(message.data))

    def _take_places(self, _topic: str, message: Any, _attached: Attachment) -> None:
        self._give(places_fields(message, self.nodes.frame, self.unit_m, self.config.mission.dim))

    def _give(self, fields: dict[str, Any]) -> None:
        assert self._giver is not None
        self._giver.give(fields)

    def frame(self, state: WorldState) -> None:
        """Show a reading of the sensors, if the next one is due."""
        now = time.monotonic()
        if now < self._due_s - EARLY * self._period_s:
            return
        self._due_s = max(self._due_s + self._period_s, now)
        stamp_ns = self._stamp_ns = self.stamps.of(state.stamp)
        self.nodes.show_clock(stamp_ns)
        self.nodes.show_poses([self.to_world(body.position) for body in state.bodies], stamp_ns)
        self._shown += 1
        if (view := self.view()) is not None:
            self.nodes.show_paths(view, stamp_ns)

    def view(self) -> TeamView | None:
        state, mission = self.observer.state(), self.observer.mission
        if state is None:
            return None
        return view_of(
            state,
            self.to_world,
            safe_m=mission.safe_distance * self.unit_m,
            downwash=mission.downwash,
            comm_range=mission.comm_range,
            places=self.observer.said.places,
        )

    async def live(self) -> None:
        """Show markers, state and diagnostics, until cancelled."""
        await live(self._show_rest, self.refused.counts)

    def _show_rest(self, diagnose: bool) -> None:
        stamp_ns = self.stamps.of(time.time())
        if (view := self.view()) is not None:
            self.nodes.show_markers(view, stamp_ns if self._stamp_ns is None else self._stamp_ns)
            self.nodes.show_state(self.state_json())
        if diagnose:
            self.nodes.show_diagnostics(self.findings(), stamp_ns)

    def state_json(self) -> dict[str, Any]:
        observer = self.observer
        mission = observer.mission
        state = observer.state()
        robots = [
            {
                "id": robot,
                "phase": None if state is None else state.phases[robot],
                "alive": robot in observer.alive,
                "plan": None if report is None else report.plan_id,
                "slot": None if report is None else report.slot,
                "origin": None if report is None else report.origin,
                "round": None if report is None else report.round,
                "neighbors": None if report is None else report.neighbors,
                "breakers": [] if report is None else list(report.breakers),
            }
            for robot in range(mission.n_robots)
            for report in [observer.reports.get(robot)]
        ]
        return {
            "swarm": self.config.network.swarm,
            "simulated_models": self.config.simulated,
            "formed": observer.formed_s is not None,
            "in_order": observer.in_order,
            "mission": mission.model_dump(mode="json", include=set(MISSION_FIELDS), exclude_none=True),
            "mission_digest": mission.digest,
            "ordered_at": observer.ordered_at,
            "robots": robots,
        }

    def findings(self) -> list[Finding]:
        observer = self.observer
        gone = observer.min_separation < observer.mission.safe_distance * (1 - 1e-6)
        team: dict[str, object] = {
            "robots": f"{len(observer.robots)} of {observer.mission.n_robots}",
            "smallest distance [m]": round(observer.min_separation * self.unit_m, 4),
            "model calls": observer.said.calls,
            "model calls without an answer": observer.said.calls_failed,
            "readings shown": self._shown,
        }
        summary = "formed" if observer.formed_s is not None else "forming"
        found: list[Finding] = [("team", ERROR if gone else OK, "too near" if gone else summary, team)]
        found.append(self.refused.finding("from ROS"))
        if self.bodies is not None:
            missing = self.bodies.missing
            summary = f"no fresh pose of {len(missing)} robots: all stand still" if missing else "all poses are fresh"
            values: dict[str, object] = {"missing": ", ".join(map(str, missing)), "late commands": self.bodies.late}
            found.append(("poses", ERROR if missing else OK, summary, values))
        state = observer.state()
        for robot in range(observer.mission.n_robots):
            phase = ASLEEP if state is None else state.phases[robot]
            report = observer.reports.get(robot)
            opened = () if report is None else report.breakers
            level = ERROR if phase == DEAD else WARN if opened or phase == ASLEEP else OK
            values = {} if report is None else {"round": report.round, "plan": report.plan_id, "slot": report.slot}
            found.append((f"robot_{robot}", level, phase, {**values, "open breakers": ", ".join(opened)}))
        return found

    def close(self) -> None:
        if self._giver is not None:
            self._giver.close()


@asynccontextmanager
async def showing(config: SwarmConfig) -> AsyncGenerator[Show | None]:
    """A function that shows a swarm in ROS 2; None where no router is configured."""
    if config.ros2.router is None:
        yield None
        return
    with closing(Graph(check_router(config), config.ros2.ros_domain)) as graph:
        graph.check_free(config.ros2.namespace(config.network.swarm), TEAM_NODE)
        bridges: list[Bridge] = []
        tasks: list[asyncio.Task[None]] = []

        def show(now: SwarmConfig, observer: Observer) -> None:
            bridge = Bridge(graph, now, observer)
            bridges.append(bridge)
            if now.ros2.ros_missions:
                bridge.take_missions()
            observer.on_world = Guarded("view in ROS 2", bridge.frame, observer.ended)
            tasks.append(asyncio.create_task(bridge.live()))

        try:
            yield show
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            for bridge in bridges:
                bridge.close()
