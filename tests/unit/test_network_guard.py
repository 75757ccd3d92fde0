"""The guard of this suite: an attempt to leave the process is an error."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable

import pydantic_ai.models
import pytest

HERE = ("127.0.0.1", 9)


@pytest.mark.parametrize(
    "attempt",
    [
        pytest.param(lambda plain: plain.connect(HERE), id="connect"),
        pytest.param(lambda plain: plain.bind(HERE), id="open a port"),
        pytest.param(lambda _: socket.getaddrinfo("localhost", 80), id="look up a name"),
        pytest.param(lambda _: asyncio.run(asyncio.open_connection(*HERE)), id="connect by asyncio"),
    ],
)
def test_nothing_leaves_the_process(attempt: Callable[[socket.socket], object]) -> None:
    with socket.socket() as plain, pytest.raises(AssertionError, match="offline suite"):
        attempt(plain)


def test_tests_ask_no_model_and_have_no_key() -> None:
    assert not pydantic_ai.models.ALLOW_MODEL_REQUESTS
    assert not [name for name in os.environ if name.endswith("_API_KEY")]
