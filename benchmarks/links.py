"""Ten stand-ins, in a process of their own, through the real cflib: `python -m benchmarks links`."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator

from llm_flock.testing._robots import wait_until
from llm_flock_flight._cli.stand_ins import grid
from llm_flock_flight._crazyflie import CrazyflieRobot

DRONES = 10
ROUNDS = 30
PORT = 29850


@contextlib.contextmanager
def stand_ins() -> Iterator[list[str]]:
    """Stand-ins that run meanwhile; their URIs."""
    command = [sys.executable, "-m", "llm_flock", "stand-ins", str(DRONES), "--port", str(PORT), "--spacing", "0.6"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield [process.stdout.readline().split()[0] for _ in range(DRONES)]
        finally:
            process.terminate()


async def measure() -> None:
    """One connection of all, and way-points for all at once."""
    homes = grid(DRONES, 0.6)
    with stand_ins() as uris:
        team = [CrazyflieRobot(f"cf{k}", uri) for k, uri in enumerate(uris)]
        began = time.perf_counter()
        await asyncio.gather(*(robot.connect(5.0) for robot in team))
        connected = time.perf_counter() - began
        await wait_until(lambda: all(robot.state().settled for robot in team), 5.0, "all settled")
        ready = time.perf_counter() - began
        await asyncio.gather(*(robot.arm() for robot in team))
        await asyncio.gather(*(robot.take_off(0.5, 1.0) for robot in team))
        await asyncio.sleep(1.1)
        times: list[float] = []
        for number in range(ROUNDS):
            y = 0.05 if number % 2 else 0.0
            began = time.perf_counter()
            await asyncio.gather(
                *(robot.go_to((home[0], home[1] + y, 0.5), 0.4) for robot, home in zip(team, homes, strict=True))
            )
            times.append(1000 * (time.perf_counter() - began))
            await asyncio.sleep(0.45)
        await asyncio.gather(*(robot.land(0.0, 1.0) for robot in team))
        await asyncio.sleep(1.1)
        await asyncio.gather(*(robot.close() for robot in team))
    print(f"{DRONES} stand-ins: connected after {connected:.2f} s, estimators settled after {ready:.2f} s   bar 5")
    print(
        f"  go_to to all, every one confirmed: median {statistics.median(times):.1f} ms, "
        f"largest of {ROUNDS} {max(times):.1f} ms   bar 20",
        flush=True,
    )


def links() -> None:
    """Bar 4: connect and preflight in under 5 s, go_to to all in under 20 ms; twice."""
    logging.disable(logging.WARNING)
    for _ in range(2):
        asyncio.run(measure())
