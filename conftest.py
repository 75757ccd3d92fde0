"""Rules for every test: no real network, no real model, no key from the environment.

Unit and property tests may not open any connection; the other suites may talk to this machine only.
"""

from __future__ import annotations

import gc
import ipaddress
import os
import signal
import socket
import sys
from collections.abc import Generator, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from clock import running_at
from effort import EFFORT
from hypothesis import settings
from skipped_waits import skip_waits

SUITES = ("unit", "property", "integration", "e2e")
OFFLINE_SUITES = ("unit", "property")

# A busy machine must not turn a slow example into a failure; a failing example prints how to repeat it.
settings.register_profile("default", deadline=None, print_blob=True, max_examples=max(1, round(50 * EFFORT)))
settings.load_profile("default")


# A shell starts jobs in the background with Ctrl-C ignored, and the processes that tests interrupt would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """Spare the collector what lives to the end anyway, modules and tests: a tenth of the time of all tests.

    And let it look at what is left less often, which spares as much again.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 50)


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """Trace no line of a test with `no_cover`: in a worker, pytest-cov pauses the inner one of its two tracers only.

    What it computed is forgotten, so that functions with a memory are run, and traced, by the tests after it as well.
    """
    if item.get_closest_marker("no_cover") is None:
        return (yield)
    tracer = sys.gettrace()
    sys.settrace(None)
    try:
        return (yield)
    finally:
        sys.settrace(tracer)
        for name in [name for name in sys.modules if name.startswith("llm_flock.protocol")]:
            for thing in vars(sys.modules[name]).values():
                getattr(thing, "cache_clear", int)()


class NetworkBlocked(AssertionError):
    """A test tried to open a connection that its suite may not open."""


def is_loopback(host: Any) -> bool:
    """Whether the host (a name, an address, or None for a wildcard) is this machine."""
    if isinstance(host, bytes):
        host = host.decode()
    if host in (None, "", "localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def suite_of(path: Path) -> str:
    """The suite of a test: the folder below the last `tests` of its path."""
    return next((part for part in reversed(path.parts) if part in SUITES), "")


@pytest.fixture(autouse=True)
def no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hide the keys of real providers, so that a test gives the same result everywhere."""
    for name in list(os.environ):
        if name.endswith("_API_KEY"):
            monkeypatch.delenv(name)


@pytest.fixture(autouse=True)
def guarded_network(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make connections fail: all of them in the offline suites, those that leave this machine in the others."""
    offline = suite_of(request.path) in OFFLINE_SUITES
    if models := sys.modules.get("pydantic_ai.models"):
        monkeypatch.setattr(models, "ALLOW_MODEL_REQUESTS", not offline)

    def check(what: str, family: int, host: Any) -> None:
        if offline:
            raise NetworkBlocked(f"{what} {host!r} in an offline suite: move the test to tests/integration")
        if family in (socket.AF_INET, socket.AF_INET6) and not is_loopback(host):
            raise NetworkBlocked(f"{what} {host!r}: tests reach this machine only")

    def guard(method: str) -> None:
        original = getattr(socket.socket, method)

        def guarded(self: socket.socket, *args: Any) -> Any:
            # The address is the last argument of connect, connect_ex, bind and sendto alike.
            address = args[-1]
            check(method, self.family, address[0] if isinstance(address, tuple) else address)
            return original(self, *args)

        monkeypatch.setattr(socket.socket, method, guarded)

    for method in ("connect", "connect_ex", "bind", "sendto"):
        guard(method)

    resolve = socket.getaddrinfo

    def guarded_resolve(host: Any, *args: Any, **kwargs: Any) -> Any:
        check("getaddrinfo", socket.AF_INET, host)
        return resolve(host, *args, **kwargs)

    monkeypatch.setattr(socket, "getaddrinfo", guarded_resolve)


@pytest.fixture
def skipped_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the time in which the test's event loop only waits; `skipped_waits.py` says where that is allowed."""
    skip_waits(monkeypatch)


@pytest.fixture(autouse=True)
def clock(request: pytest.FixtureRequest) -> Iterator[None]:
    """Run a test at `pytest.mark.clock(rate)` times real time; `clock.py` says where that is allowed."""
    mark = request.node.get_closest_marker("clock")
    with running_at(mark.args[0]) if mark is not None else nullcontext():
        yield


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache folder for one test module, removed afterwards."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield folder
