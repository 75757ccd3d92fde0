"""The guard of this suite: an attempt to leave the process is an error."""

from __future__ import annotations

import asyncio
import os
import socket

import pydantic_ai.models
import pytest


def test_no_connection_is_opened() -> None:
    with socket.socket() as plain, pytest.raises(AssertionError, match="offline suite"):
        plain.connect(("127.0.0.1", 9))


def test_no_port_is_opened() -> None:
    with socket.socket() as plain, pytest.raises(AssertionError, match="offline suite"):
        plain.bind(("127.0.0.1", 0))


def test_no_name_is_looked_up() -> None:
    with pytest.raises(AssertionError, match="offline suite"):
        socket.getaddrinfo("localhost", 80)


def test_no_connection_is_opened_by_asyncio() -> None:
    with pytest.raises(AssertionError, match="offline suite"):
        asyncio.run(asyncio.wait_for(asyncio.open_connection("127.0.0.1", 9), timeout=5))


def test_tests_ask_no_model_and_have_no_key() -> None:
    assert not pydantic_ai.models.ALLOW_MODEL_REQUESTS
    assert not [name for name in os.environ if name.endswith("_API_KEY")]
