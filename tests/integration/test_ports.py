"""Ports and endpoints are tried before anything starts or is shown; addresses are ready to be opened."""

from __future__ import annotations

import asyncio
import socket
import time
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import pytest
from command_line import flock
from zenoh_router import listener, router

from llm_flock.errors import InputError
from llm_flock_swarm._network.swarm import free_port
from llm_flock_swarm._ros2.graph import Graph
from llm_flock_swarm._ros2.types import TEXT
from llm_flock_swarm._zenoh import MAX_SEALED_BYTES, open_session, settings
from llm_flock_view._viewer.server import listen


@pytest.mark.parametrize("endpoint", ["nowhere", "tcp/127.0.0.1:1"])
def test_silent_router_is_refused_before_a_process_starts(
    endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def refuse(*words: str, **_: Any) -> None:
        raise AssertionError(f"started {words}")

    monkeypatch.setattr("asyncio.create_subprocess_exec", refuse)
    monkeypatch.setattr("llm_flock_swarm._ros2.graph.WAIT_MS", 200)
    done = flock("swarm", "--ros2", endpoint, "--robots", "3", "--shape", "triangle", cwd=tmp_path, check=False)
    assert done.returncode == 2 and done.stderr.startswith(f"error: --ros2 {endpoint}: expected an endpoint such as ")
    assert done.stderr.count("\n") == 1, "nothing is said to start"


def test_peer_in_place_of_the_router_is_refused(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    values = {"mode": "peer", "listen/endpoints": [endpoint], "scouting/multicast/enabled": False}
    with closing(open_session(values)):
        done = flock("ros2", "--ros2", endpoint, "--connect", "tcp/127.0.0.1:1", cwd=tmp_path, check=False)
    assert done.returncode == 2 and "a zenoh peer answers there, no router" in done.stderr


def test_bridge_nodes_and_topics_are_tokens_at_its_router() -> None:
    async def tokens(endpoint: str) -> list[str]:
        with closing(Graph(endpoint, 0)) as graph, listener(endpoint) as other:
            graph.node("/flock", "team").publisher("/flock/state", TEXT)
            found: list[str] = []
            for _ in range(50):
                replies = await asyncio.to_thread(other.liveliness().get, "@ros2_lv/0/**")
                found = [str(reply.ok.key_expr) for reply in replies]
                if len(found) == 2:
                    break
                await asyncio.sleep(0.02)
            return found

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with router(endpoint):
        node, topic = sorted(asyncio.run(tokens(endpoint)), key=len)
    assert node.endswith("/NN/%/%flock/team") and "/MP/%/%flock/team/%flock%state/std_msgs::msg" in topic


def test_a_token_is_escaped_in_the_address() -> None:
    token = "a b&c=d#e/f?g%20+ü"
    address = listen("127.0.0.1", 0, token)
    try:
        url = address.url
        assert url.isascii() and " " not in url and dict(parse_qsl(urlsplit(url).query)) == {"token": token}
    finally:
        address.sock.close()


def test_every_viewer_has_a_token_of_its_own() -> None:
    first, second = (listen("127.0.0.1", 0, None) for _ in range(2))
    with closing(first.sock), closing(second.sock):
        assert first.token != second.token and len(first.token) >= 32 and first.token in first.url


def test_a_port_that_is_taken_is_named_with_a_way_out() -> None:
    first = listen("127.0.0.1", 0, None)
    with closing(first.sock), pytest.raises(InputError, match=rf"^port {first.port} is taken; try --port 0"):
        listen("127.0.0.1", first.port, None)


def test_viewer_shows_no_address_if_the_foxglove_port_is_taken(tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        view = ("view", "--no-browser", "--port", "0", "--foxglove", "--foxglove-port", port)
        done = flock(*view, cwd=tmp_path, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"error: port {port} cannot be used: ") and done.stderr.count("\n") == 1


def test_a_message_far_too_large_is_never_put_together() -> None:
    """Else a member could make every other process take 1 GiB, before its size is seen."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    sizes: list[int] = []
    receiver = open_session(settings(listen=[endpoint], connect=[], lease_s=5.0))
    sender = open_session(settings(listen=[], connect=[endpoint], lease_s=5.0))
    with closing(receiver), closing(sender):
        subscriber = receiver.declare_subscriber("a/**", lambda sample: sizes.append(len(sample.payload)))
        deadline = time.monotonic() + 20.0
        while 1 not in sizes and time.monotonic() < deadline:
            sender.put("a/b", b"x")
            time.sleep(0.05)
        sender.put("a/b", bytes(16 * MAX_SEALED_BYTES))
        while 2 not in sizes and time.monotonic() < deadline:
            sender.put("a/b", b"xx")
            time.sleep(0.05)
        subscriber.undeclare()
    assert set(sizes) == {1, 2}
