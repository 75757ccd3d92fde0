"""Mutual TLS over zenoh: two members of a team find each other; who has no certificate of it gets no session."""

from __future__ import annotations

import datetime
import json
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh
from cryptography.hazmat.primitives.asymmetric import ec

from llm_flock.errors import InputError
from llm_flock_swarm._trust.keys import make_keys
from llm_flock_swarm._trust.tls import certificate, tls_config


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("keys") / "team"
    make_keys(path, 2)
    return path


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def session(protocol: str, port: int, settings: Mapping[str, Any], *, listens: bool) -> Iterator[Any]:
    config = zenoh.Config()
    end = json.dumps([f"{protocol}/127.0.0.1:{port}"])
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", end if listens else "[]")
    config.insert_json5("connect/endpoints", "[]" if listens else end)
    config.insert_json5("connect/timeout_ms", "1500")
    config.insert_json5("connect/exit_on_failure", "false")
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    opened = zenoh.open(config)
    try:
        yield opened
    finally:
        opened.close()


def hears(listener: Any, speaker: Any, wait_s: float) -> bool:
    """Whether anything that one session says gets to the other in time."""
    got: list[bytes] = []
    subscriber = listener.declare_subscriber("flock/**", lambda sample: got.append(bytes(sample.payload)))
    ends = time.monotonic() + wait_s
    while not got and time.monotonic() < ends:
        speaker.put("flock/1", b"hello")
        time.sleep(0.05)
    subscriber.undeclare()
    return bool(got)


def test_members_talk_and_strangers_do_not(folder: Path, tmp_path: Path) -> None:
    make_keys(tmp_path / "others", 2)
    port = free_port()
    without = {"root_ca_certificate": str(folder / "ca.pem"), "verify_name_on_connect": False}
    with session("tls", port, tls_config(folder, 0), listens=True) as listener:
        with session("tls", port, tls_config(folder, 1), listens=False) as member:
            assert hears(listener, member, 5.0)
        for stranger in (
            tls_config(tmp_path / "others", 1),
            {"transport/link/tls": without},
        ):
            with session("tls", port, stranger, listens=False) as speaker:
                assert not hears(listener, speaker, 1.0)
                assert not hears(speaker, listener, 1.0)
                assert not list(speaker.info.peers_zid())
        with session("tcp", port, {}, listens=False) as plain:
            assert not hears(listener, plain, 1.0)


def test_a_member_does_not_connect_to_a_false_team(folder: Path, tmp_path: Path) -> None:
    make_keys(tmp_path / "others", 2)
    port = free_port()
    with (
        session("tls", port, tls_config(tmp_path / "others", 0), listens=True) as trap,
        session("tls", port, tls_config(folder, 1), listens=False) as member,
    ):
        assert not hears(trap, member, 1.0)


def test_missing_and_open_files_are_named(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ca\.pem"):
        tls_config(tmp_path, 0)
    with pytest.raises(InputError, match="robot-9"):
        tls_config(folder, 9)
    make_keys(tmp_path / "open", 1)
    (tmp_path / "open" / "robot-0" / "tls.key").chmod(0o644)
    with pytest.raises(InputError, match="chmod 600"):
        tls_config(tmp_path / "open", 0)


def test_a_certificate_that_has_ended_is_named(tmp_path: Path) -> None:
    """Otherwise no robot would connect, and nobody would say why."""
    make_keys(tmp_path / "old", 1)
    key, ends = ec.generate_private_key(ec.SECP256R1()), datetime.datetime.now(datetime.UTC)
    (tmp_path / "old" / "robot-0" / "tls.pem").write_bytes(certificate("robot-0", key, "team", key, ends))
    with pytest.raises(InputError, match=r"tls\.pem.*one that has not ended, as this one did on 2"):
        tls_config(tmp_path / "old", 0)
