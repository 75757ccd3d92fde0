"""Runs a bridge as a process: beside a running swarm, or as the sensors of a swarm whose bodies ROS moves."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path

from llm_flock.members import WORLD
from llm_flock.record import Guarded, RecordSink, SummaryMessage
from llm_flock.runtime import TrialProgress, finite
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.connection import open_link
from llm_flock_swarm._network.process import until_stopped
from llm_flock_swarm._network.receiving import receive
from llm_flock_swarm._network.swarm import Swarm, SwarmResult, run_swarm, world_config
from llm_flock_swarm._network.watch import look, observer_of, recording, run_watch
from llm_flock_swarm._network.wire import Command, RobotReport, WorldState, pack
from llm_flock_swarm._ros2 import drawing
from llm_flock_swarm._ros2.bridge import Bridge, check_router, showing
from llm_flock_swarm._ros2.graph import Graph
from llm_flock_swarm._ros2.nodes import TEAM_NODE
from llm_flock_swarm._ros2.sensors import SensedBodies
from llm_flock_swarm._ros2.types import POSE
from llm_flock_swarm._zenoh import ZenohLink


async def run_shown_swarm(
    config: SwarmConfig,
    on_row: Callable[[TrialProgress], None] | None = None,
    sink: RecordSink | None = None,
    on_launch: Callable[[], object] = lambda: None,
) -> SwarmResult:
    """As `llm_flock_swarm._network.swarm.run_swarm`, shown in ROS 2 where a router is configured."""
    async with showing(config) as show:

        def begin(swarm: Swarm) -> None:
            if show is not None:
                show(swarm.config, swarm.observer)

        return await run_swarm(config, on_row, sink, begin, on_launch)


async def run_bridge(
    config: SwarmConfig,
    record: Path | None,
    on_row: Callable[[TrialProgress], None] | None = None,
    sink: RecordSink | None = None,
) -> None:
    """Show a swarm in ROS 2 until the process is stopped; with a path write a record. A sink takes every entry too."""
    if config.ros2.ros_poses:
        await _run_sensors(config, record, on_row)
        return
    async with showing(config) as show:
        await run_watch(config, record, on_row, sink, show)


async def _run_sensors(
    config: SwarmConfig, record: Path | None, on_row: Callable[[TrialProgress], None] | None
) -> None:
    """In place of the world: the swarm's sensors and bodies are in ROS."""
    network = config.network
    with ExitStack() as stack:
        graph = stack.enter_context(closing(Graph(check_router(config), config.ros2.ros_domain)))
        graph.check_free(config.ros2.namespace(config.network.swarm), TEAM_NODE)
        writer = stack.enter_context(recording(config, record))
        link = stack.enter_context(closing(open_link(world_config(config), WORLD)))
        observer = observer_of(config, WORLD, writer, on_row)
        reach = config.speed * (network.control_s + network.lag_s)
        mission, n_robots = config.mission, config.mission.n_robots
        bodies = SensedBodies(
            n_robots,
            speed=config.speed,
            reach=reach,
            lag_s=network.lag_s,
            clock=time.time,
            downwash=mission.downwash,
        )
        bridge = stack.enter_context(closing(Bridge(graph, config, observer)))
        bridge.take_poses(bodies)
        if config.ros2.ros_missions:
            bridge.take_missions()
        observer.on_world = Guarded("view in ROS 2", bridge.frame, observer.ended)
        spaces = [f"{bridge.nodes.namespace}/robot_{robot}/set_point" for robot in range(n_robots)]
        publishers = [node.publisher(name, POSE) for node, name in zip(bridge.nodes.robots, spaces, strict=True)]

        def show_set_point(robot: int) -> None:
            if (point := bodies.set_point(robot)) is not None:
                stamp_ns = bridge.stamps.of(time.time())
                publishers[robot].publish(drawing.pose(bridge.to_world(point), stamp_ns, bridge.nodes.frame))

        def obey(sender: int, order: Command) -> None:
            if 0 <= sender < n_robots and bodies.command(sender, order):
                show_set_point(sender)

        async def repeat() -> None:
            """Publish all set-points again: a subscriber may have come late."""
            while True:
                await asyncio.sleep(1.0 / config.ros2.ros_rate_hz)
                for robot in range(n_robots):
                    show_set_point(robot)

        receive(link, "command", Command, obey)
        receive(link, "report", RobotReport, observer.report)
        link.watch_alive(config.mission.n_robots, observer.comes_or_goes)
        link.declare_alive(WORLD)

        async def live() -> None:
            async with asyncio.TaskGroup() as group:
                sense = _sense(link, bodies, Guarded("observer", observer.world, observer.ended), network.frame_s)
                for work in (sense, repeat(), bridge.live(), look(observer, alone=False)):
                    group.create_task(work)

        await until_stopped(live())
        result = {"formed": observer.formed_s is not None, "min_separation": finite(observer.min_separation)}
        writer.write(SummaryMessage(result=result))


async def _sense(link: ZenohLink, bodies: SensedBodies, observe: Callable[[WorldState], None], frame_s: float) -> None:
    """Send the swarm its sensors' readings while they hold every robot."""
    while True:
        reading = bodies.reading()
        if reading is not None:
            link.publish("frame", WORLD, pack(reading))
            observe(reading)
        await asyncio.sleep(frame_s)
