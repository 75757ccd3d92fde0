"""A swarm with keys, in processes of its own: it forms; strangers hear nothing; a member cannot speak for another."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

from llm_flock.protocol.messages.codec import encode
from llm_flock.protocol.messages.message import Message
from llm_flock.runtime.network.config import NetworkConfig, SwarmConfig
from llm_flock.runtime.network.connection import open_link
from llm_flock.runtime.network.swarm import launched
from llm_flock.runtime.network.wire import Beacon, BeaconedMessage, pack
from llm_flock.trust.keys import make_keys


def saying(message: Message) -> bytes:
    beacon = Beacon(stamp=time.time(), position=(50.0, 50.0))
    return pack(BeaconedMessage(beacon=beacon, message=encode(message)))


async def fly(config: SwarmConfig) -> tuple[str, dict[str, int], list[bytes]]:
    heard: list[bytes] = []
    async with launched(config, absent=frozenset({3})) as swarm:
        open_network = swarm.config.network.model_copy(update={"keys": None})
        stranger = open_link(swarm.config.model_copy(update={"network": open_network}), 2, listen="tcp/127.0.0.1:0")
        member = open_link(swarm.config, 3, listen="tcp/127.0.0.1:0")
        try:
            stranger.listen("say", None, lambda _, payload: heard.append(payload))
            said = saying(Message(sender=1, sequence=0, neighbors=0))
            for _ in range(20):
                stranger.publish("say", 2, saying(Message(sender=2, sequence=0, neighbors=0)))
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
    assert rejected.get("wrong_topic", 0) > 0
    assert rejected.get("bad_signature", 0) == 0
