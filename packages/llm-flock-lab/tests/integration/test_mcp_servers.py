"""`llm-flock mcp` as a process: over standard input and output, and over HTTP on this machine."""

import asyncio
import json
import os
import re
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcp")
import httpx2
from mcp import Client, StdioServerParameters
from mcp.client.streamable_http import streamable_http_client
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.errors import InputError

COMMAND = ["-m", "llm_flock", "mcp"]
FLIGHT: dict[str, Any] = {"shape": "triangle", "n_robots": 3}


async def flown_and_read(client: Client) -> dict[str, Any]:
    """Fly a mission and read its record by a client."""
    flown = await client.call_tool("fly_mission", FLIGHT)
    assert not flown.is_error, flown.content
    record = json.loads(flown.content[0].text)["record"]  # type: ignore[union-attr]
    summary = await client.call_tool("read_summary", {"record": record})
    refused = await client.call_tool("fly_mission", {"model": "openai:gpt-5"})
    assert refused.is_error and not summary.is_error and summary.structured_content is not None
    return summary.structured_content


def test_agents_talk_to_a_process(tmp_path: Path) -> None:
    start = StdioServerParameters(
        command=sys.executable, args=[*COMMAND, "--runs", str(tmp_path)], env=dict(os.environ)
    )

    async def main() -> dict[str, Any]:
        async with Client(start) as client:
            assert (
                client.server_info is not None
                and client.server_info.name == "llm-flock"
                and "simulated" in (client.instructions or "")
            )
            return await flown_and_read(client)

    assert asyncio.run(main())["result"]["formed"]
    assert len(list(tmp_path.iterdir())) == 1


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Generator[tuple[str, str]]:
    """The address of a server, and what to say to it."""
    command = [sys.executable, *COMMAND, "--http", "0", "--runs", str(tmp_path_factory.mktemp("runs"))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address, words = process.stdout.readline().strip(), process.stdout.readline().strip()
            yield address, words.removeprefix("Authorization: ")
        finally:
            process.terminate()


@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_agents_on_this_machine_show_a_token(server: tuple[str, str], mode: str) -> None:
    """By the protocol's present form, and by the handshake of older clients."""
    address, words = server
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/mcp", address) and re.fullmatch(r"Bearer \S{32}", words)

    async def main() -> dict[str, Any]:
        http = httpx2.AsyncClient(headers={"Authorization": words}, timeout=60.0)
        async with http, Client(streamable_http_client(address, http_client=http), mode=mode) as client:
            return await flown_and_read(client)

    assert asyncio.run(main())["result"]["formed"]


def test_others_are_refused(server: tuple[str, str]) -> None:
    address, words = server
    question = {"jsonrpc": "2.0", "id": 1, "method": "tools/list"}
    good = {"Content-Type": "application/json", "Accept": "application/json, text/event-stream"}
    cases = [
        ({}, 401),
        ({"Authorization": "Bearer "}, 401),
        ({"Authorization": words[:-1]}, 401),
        ({"Authorization": words.removeprefix("Bearer ")}, 401),
        ({"Authorization": "Bearer \u00fc"}, 401),
        ({"Authorization": words, "Host": "flock.example:80"}, 421),
        ({"Authorization": words, "Origin": "http://flock.example"}, 403),
    ]
    for headers, status in cases:
        sent = {name: value.encode("latin-1").decode("latin-1") for name, value in {**good, **headers}.items()}
        request = urllib.request.Request(address, json.dumps(question).encode(), sent)
        with pytest.raises(urllib.error.HTTPError, match=str(status)) as caught:
            urllib.request.urlopen(request, timeout=30)
        assert words.removeprefix("Bearer ") not in caught.value.read().decode()
        caught.value.close()


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("--runs no-such-folder", "--runs no-such-folder: expected a folder that is there"),
        ("--http 0 --token short", "token: expected 16 characters or more"),
    ],
)
def test_bad_options_are_named(line: str, says: str) -> None:
    result = CliRunner().invoke(app, ["mcp", *line.split()])
    assert isinstance(result.exception, InputError) and says in str(result.exception)
