"""Connects a process to a swarm's network: open, or secured with the keys of the team."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from llm_flock.errors import InputError
from llm_flock.extras import require
from llm_flock_swarm._network.access import rates, topics_of_members
from llm_flock_swarm._network.accusations import contexts
from llm_flock_swarm._network.config import SwarmConfig, endpoints
from llm_flock_swarm._zenoh import MAX_SEALED_BYTES, PlainSeal, Seal, ZenohLink, access_control, open_session, settings

if TYPE_CHECKING:
    from llm_flock_swarm._trust.keys import Keyring


def load_keys(config: SwarmConfig, member: int) -> Keyring | None:
    """A member's keys; None where the swarm uses none. InputError: missing, damaged, or of another team size."""
    folder = config.network.keys
    if folder is None:
        return None
    require("network", "--keys")
    from llm_flock_swarm._trust.keys import load_keyring

    keys = load_keyring(Path(folder), member)
    if keys.robots != config.mission.n_robots:
        raise InputError("keys", folder, f"keys of {config.mission.n_robots} robots, not of {keys.robots}")
    return keys.for_flight(config.network.swarm)


def open_link(config: SwarmConfig, member: int, listen: str | None = None) -> ZenohLink:
    """Join as a robot, or as WORLD, OPERATOR or WATCHER; call in a running event loop.

    With keys every endpoint uses TLS, however it is written. `listen` replaces the configuration's own endpoints.
    """
    network, keys = config.network, load_keys(config, member)
    listens, connects = endpoints(network.listen if listen is None else listen), endpoints(network.connect)
    security: dict[str, Any] | None = None
    seal: Seal = PlainSeal(member)
    if keys is not None and network.keys is not None:
        from llm_flock_swarm._trust.envelope import Envelope
        from llm_flock_swarm._trust.session import next_session
        from llm_flock_swarm._trust.tls import tls_config

        folder = Path(network.keys)
        listens, connects = ([end.replace("tcp/", "tls/", 1) for end in ends] for ends in (listens, connects))
        security = {**tls_config(folder, member), **access_control(topics_of_members(config))}
        seal = Envelope(keys, next_session(folder, member, time.time()), max_payload=MAX_SEALED_BYTES)
    session = open_session(settings(listen=listens, connect=connects, lease_s=network.lease_s, security=security))
    loop = asyncio.get_running_loop()
    return ZenohLink(
        session, swarm=network.swarm, own=member, seal=seal, loop=loop, rates=rates(config), contexts=contexts(config)
    )
