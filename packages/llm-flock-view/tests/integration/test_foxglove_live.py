"""Foxglove's server as a client sees it: channels, late and slow clients, and no way to give orders."""

from __future__ import annotations

import pytest

pytest.importorskip("foxglove")


import json
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from foxglove_client import FoxgloveClient
from sample_records import FakeRun

from llm_flock.cli._extensions import Pacer
from llm_flock.errors import InputError
from llm_flock.record._schema import CHANNELS, Entry, RoundEnd
from llm_flock.runtime._api import run
from llm_flock_view._foxglove import server as foxglove_server
from llm_flock_view._foxglove.channels import ChannelWriter
from llm_flock_view._foxglove.server import FoxgloveServer


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Servers close without waiting for their clients."""
    monkeypatch.setattr(foxglove_server, "LINGER_S", 0.0)


@contextmanager
def server() -> Iterator[FoxgloveServer]:
    live = FoxgloveServer(0, 4)
    try:
        yield live
    finally:
        live.close()


def subscribe(live: FoxgloveServer, client: FoxgloveClient, *topics: str) -> None:
    """Return once the server knows it: what is written before is not for this client."""
    before = live._channels[topics[-1]].has_sinks()
    client.subscribe(*topics)
    client.listen_for(0.1)
    for _ in range(600):
        if before or all(live._channels[topic].has_sinks() for topic in topics):
            return
        client.listen_for(0.1)
    pytest.fail("the server does not know of the subscription")


def test_a_client_gets_the_channels_and_messages_of_the_run() -> None:
    flown = FakeRun(n=4, rounds=3)
    with server() as live, FoxgloveClient(live.url) as client:
        assert set(CHANNELS) <= set(client.channels)
        subscribe(live, client, "/state", "/scene", "/round", "/llm")
        flown.write(live)
        client.listen_until(lambda: len(client.of("/round")) == 4)
        assert "/robots/3/pose" in client.channels
        assert [state["round"] for state in client.of("/state")] == [0, 1, 2, 3]
        assert len(client.of("/llm")) == 12
        assert client.channels["/scene"]["schemaName"] == "foxglove.SceneUpdate"


def test_a_client_is_offered_no_orders_and_can_publish_nothing() -> None:
    with server() as live, FoxgloveClient(live.url) as client:
        assert live.url.startswith("ws://127.0.0.1:") and client.info["capabilities"] == []
        client.send(op="setParameters", parameters=[{"name": "kill_robot", "value": 1}], id="1")
        client.send(op="advertise", channels=[{"id": 1, "topic": "/state", "encoding": "json", "schemaName": ""}])
        client.listen_until(lambda: len(client.statuses) == 2)
        assert all("not support" in text for text in client.statuses), client.statuses


class EagerClient(FoxgloveClient):
    """Subscribes to a channel as soon as it hears of it, as Foxglove does."""

    def _take(self, data: str | bytes) -> None:
        super()._take(data)
        if isinstance(data, str) and json.loads(data)["op"] == "advertise":
            self.subscribe(*(one["topic"] for one in json.loads(data)["channels"]))


def test_early_subscriber_misses_no_robot_of_announced_team() -> None:
    with server() as live, EagerClient(live.url) as client:
        client.listen_for(0.3)
        assert "/robots/3/pose" in client.channels and not client.statuses


def test_late_client_gets_the_arena_and_the_last_scene() -> None:
    with server() as live:
        FakeRun(n=4, rounds=3).write(live)
        with FoxgloveClient(live.url) as client:
            client.subscribe("/arena", "/scene", "/mission", "/run", "/metrics")
            client.listen_until(
                lambda: {name for name, _ in client.messages} == {"/arena", "/scene", "/mission", "/run"}
            )
            assert client.of("/scene")[0]["entities"][0]["timestamp"]["sec"] == 3


def test_a_port_that_is_taken_is_refused_in_a_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=rf"port {port} cannot be used: .+; try --foxglove-port 0"):
            FoxgloveServer(port, 4)


def test_client_that_reads_nothing_delays_no_other() -> None:
    flown = FakeRun(n=4, rounds=2)
    with server() as live, FoxgloveClient(live.url) as good:
        bad = FoxgloveClient(live.url)
        subscribe(live, bad, "/round", "/llm")
        subscribe(live, good, "/round", "/llm")
        began = time.monotonic()
        flown.write(live)
        for number in range(3, 400):
            live.write(RoundEnd(round=number))
        assert time.monotonic() - began < 5.0
        good.listen_until(lambda: any(one["round"] == 399 for one in good.of("/round")))
        bad.socket.socket.shutdown(socket.SHUT_RDWR)
        bad.__exit__(None, None, None)
        live.write(RoundEnd(round=400))
        good.listen_until(lambda: any(one["round"] == 400 for one in good.of("/round")))


def test_a_run_is_held_to_its_pace() -> None:
    began = time.monotonic()
    result = run(n_robots=3, shape="triangle", model="geometry", rounds=4, stop_when_formed=False, steer=Pacer(20.0))
    assert result.summary.rounds == 4 and time.monotonic() - began >= 3 / 20


def test_a_fault_while_showing_does_not_end_the_run(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(_writer: ChannelWriter, _entry: Entry) -> None:
        raise KeyError("a fault of the display")

    monkeypatch.setattr(ChannelWriter, "messages", broken)
    with server() as live:
        result = run(n_robots=3, shape="triangle", model="geometry", sink=live)
        assert result.summary.formed
    assert [record.message for record in caplog.records] == ["Foxglove does not show the rest of the run"]
