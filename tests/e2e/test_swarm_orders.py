"""Missions for a swarm with keys: accepted only from the holder of the operator's key."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from swarms import fly, formed, swarm_config

from llm_flock.members import OPERATOR, WATCHER
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.connection import open_link
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.swarm import Swarm
from llm_flock_swarm._network.wire import MissionOrder, pack
from llm_flock_swarm._trust.keys import make_keys

N = 3
CHANGE = ("--set", "shape=line", "--set", "center=45,55")


def operator_config(config: SwarmConfig, path: Path, keys: str | None) -> str:
    """A file for `llm-flock mission` with this swarm's endpoint; returns its path."""
    network = f'[network]\nconnect = "{config.network.connect}"\n' + (f'keys = "{keys}"\n' if keys else "")
    path.write_text(f'[mission]\nshape = "circle"\nn_robots = {N}\n\n{network}', encoding="utf-8")
    return str(path)


async def command(path: str) -> tuple[int | None, str]:
    """Run `llm-flock mission` with this file; returns its exit code and its output."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "llm_flock", "mission", *CHANGE, "--config", path),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    said, _ = await process.communicate()
    return process.returncode, said.decode()


async def publish(config: SwarmConfig, member: int) -> None:
    """A mission that a member of the team gives to every robot, without the operator's signature on it."""
    link = open_link(config, member, listen="tcp/127.0.0.1:0")
    try:
        for _ in range(20):
            for robot in range(N):
                link.publish("mission", robot, pack(MissionOrder(fields={"shape": "triangle"}, counter=2**31)))
            await asyncio.sleep(0.1)
    finally:
        link.close()


def test_only_the_operator_gives_missions(tmp_path: Path) -> None:
    keys = str(tmp_path / "team")
    make_keys(Path(keys), N)
    make_keys(tmp_path / "others", N)
    steps: list[str] = []

    async def give(swarm: Swarm) -> None:
        config, observer = swarm.config, swarm.observer
        while not formed(observer):  # noqa: ASYNC110 - there is no event
            await asyncio.sleep(0.1)
        without = operator_config(config, tmp_path / "without.toml", None)
        foreign = operator_config(config, tmp_path / "foreign.toml", str(tmp_path / "others"))
        for code, said in await asyncio.gather(command(without), command(foreign)):
            assert code == 2 and "no swarm answers there" in said, said
        await asyncio.gather(publish(config, WATCHER), publish(config, OPERATOR))
        rejected = sum(report.rejected.get("no_order", 0) for report in observer.reports.values())
        assert rejected > 0 and observer.mission.shape == "circle"
        assert {report.mission[0] for report in observer.reports.values()} == {0}
        steps.append("refused")
        code, said = await command(operator_config(config, tmp_path / "own.toml", keys))
        assert code == 0 and said.count("robot") == 2, said  # one more than may lie
        while observer.mission.shape != "line":  # noqa: ASYNC110 - there is no event
            await asyncio.sleep(0.1)
        steps.append("taken")

    def again(observer: Observer) -> bool:
        return formed(observer) and observer.mission.shape == "line"

    result = fly(swarm_config(N, keys=keys, max_s=180.0), give, until=again)
    assert result.formed and steps == ["refused", "taken"]
    assert result.min_separation > 3.0 - 1e-6
