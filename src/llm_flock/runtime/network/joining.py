"""How a process joins a swarm's network: open to everybody, or with the keys of its team."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from llm_flock.errors import InputError
from llm_flock.protocol.messages.message import MissionStamp
from llm_flock.protocol.messages.mission_update import MISSION_FIELDS
from llm_flock.protocol.signed.certificates import mission_statement
from llm_flock.runtime.network.config import SwarmConfig, endpoints
from llm_flock.runtime.network.wire import Order
from llm_flock.transport.seal import OPERATOR, PlainSeal
from llm_flock.transport.zenoh import MAX_SEALED_BYTES, Link, open_session, settings

if TYPE_CHECKING:
    from llm_flock.trust.keys import Keyring


def load_keys(config: SwarmConfig, member: int) -> Keyring | None:
    """A member's keys, where the swarm has any.

    Raises:
        InputError: they are missing, damaged, or of another team size.
    """
    folder = config.network.keys
    if folder is None:
        return None
    try:
        from llm_flock.trust.keys import load_keyring
    except ImportError:
        raise InputError("keys", folder, "possible with the extra: pip install 'llm-flock[network]'") from None
    keys = load_keyring(Path(folder), member)
    if keys.robots != config.mission.n_robots:
        raise InputError("keys", folder, f"keys of {config.mission.n_robots} robots, not of {keys.robots}")
    return keys


def open_link(config: SwarmConfig, member: int, listen: str | None = None) -> Link:
    """Join as a member; with keys all endpoints are of TLS, however they are written.

    Args:
        config: the swarm.
        member: a robot's id, or WORLD, OPERATOR or WATCHER.
        listen: own endpoints, if not those of the configuration.

    Raises:
        InputError: the keys are of no use, or an endpoint cannot be opened.
    """
    network, keys, loop = config.network, load_keys(config, member), asyncio.get_running_loop()
    listens, connects = endpoints(network.listen if listen is None else listen), endpoints(network.connect)
    if keys is None or network.keys is None:
        session = open_session(settings(listen=listens, connect=connects, lease_s=network.lease_s))
        return Link(session, swarm=network.swarm, own=member, seal=PlainSeal(member), loop=loop)
    from llm_flock.trust.envelope import Envelope
    from llm_flock.trust.keys import next_session
    from llm_flock.trust.tls import tls_config

    folder = Path(network.keys)
    secure = [end.replace("tcp/", "tls/", 1) for end in listens], [end.replace("tcp/", "tls/", 1) for end in connects]
    security = tls_config(folder, member)
    session = open_session(settings(listen=secure[0], connect=secure[1], lease_s=network.lease_s, security=security))
    envelope = Envelope(keys, next_session(folder, member, time.time()), max_payload=MAX_SEALED_BYTES)
    return Link(session, swarm=network.swarm, own=member, seal=envelope, loop=loop)


def ordered(config: SwarmConfig, fields: dict[str, Any]) -> Order:
    """An order to change these fields of the mission.

    With keys it is signed, and about the whole mission: that of the configuration with these fields changed. The Unix
    time is its counter, so a later order is a higher one.
    """
    keys = load_keys(config, OPERATOR)
    if keys is None:
        return Order(fields=fields)
    mission, counter = config.mission.change(**fields), int(time.time())
    whole = mission.model_dump(mode="json", include=set(MISSION_FIELDS))
    signature = keys.sign(mission_statement(MissionStamp(counter, mission.digest)))
    return Order(fields=whole, counter=counter, signature=signature)
