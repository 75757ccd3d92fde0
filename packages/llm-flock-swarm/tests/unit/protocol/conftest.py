"""A team with keys at rest, and a member of it that lies."""

from copy import deepcopy

import pytest
from signed_team import Liar, SignedTeam, line_up

from llm_flock.mission import Mission


@pytest.fixture(scope="session")
def at_rest() -> SignedTeam:
    made = SignedTeam(Mission(shape="circle", n_robots=5), line_up(5))
    made.fly(6)
    assert made.settled()
    return made


@pytest.fixture
def team(at_rest: SignedTeam) -> SignedTeam:
    return deepcopy(at_rest)


@pytest.fixture
def liar(team: SignedTeam) -> Liar:
    return Liar(team)
