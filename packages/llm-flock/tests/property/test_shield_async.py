"""Bodies that keep no common beat, see each other late and inexactly, and some of which decide seldom."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llm_flock.arrays import Point
from llm_flock.metrics import min_separation, segment_separation
from llm_flock.protocol._motion.shield_async import Sighting, project_async

SAFE, SPEED = 3.0, 2.0


@dataclass
class Body:
    """A point that flies from `origin` to `end` between two control times."""

    origin: np.ndarray
    end: np.ndarray
    began_s: float
    until_s: float
    seldom: bool
    past: list[tuple[float, float, np.ndarray, np.ndarray]] = field(default_factory=list)

    def at(self, time_s: float) -> np.ndarray:
        share = (time_s - self.began_s) / (self.until_s - self.began_s)
        return self.origin + min(1.0, share) * (self.end - self.origin)

    def seen(self, time_s: float) -> np.ndarray:
        """Where it was."""
        for began, until, origin, end in reversed([*self.past, (self.began_s, self.until_s, self.origin, self.end)]):
            if began <= time_s:
                return origin + min(1.0, (time_s - began) / (until - began)) * (end - origin)
        return self.past[0][2] if self.past else self.origin


def fly(
    seed: int,
    n: int,
    *,
    oldest_s: float,
    error: float,
    seldom: bool,
    crowd: float,
    events: int = 250,
    downwash: float = 1.0,
) -> float:
    """Random schedules; the smallest separation of any pair at any time, in space with a downwash."""
    sides = np.array([crowd, crowd] if downwash == 1.0 else [crowd, crowd, 1.5 * crowd])
    squeeze = np.array([1.0, 1.0, 1.0 / downwash])[: len(sides)]
    rng = np.random.default_rng(seed)
    places: list[np.ndarray] = []
    while len(places) < n:
        draw = rng.uniform(0, sides)
        if all(np.linalg.norm((draw - other) * squeeze) >= SAFE for other in places):
            places.append(draw)
    bodies = [Body(p, p, 0.0, float(rng.uniform(0.01, 1.0)), seldom and bool(rng.random() < 0.4)) for p in places]
    goal = sides / 2
    now, smallest = 0.0, min_separation(np.array(places), downwash)
    for _ in range(events):
        k = min(range(n), key=lambda i: bodies[i].until_s)
        then = bodies[k].until_s
        before, after = ([b.at(at) for b in bodies] for at in (now, then))
        smallest = min(smallest, segment_separation(before, after, downwash=downwash))
        now, body = then, bodies[k]
        here = body.at(now)
        period_s = float(rng.uniform(1.0, 3.0) if body.seldom else rng.uniform(0.05, 0.5))

        def off(x: np.ndarray) -> np.ndarray:
            angle = rng.uniform(0, 2 * math.pi)
            return x + error * np.array([math.cos(angle), math.sin(angle), 0.0])[: len(x)]

        sightings: list[Sighting] = []
        for j, other in enumerate(bodies):
            if j != k:
                age_s = float(min(now, rng.uniform(0, oldest_s)))
                sightings.append(Sighting(position=tuple(off(other.seen(now - age_s)).tolist()), age_s=age_s))
        wish = goal if rng.random() < 0.6 else rng.uniform(-5, sides + 5)
        own = off(here)
        target = project_async(
            tuple(own.tolist()),
            tuple(wish.tolist()),
            sightings,
            safe_distance=SAFE,
            speed=SPEED,
            period_s=period_s,
            error=error,
            downwash=downwash,
        )
        move = np.array(target) - own
        assert np.linalg.norm(move) <= SPEED * period_s + 1e-6
        body.past.append((body.began_s, body.until_s, body.origin, body.end))
        body.origin, body.end, body.began_s, body.until_s = here, here + move, now, now + period_s
    return smallest


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(2, 8), oldest_s=st.floats(0, 1.0), error=st.floats(0, 0.2))
def test_no_schedule_or_stale_reading_brings_bodies_too_near(seed: int, n: int, oldest_s: float, error: float) -> None:
    assert fly(seed, n, oldest_s=oldest_s, error=error, seldom=False, crowd=16.0) >= SAFE - 1e-6


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(2, 7), oldest_s=st.floats(0, 1.0), error=st.floats(0, 0.1))
def test_bodies_that_decide_seldom_are_as_safe(seed: int, n: int, oldest_s: float, error: float) -> None:
    assert fly(seed, n, oldest_s=oldest_s, error=error, seldom=True, crowd=20.0) >= SAFE - 1e-6


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(2, 7), error=st.floats(0, 0.2), downwash=st.sampled_from([2.0, 3.0]))
def test_bodies_in_space_keep_out_of_each_others_downwash(seed: int, n: int, error: float, downwash: float) -> None:
    assert fly(seed, n, oldest_s=0.5, error=error, seldom=False, crowd=16.0, downwash=downwash) >= SAFE - 1e-6


def test_the_margin_is_no_larger_than_it_must_be() -> None:
    """Two bodies that crowd each other come as near as they may."""
    assert fly(1, 2, oldest_s=0.0, error=0.0, seldom=False, crowd=12.0, events=2000) < SAFE + 2 * SPEED * 0.05


def test_age_and_error_widen_the_margin_up_to_standing_still() -> None:
    def reach(**more: float) -> float:
        age_s, error = more.get("age_s", 0.0), more.get("error", 0.0)
        seen = Sighting(position=(8.0, 0.0), age_s=age_s)
        return project_async((0.0, 0.0), (8.0, 0.0), [seen], safe_distance=SAFE, speed=2.0, period_s=1.0, error=error)[
            0
        ]

    assert reach() == pytest.approx(2.0)
    assert reach(age_s=1.0) == pytest.approx(1.0)
    assert reach(error=1.0) == pytest.approx(1.0)
    assert reach(age_s=3.5) == 0.0


def test_a_body_too_near_may_leave_but_not_come() -> None:
    seen = [Sighting(position=(3.2, 0.0), age_s=0.0)]

    def to(x: float) -> Point:
        return project_async((0.0, 0.0), (x, 0.0), seen, safe_distance=SAFE, speed=2.0, period_s=0.5)

    assert to(-5.0) == pytest.approx((-1.0, 0.0))
    assert to(5.0)[0] <= 0.0


def test_robot_stands_still_if_stale_bodies_may_be_anywhere() -> None:
    around = [Sighting(position=p, age_s=0.0) for p in ((3.1, 0.0), (-3.1, 0.0))]
    to = project_async((0.0, 0.0), (5.0, 5.0), around, safe_distance=SAFE, speed=2.0, period_s=0.5)
    assert to == (0.0, 0.0)
