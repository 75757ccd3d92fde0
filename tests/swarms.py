"""Swarms of real processes for the end-to-end tests."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.swarm import Swarm, SwarmResult, launch_swarm


def swarm_config(robots: int = 5, *, seed: int = 1, **options: Any) -> SwarmConfig:
    """A team that starts in radio contact, with models that take a moment to answer, on a free port."""
    base = {"shape": "circle", "n_robots": robots, "model": "simulated:brisk", "seed": seed, "start": "connected"}
    return SwarmConfig.build({}, **{**base, "connect": "", "max_s": 90.0, **options})


def fly(
    config: SwarmConfig,
    meanwhile: Callable[[Swarm], Awaitable[None]] | None = None,
    *,
    until: Callable[[Observer], bool] | None = None,
    absent: frozenset[int] = frozenset(),
) -> SwarmResult:
    """Fly a mission and check that no process is left; `meanwhile` starts when the robots have begun."""
    pids: set[int] = set()

    async def all_of_it() -> SwarmResult:
        async with launch_swarm(config, absent=absent) as swarm:
            pids.update(swarm.pids.values())
            task = asyncio.create_task(_when_begun(swarm, meanwhile))
            stopped = await swarm.run(lambda o: task.done() and (until or formed)(o))
            pids.update(swarm.pids.values())
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            if not task.cancelled() and (error := task.exception()) is not None:
                raise error
            return swarm.result(stopped)

    result = asyncio.run(all_of_it())
    assert not living(pids), "processes were left behind"
    return result


async def _when_begun(swarm: Swarm, meanwhile: Callable[[Swarm], Awaitable[None]] | None) -> None:
    while swarm.observer.began_s is None:  # noqa: ASYNC110 - there is no event to wait for
        await asyncio.sleep(0.05)
    if meanwhile is not None:
        await meanwhile(swarm)


def formed(observer: Observer) -> bool:
    return observer.formed_s is not None


def living(pids: set[int]) -> set[int]:
    """The processes that still run; zombies do not count."""

    def lives(pid: int) -> bool:
        try:
            return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
        except (FileNotFoundError, ProcessLookupError):
            return False

    return {pid for pid in pids if lives(pid)}
