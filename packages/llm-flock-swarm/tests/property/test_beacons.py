"""Closed loop of sensors, beacons and bodies, with a member that lies about where it is."""

import math

import numpy as np
import pytest
from effort import cases
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.arrays import Point
from llm_flock.links import LinkFaults
from llm_flock.metrics import min_separation
from llm_flock.transport._radio import Radio, Seen
from llm_flock_swarm._network.body_control import BodyControl
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.wire import Command
from llm_flock_swarm._network.world import WorldBodies

N, LIAR = 4, 3
CONFIG = SwarmConfig.build({}, shape="square", n_robots=N, model="simulated:ideal", start="connected")
SAFE = CONFIG.mission.safe_distance


def fly(seed: int, *, follows: bool, seconds: float = 6.0) -> tuple[float, float]:
    """Honest bodies that wish to meet, and a liar. Smallest separation of the honest, and of them from the liar.

    The liar's body stands still, or `follows` wishes as the others do. Its beacons are always newer than the sensors'
    reading, and say that it is anywhere.
    """
    rng = np.random.default_rng(seed)
    network, mission = CONFIG.network, CONFIG.mission
    starts: list[Point] = []
    while len(starts) < N:
        x = rng.uniform(40.0, 60.0, 2)
        if all(math.dist(x, other) >= SAFE for other in starts):
            starts.append(tuple(x.tolist()))
    world = WorldBodies(
        np.array(starts), speed=CONFIG.speed, period_s=network.control_s, lag_s=network.lag_s, now=100.0
    )
    radios = [
        Radio(
            robot,
            mission,
            faults=LinkFaults(),
            rng=rng,
            beacon_s=network.beacon_s,
            delay_s=0.1,
            clock_error_s=network.clock_error_s,
            speed=CONFIG.speed,
        )
        for robot in range(N)
    ]
    bodies = [BodyControl(CONFIG) for _ in range(N)]
    honest = apart = math.inf
    sent: list[tuple[float, int, Command]] = []
    free_s = [100.0] * N
    for tick in range(int(seconds / 0.01)):
        now = 100.0 + 0.01 * tick
        for due, robot, command in [order for order in sent if order[0] <= now]:
            world.command(robot, command, due)
        sent = [order for order in sent if order[0] > now]
        world.advance(now)
        honest = min(honest, min_separation(world.positions[:LIAR]))
        liar = world.positions[LIAR]
        apart = min(apart, float(np.linalg.norm(world.positions[:LIAR] - liar, axis=1).min()))
        if tick % 4 == 0:
            places = [tuple(row) for row in world.positions.tolist()]
            for robot in range(N):
                radios[robot].frame(now, places)
                bodies[robot].update(world.states()[robot])
        for robot in range(N):
            if robot == LIAR or (tick + 3 * robot) % 10 == 0:
                here = tuple(world.positions[robot].tolist())
                said = here if robot != LIAR else tuple(rng.uniform(40.0, 60.0, 2).tolist())
                for other in range(N):
                    if other != robot:
                        radios[other].place(robot, Seen(stamp=now, position=said))
                        if radios[other].carries(robot):
                            radios[other].beacon(robot, Seen(stamp=now, position=said))
            if robot == LIAR and not follows:
                continue
            if rng.random() < 0.02 or bodies[robot].waypoint is None:
                wish = world.positions[rng.integers(0, N)] if rng.random() < 0.8 else rng.uniform(35.0, 65.0, 2)
                bodies[robot].fly_to(tuple(wish.tolist()))
            if now < free_s[robot]:
                continue
            order = bodies[robot].control(now, radios[robot].sightings(now), radios[robot].unseen_s(now))
            if order is not None:
                free_s[robot] = now + network.control_s
                sent.append((now + float(rng.uniform(0.0, 0.04)), robot, order))
    return honest, apart


@cases(5)
@given(seed=st.integers(0, 2**32), follows=st.booleans())
def test_no_beacon_brings_bodies_near_that_the_sensors_see(seed: int, follows: bool) -> None:
    honest, apart = fly(seed, follows=follows)
    assert honest >= SAFE - 1e-6
    assert apart >= SAFE - 1e-6


def test_the_honest_crowd_each_other_as_far_as_they_may() -> None:
    """The property above says something: bodies do come near each other."""
    nearest = min(min(fly(seed, follows=False)) for seed in range(4))
    assert nearest < SAFE + 1.5 * CONFIG.speed * (CONFIG.network.control_s + CONFIG.network.lag_s + 0.1)
    assert nearest == pytest.approx(SAFE, abs=4.0)
