"""Teams in space whose rotors need more distance above each other than side by side: nobody flies below anybody."""

from itertools import pairwise

import numpy as np
import pytest
from effort import cases
from hypothesis import given
from hypothesis import strategies as st

import llm_flock
from llm_flock.arrays import flattened, separation
from llm_flock.mission import MAX_DOWNWASH, Mission

LIARS = "simulated:random@0.2,overshoot@0.2,collapse@0.2,malformed@0.2"


def nearest(flown: llm_flock.RunResult, downwash: float) -> float:
    """The smallest distance of two robots in a flight: by samples, and by nothing of the code that kept it."""
    low, pairs = np.inf, np.triu_indices(flown.positions.shape[1], 1)
    for before, after in pairwise(flown.positions):
        for share in np.linspace(0.0, 1.0, 21):
            now = before + share * (after - before)
            apart = now[pairs[0]] - now[pairs[1]]
            low = min(low, np.sqrt(apart[:, 0] ** 2 + apart[:, 1] ** 2 + (apart[:, 2] / downwash) ** 2).min())
    return float(low)


def fly(seed: int, downwash: float, judged: float) -> tuple[float, float]:
    """The smallest distances that the judge and the run find, with liars, deaths and lost messages."""
    space = {"center": (15.0,) * 3, "arena": ((0.0,) * 3, (30.0,) * 3)}
    mission = Mission(shape="sphere", n_robots=8, downwash=downwash, sense_range=12 + 3 * downwash, **space)
    faults = {"kill_random": 2, "loss": 0.2, "rounds": 20, "shield": True}
    flown = llm_flock.run(mission, model=LIARS, seed=seed, **faults)
    return nearest(flown, judged), flown.summary.min_separation or 0.0


@cases(4)
@given(seed=st.integers(0, 2**32), downwash=st.sampled_from([2.0, 3.0]))
def test_liars_and_the_dead_never_share_an_ellipsoid(seed: int, downwash: float) -> None:
    seen, told = fly(seed, downwash, downwash)
    assert seen >= told - 1e-9 and told >= 3.0 - 1e-6


def test_spheres_alone_let_robots_into_each_others_downwash() -> None:
    assert any(fly(seed, 1.0, 3.0)[0] < 3.0 for seed in range(4))


@given(st.lists(st.tuples(*[st.floats(-1e3, 1e3)] * 3), min_size=2, max_size=2), st.floats(1, MAX_DOWNWASH))
def test_no_step_is_longer_by_the_norm(points: list[tuple[float, float, float]], downwash: float) -> None:
    one, other = points
    apart = separation(one, other, downwash)
    assert apart <= separation(one, other, 1.0) + 1e-9
    assert apart == pytest.approx(np.linalg.norm(np.diff(flattened(points, downwash), axis=0)), abs=1e-9)
