"""A swarm with keys, in processes of its own: it forms; strangers hear nothing; a member cannot speak for another."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from pathlib import Path

from swarms import swarm_config

from llm_flock.message import Message, encode
from llm_flock_swarm._network.access import BURST_FACTOR
from llm_flock_swarm._network.config import NetworkConfig, SwarmConfig
from llm_flock_swarm._network.connection import open_link
from llm_flock_swarm._network.swarm import free_port, launch_swarm
from llm_flock_swarm._network.wire import Beacon, BeaconedMessage, pack
from llm_flock_swarm._trust.keys import make_keys
from llm_flock_swarm._zenoh import BURST_S


def saying(message: Message) -> bytes:
    beacon = Beacon(stamp=time.time(), position=(50.0, 50.0))
    return pack(BeaconedMessage(beacon=beacon, message=encode(message)))


async def fly(config: SwarmConfig) -> tuple[str, dict[str, int], list[bytes]]:
    heard: list[bytes] = []
    async with launch_swarm(config, absent=frozenset({3})) as swarm:
        open_network = swarm.config.network.model_copy(update={"keys": None})
        stranger = open_link(swarm.config.model_copy(update={"network": open_network}), 2, listen="tcp/127.0.0.1:0")
        member = open_link(swarm.config, 3, listen="tcp/127.0.0.1:0")
        try:
            stranger.listen("say", None, lambda _, payload: heard.append(payload))
            said = saying(Message(sender=1, sequence=0, degree=0))
            for _ in range(20):
                stranger.publish("say", 2, saying(Message(sender=2, sequence=0, degree=0)))
                member.publish("say", 1, said)
                member.publish("say", 3, said)
                await asyncio.sleep(0.1)
            stopped = await swarm.run()
            result = swarm.result(stopped)
        finally:
            stranger.close()
            member.close()
    assert result.min_separation is not None and result.min_separation >= config.mission.safe_distance
    return stopped, result.messages_rejected, heard


def test_a_swarm_with_keys_forms_and_hears_no_stranger(tmp_path: Path) -> None:
    make_keys(tmp_path / "team", 4)
    config = SwarmConfig.model_validate(
        {
            "mission": {"shape": "circle", "n_robots": 4},
            "network": NetworkConfig(connect="", keys=str(tmp_path / "team"), max_s=40.0, gather_s=1.0).model_dump(),
            "trial": {"out": None, "start": "connected", "seed": 3},
        }
    )
    stopped, rejected, heard = asyncio.run(fly(config))
    assert stopped == "formed"
    assert heard == []
    # What a member sends under the name of another is dropped by the network, before anybody opens it.
    assert rejected.get("wrong_topic", 0) == rejected.get("bad_signature", 0) == 0


async def three_members(
    config: SwarmConfig,
) -> tuple[list[tuple[int, bytes]], list[tuple[int, bool]], Counter[str], float]:
    """What member 0 hears while 1 is honest, and 2 sends and lives in the name of others, and floods in its own.

    The last of it is how long the flood and what was under way were heard [s].
    """
    heard: list[tuple[int, bytes]] = []
    alive: list[tuple[int, bool]] = []
    network = config.network.model_copy(update={"listen": config.network.connect, "connect": ""})
    first = open_link(config.model_copy(update={"network": network}), 0)
    others = [open_link(config, member, listen="tcp/127.0.0.1:0") for member in (1, 2)]
    honest, liar = others
    try:
        first.listen("say", None, lambda sender, payload: heard.append((sender, payload)))
        first.watch_alive(5, lambda number, is_alive: alive.append((number, is_alive)))
        await asyncio.sleep(1.0)
        honest.declare_alive(1)
        liar.declare_alive(3)
        began = time.monotonic()
        for k in range(2000):
            if k % 200 == 0:
                honest.publish("say", 1, b"honest")
                await asyncio.sleep(0.1)
            liar.publish("say", 1, b"forged")
            liar.publish("say", 2, b"flood")
        liar.close()  # ends all that it has declared
        await asyncio.sleep(0.5)
        return heard, alive, first.traffic.refused, time.monotonic() - began
    finally:
        for link in (first, *others):
            link.close()


def test_member_cannot_speak_or_live_for_others_nor_flood_them(tmp_path: Path) -> None:
    make_keys(tmp_path / "team", 4)
    config = swarm_config(4, keys=str(tmp_path / "team"), connect=f"tcp/127.0.0.1:{free_port()}")
    heard, alive, refused, lasted = asyncio.run(three_members(config))
    assert heard.count((1, b"honest")) == 10 and (1, b"forged") not in heard
    assert alive == [(1, True)]
    # As many as at once, and as many as in that time.
    assert heard.count((2, b"flood")) <= (BURST_S + lasted) * BURST_FACTOR / config.network.gossip_s
    assert refused["too_many"] > heard.count((2, b"flood")) > 0
