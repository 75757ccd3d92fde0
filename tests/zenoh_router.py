"""A zenoh router in a process of its own, as rmw_zenohd is one: multicast off, gossip on."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import zenoh

ROUTER = """
import json, sys, time, zenoh
config = zenoh.Config()
for path, value in {"mode": "router", "listen/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}.items():
    config.insert_json5(path, json.dumps(value))
session = zenoh.open(config)
print("ready", flush=True)
time.sleep(600)
"""


def _started(endpoint: str) -> subprocess.Popen[str]:
    for _ in range(50):  # the port of a router that was killed may be busy for a moment
        process = subprocess.Popen([sys.executable, "-c", ROUTER, endpoint], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        if process.stdout.readline() == "ready\n":
            return process
        process.wait()
        process.stdout.close()
        time.sleep(0.2)
    raise AssertionError(f"no router at {endpoint}")


@contextmanager
def router(endpoint: str) -> Generator[subprocess.Popen[str]]:
    """A router that listens there."""
    process = _started(endpoint)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


@contextmanager
def listener(endpoint: str, mode: str = "client") -> Generator[Any]:
    """A plain session at the router."""
    config: Any = zenoh.Config()
    config.insert_json5("mode", f'"{mode}"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    try:
        yield session
    finally:
        session.close()
