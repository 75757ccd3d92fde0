"""A team with keys at rest, and a member of it that lies; tests that are not traced for coverage."""

import sys
from collections.abc import Generator

import pytest
from signed_team import Liar, SignedTeam, line_up

from llm_flock.mission import Mission


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


@pytest.fixture
def team() -> SignedTeam:
    made = SignedTeam(Mission(shape="circle", n_robots=5), line_up(5))
    made.fly(6)
    assert made.settled()
    return made


@pytest.fixture
def liar(team: SignedTeam) -> Liar:
    return Liar(team)
