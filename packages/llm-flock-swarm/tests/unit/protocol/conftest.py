"""A team with keys at rest, and a member of it that lies."""

import pytest
from signed_team import Liar, SignedTeam, line_up

from llm_flock.mission import Mission


@pytest.fixture
def team() -> SignedTeam:
    made = SignedTeam(Mission(shape="circle", n_robots=5), line_up(5))
    made.fly(6)
    assert made.settled()
    return made


@pytest.fixture
def liar(team: SignedTeam) -> Liar:
    return Liar(team)
