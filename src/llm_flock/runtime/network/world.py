"""The world: one process with everybody's body and sensors. It knows no plan, no goal and no mind.

On real robots there is no such process: each has its own body, and sensors or a motion-capture system.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from llm_flock.errors import MessageError
from llm_flock.robots.simulated import check_start, draw_start
from llm_flock.runtime.network.bodies import Bodies
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.joining import open_link
from llm_flock.runtime.network.process import until_stopped
from llm_flock.runtime.network.wire import Command, Frame, pack, unpack
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.transport.seal import WORLD


async def run_world(config: SwarmConfig, on_ready: Callable[[], object] | None = None) -> None:
    """Fly the bodies until the process is told to end.

    Args:
        config: the swarm; `start` and `seed` say where the bodies are at first.
        on_ready: told when the endpoint is open.

    Raises:
        InputError: the endpoint cannot be opened, or there is no room for the starts.
    """
    mission, network, trial = config.mission, config.network, config.trial
    given = trial.start_positions
    rng = stream(trial.seed, Stream.START)
    start = draw_start(mission, trial.start, rng) if given is None else check_start(mission, given)
    bodies = Bodies(start, speed=config.speed, period_s=network.control_s, lag_s=network.lag_s, now=time.time())
    link = open_link(config, WORLD)

    def obey(sender: int, payload: bytes) -> None:
        try:
            order = unpack(Command, payload)
        except MessageError as error:
            link.traffic.refused[error.reason] += 1
            return
        if 0 <= sender < mission.n_robots:
            bodies.command(sender, order, time.time())

    async def show() -> None:
        while True:
            now = time.time()
            bodies.advance(now)
            frame = Frame(stamp=now, closest=bodies.closest(), bodies=bodies.frame(), late=bodies.late)
            link.publish("frame", WORLD, pack(frame))
            await asyncio.sleep(network.frame_s)

    try:
        link.listen("command", None, obey)
        link.be_alive(WORLD)
        if on_ready is not None:
            on_ready()
        await until_stopped(show())
    finally:
        link.close()
