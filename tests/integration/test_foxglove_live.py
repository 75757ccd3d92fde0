"""Foxglove's server as a client sees it: channels, who may connect, who may order, and what the orders do."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from foxglove_client import FoxgloveClient
from sample_records import FakeRun
from websockets.exceptions import ConnectionClosed, InvalidStatus

from llm_flock.cli.foxglove import Pacer, SwarmOrders
from llm_flock.errors import InputError
from llm_flock.foxglove import server as foxglove_server
from llm_flock.foxglove import services
from llm_flock.foxglove.channels import ChannelWriter
from llm_flock.foxglove.gate import MESSAGE_BYTES, MOST_WAITING, MessageLengths, _is_foreign
from llm_flock.foxglove.server import FoxgloveServer, serving
from llm_flock.foxglove.services import KILL, MISSION, Orders
from llm_flock.listening import open_port
from llm_flock.record.schema import CHANNELS, Entry, RoundEnd
from llm_flock.runtime.api import run
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.network import watch
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.connection import mission_order
from llm_flock.runtime.orders import RunOrders
from llm_flock.trust.keys import make_keys

TOKEN = "the-token-of-a-test"
LOCAL = "127.0.0.1"
EVIL = "https://evil.example"


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Servers close without waiting for their clients, and clients without the token are refused soon."""
    monkeypatch.setattr(foxglove_server, "LINGER_S", 0.0)
    monkeypatch.setattr(services, "SHOWN_S", 0.1)


class Given:
    """Orders that were given, by kind."""

    def __init__(self) -> None:
        self.missions: list[dict[str, object]] = []
        self.kills: list[int] = []

    def mission(self, fields: dict[str, object]) -> int:
        if fields.get("shape") == "nonsense":
            raise InputError("shape", "nonsense", "a shape")
        self.missions.append(fields)
        return 2

    @property
    def orders(self) -> Orders:
        return Orders(mission=self.mission, kill=self.kills.append)


@contextmanager
def server(token: str | None = None, orders: Orders | None = None) -> Iterator[FoxgloveServer]:
    with serving(open_port(LOCAL, 0, token, "foxglove_"), orders or Orders(), 4) as found:
        yield found


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


def status_of(url: str, origin: str | None = None) -> int:
    with pytest.raises(InvalidStatus) as refused:
        FoxgloveClient(url, origin)
    return refused.value.response.status_code


def test_a_client_gets_the_channels_and_messages_of_the_run() -> None:
    flown = FakeRun(n=4, rounds=3)
    with server() as live, FoxgloveClient(live.url) as client:
        assert client.info["capabilities"] == [] and not client.services
        assert set(CHANNELS) <= set(client.channels)
        subscribe(live, client, "/state", "/scene", "/round", "/llm")
        flown.write(live)
        client.listen_until(lambda: len(client.of("/round")) == 4)
        assert "/robots/3/pose" in client.channels
        assert [state["round"] for state in client.of("/state")] == [0, 1, 2, 3]
        assert len(client.of("/llm")) == 12
        assert client.channels["/scene"]["schemaName"] == "foxglove.SceneUpdate"


class EagerClient(FoxgloveClient):
    """Subscribes to a channel as soon as it hears of it, as Foxglove does."""

    def _take(self, data: str | bytes) -> None:
        super()._take(data)
        if isinstance(data, str) and json.loads(data)["op"] == "advertise":
            self.subscribe(*(one["topic"] for one in json.loads(data)["channels"]))


def test_who_subscribes_at_once_misses_no_robot() -> None:
    with server() as live, EagerClient(live.url) as client:
        assert "/robots/3/pose" in client.channels, "known before the run begins"
        for more in range(5, 35):  # robots that come later
            live._add_channels(more)
            client.listen_until(lambda more=more: f"/robots/{more - 1}/pose" in client.channels)
        client.listen_for(0.3)
        assert not client.statuses


def test_who_comes_late_gets_the_arena_and_the_last_scene() -> None:
    with server() as live:
        FakeRun(n=4, rounds=3).write(live)
        with FoxgloveClient(live.url) as client:
            client.subscribe("/arena", "/scene", "/mission", "/run", "/metrics")
            client.listen_until(
                lambda: {name for name, _ in client.messages} == {"/arena", "/scene", "/mission", "/run"}
            )
            assert client.of("/scene")[0]["entities"][0]["timestamp"]["sec"] == 3


def test_with_a_token_nobody_connects_without_it() -> None:
    with server(TOKEN, Given().orders) as live:
        bare = live.url.partition("?")[0]
        for url in (bare, f"{bare}?token=guess", f"{bare}?Token={TOKEN}", f"{bare}?token="):
            assert status_of(url) == 401
        with FoxgloveClient(live.url, EVIL) as client:
            assert set(client.info["capabilities"]) >= {"services", "parameters"}


def test_pages_of_other_sites_are_refused_without_a_token() -> None:
    with server() as live:
        for origin in (EVIL, "null", "http://127.0.0.1.evil.example", "https://app.foxglove.dev.evil.example"):
            assert status_of(live.url, origin) == 403
        for origin in (None, "https://app.foxglove.dev", "http://localhost:8080", "file://"):
            FoxgloveClient(live.url, origin).__exit__(None, None, None)
    assert _is_foreign("http://[broken") and _is_foreign("https://")


def frame(length: int, *, last: bool = True, kind: int = 1) -> bytes:
    """A frame of a client's message: zeros, masked with zeros."""
    size = bytes((length,)) if length < 126 else b"\x7e" + length.to_bytes(2) if length < 1 << 16 else b""
    size = size or b"\x7f" + length.to_bytes(8)
    return bytes((kind | 0x80 * last, size[0] | 0x80)) + size[1:] + bytes(4 + length)


@pytest.mark.parametrize("cut", [1, 7, 1000, 1 << 20])
def test_messages_are_measured_over_their_fragments(cut: int) -> None:
    def short(*frames: bytes) -> bool:
        stream, lengths = b"".join(frames), MessageLengths()
        return all(lengths.take(stream[at : at + cut]) for at in range(0, len(stream), cut))

    half = frame(MESSAGE_BYTES // 2, last=False), frame(MESSAGE_BYTES // 2, kind=0)
    assert short(*half, frame(5), *half, frame(70_000), frame(0))
    assert short(half[0], frame(100, kind=9), half[1]), "a ping between two fragments is none of them"
    assert not short(half[0], half[0][:1] + half[1][1:], frame(1, kind=0))
    assert not short(b"\x81\xff" + (1 << 40).to_bytes(8) + bytes(4)), "what it is going to be"


def test_a_message_without_an_end_disconnects_its_client() -> None:
    with server() as live, FoxgloveClient(live.url) as client, FoxgloveClient(live.url) as other:
        with suppress(ConnectionClosed):  # while it still sends
            client.socket.send(["x" * 65536] * 64)
        with pytest.raises(ConnectionClosed):
            client.listen_for(10.0)
        FakeRun(n=4, rounds=0).write(live)
        other.listen_for(0.1)


def test_silent_connections_are_few() -> None:
    """They took every file descriptor of the process, and one traceback for each stood on the terminal."""
    with server() as live, ExitStack() as stack:
        parts = urlsplit(live.url)
        address = str(parts.hostname), int(parts.port or 0)
        silent = [stack.enter_context(socket.create_connection(address)) for _ in range(MOST_WAITING + 20)]
        closed = 0
        for one in silent[MOST_WAITING:]:
            one.settimeout(5.0)
            with suppress(ConnectionResetError):
                assert one.recv(1) == b""
            closed += 1
        assert closed == 20
        silent[0].close()
        time.sleep(0.2)
        FoxgloveClient(live.url).__exit__(None, None, None)


def test_no_orders_are_offered_without_a_token() -> None:
    given = Given()
    with server(None, given.orders) as live, FoxgloveClient(live.url) as client:
        assert client.info["capabilities"] == []
        client.send(op="setParameters", parameters=[{"name": "kill_robot", "value": 1}], id="1")
        client.send(op="setParameters", parameters=[{"name": "pass", "value": ""}], id="2")
        client.listen_for(0.2)
        assert not client.services and not given.kills and not given.missions


def test_services_and_parameters_give_orders_with_the_token() -> None:
    given = Given()
    with server(TOKEN, given.orders) as live, FoxgloveClient(live.url) as client:
        FakeRun(n=4, rounds=0).write(live)
        client.listen_until(lambda: len(client.services) == 2)
        assert client.call(MISSION, {"shape": "square"}) == {"robot": 2}
        assert client.call(KILL, {"robot": 3}) == {"robot": 3}
        for service, request, says in (
            (MISSION, {"shape": "nonsense"}, "a shape"),
            (MISSION, {"n_robots": 2}, "shape, center, spacing"),
            (MISSION, {}, "at least one"),
            (KILL, {"robot": "3"}, "whole number"),
            (KILL, {"robot": True}, "whole number"),
            (KILL, [3], "JSON object"),
            (KILL, {"robot": 3, "x": "y" * 70_000}, "JSON object"),
        ):
            assert says in client.call(service, request)
        client.send(op="setParameters", parameters=[{"name": "mission/spacing", "value": 7.5}], id="1")
        client.listen_until(lambda: client.parameters.get("mission/spacing") == 7.5)
        client.send(op="setParameters", parameters=[{"name": "kill_robot", "value": -4}], id="2")
        client.listen_until(lambda: bool(client.statuses))
        client.send(op="getParameters", parameterNames=[], id="3")
        client.listen_until(lambda: "mission/center" in client.parameters)
        assert given.missions == [{"shape": "square"}, {"spacing": 7.5}] and given.kills == [3]
        assert client.parameters["mission/shape"] == "square" and client.parameters["kill_robot"] == 3
        assert "pass" not in client.parameters


def test_who_goes_around_the_gate_gives_no_orders() -> None:
    given = Given()
    with server(TOKEN, given.orders) as live:
        host, port = live._gate._server
        with FoxgloveClient(f"ws://{host}:{port}/") as client:
            client.listen_until(lambda: len(client.services) == 2)
            client.send(op="setParameters", parameters=[{"name": "pass", "value": TOKEN}], id="1")
            client.send(op="setParameters", parameters=[{"name": "kill_robot", "value": 1}], id="2")
            assert "connected with the token" in client.call(MISSION, {"shape": "square"})
    assert not given.kills and not given.missions


def test_a_port_that_is_taken_and_a_short_token_are_refused_in_a_line() -> None:
    with socket.create_server((LOCAL, 0)) as taken, pytest.raises(InputError, match=r"is taken; try --foxglove-port 0"):
        open_port(LOCAL, taken.getsockname()[1], None, "foxglove_")
    with pytest.raises(InputError, match="foxglove_token: expected 16 characters") as refused:
        open_port(LOCAL, 0, "short", "foxglove_")
    assert "short" not in str(refused.value)


def test_what_is_no_websocket_gets_an_answer_or_the_door() -> None:
    with server() as live:
        port = int(live.url.rpartition(":")[2].strip("/"))
        for sent, says in (
            (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"426"),
            (b"POST / HTTP/1.1\r\nUpgrade: websocket\r\n\r\n", b"426"),
            (b"GET / HTTP/1.1\r\n" + b"x" * 40_000, b"431"),
        ):
            with socket.create_connection((LOCAL, port), timeout=5) as client:
                client.sendall(sent)
                assert client.recv(100).startswith(b"HTTP/1.1 " + says)
        with FoxgloveClient(live.url) as client:
            assert client.info


def test_a_client_that_reads_nothing_holds_nobody_up() -> None:
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


def test_orders_take_effect_in_the_next_round_of_a_run() -> None:
    config = RunConfig.build({}, shape="circle", n_robots=5, model="geometry", rounds=40, stop_when_formed=False)
    orders = RunOrders(config)
    with server(TOKEN, Orders(mission=orders.change, kill=orders.kill)) as live:
        done = threading.Thread(target=lambda: run(config=config, sink=live, steer=Pacer(50.0, orders)))
        with FoxgloveClient(live.url) as client:
            client.subscribe("/mission", "/protocol", "/summary")
            client.listen_until(lambda: len(client.services) == 2)
            done.start()
            client.listen_until(lambda: bool(client.of("/mission")))
            assert client.call(KILL, {"robot": 4}) == {"robot": 4}
            assert "no robot 7" in client.call(KILL, {"robot": 7})
            assert client.call(MISSION, {"shape": "line"}) == {"robot": 0}
            assert "only the command line" in client.call(MISSION, {"shape": "points:/etc/passwd"})
            client.listen_until(lambda: bool(client.of("/summary")))
        done.join()
        assert [one["mission"]["shape"] for one in client.of("/mission")] == ["circle", "line"]
        assert [one["robot"] for one in client.of("/protocol") if one["kind"] == "killed"] == [4]


def test_orders_keep_what_was_drawn_at_random() -> None:
    config = RunConfig.build({}, n_robots=6, kill_random=2, seed=3)
    before, orders = config.schedule(), RunOrders(config)
    free = next(robot for robot in range(6) if all(robot not in died for died in before.kills.values()))
    orders.kill(free)
    after = orders._schedule
    assert {(when, one) for when, died in after.kills.items() for one in died} == {
        (1, free),
        *((when, one) for when, died in before.kills.items() for one in died),
    }


def test_an_order_to_a_swarm_with_keys_needs_the_operators_key_and_repeats_earlier_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_keys(tmp_path / "team", 4)
    config = SwarmConfig.load(None, n_robots=4, keys=str(tmp_path / "team"))
    sent: list[dict[str, object]] = []

    async def give(_config: SwarmConfig, fields: dict[str, object], _robot: int | None) -> list[int]:
        mission_order(config, fields, 1)
        sent.append(fields)
        return [1]

    monkeypatch.setattr(watch, "give_mission", give)
    orders = SwarmOrders(config, launched=False)
    assert orders.mission({"shape": "line"}) == orders.mission({"spacing": 12}) == 1
    assert sent[-1] == {"shape": "line", "spacing": 12}
    with pytest.raises(InputError, match="started"):
        SwarmOrders(config, launched=True).mission({"shape": "line"})
    (tmp_path / "team" / "operator").rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="keys"):
        orders.mission({"shape": "square"})
    assert len(sent) == 2


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
