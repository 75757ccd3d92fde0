"""The deadman of a flight whose poses come from ROS 2."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from zenoh_router import router

from llm_flock_swarm._network.swarm import free_port
from llm_flock_swarm._ros2 import drawing
from llm_flock_swarm._ros2.graph import Graph
from llm_flock_swarm._ros2.types import POSE

ROOT = Path(__file__).parents[4]

PARENT = """
import asyncio, sys
from flights import flight_config
from llm_flock_flight._flight.heartbeat import HeartbeatSender

async def main():
    config = flight_config(
        deadman=True, robot="blind_drones:blind", deadman_s=1.0, reach_s=2.0,
        pose_source="ros2", router=sys.argv[1], ros_pose_topic="/mocap/d_{id}/pose",
    )
    async with HeartbeatSender(config, lambda: {1}):
        print("flying", flush=True)
        await asyncio.sleep(60)

asyncio.run(main())
"""


async def show(endpoint: str) -> None:
    """Publish where drone 1 is, until cancelled."""
    with closing(Graph(endpoint, 0)) as graph:
        out = graph.node("/mocap", "cameras").publisher("/mocap/d_1/pose", POSE)
        turn = 0
        while True:
            turn += 1
            out.publish(drawing.pose((1.2, -1.2, 1e-6 * turn), time.time_ns(), "world"))
            await asyncio.sleep(0.05)


@contextmanager
def flight(endpoint: str) -> Generator[subprocess.Popen[str]]:
    """A flight process with a drone in the air."""
    env = {**os.environ, "PYTHONPATH": "tests"}
    command = [sys.executable, "-c", PARENT, endpoint]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env, cwd=ROOT
    ) as parent:
        try:
            yield parent
        finally:
            parent.kill()


def said_after_its_end(parent: subprocess.Popen[str]) -> str:
    """What the deadman says when the flight process is killed."""
    assert parent.stdout is not None and parent.stderr is not None
    assert parent.stdout.readline() == "flying\n"
    parent.send_signal(signal.SIGKILL)
    return parent.stderr.read()


def test_the_deadman_takes_poses_from_ros_and_lands_by_them() -> None:
    async def whole(endpoint: str) -> str:
        showing = asyncio.create_task(show(endpoint))
        with flight(endpoint) as parent:
            said = await asyncio.to_thread(said_after_its_end, parent)
        showing.cancel()
        await asyncio.gather(showing, return_exceptions=True)
        return said

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with router(endpoint):
        said = asyncio.run(whole(endpoint))
    assert "d1: landed" in said and "no positions from outside" not in said
