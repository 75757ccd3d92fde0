"""The baselines of `benchmarks.arrivals` have the properties that their papers give them."""

import math
from dataclasses import replace
from itertools import combinations
from unittest import mock

import numpy as np
import pytest
from benchmarks import arrivals
from benchmarks.orca import orca_line, orca_velocities, orca_velocity

from llm_flock.mission import Mission
from llm_flock.protocol._motion.right_of_way import RightOfWay

LIMITS = {"diameter": 3.0, "longest": 6.0, "horizon": 2.0, "period": 0.1}


def scene(start, places, **fields):
    mission = Mission(n_robots=len(start), **fields)
    return arrivals.Scene(mission=mission, start=np.array(start), places=np.array(places), fixed=True, options={})


def flown(method: arrivals.Method, case: arrivals.Scene) -> arrivals.Flight:
    flight = method(case)
    assert flight is not None
    return flight


def figures_of(method: arrivals.Method, case: arrivals.Scene) -> arrivals.Figures:
    return arrivals.measure(case, flown(method, case))


ORCA = arrivals.METHODS["ORCA, horizon 2"]
OURS = arrivals.METHODS["ours"]


def test_orca_robots_that_meet_head_on_pass_each_other():
    meeting = scene([(20.0, 50.0), (80.0, 50.0)], [(80.0, 50.0), (20.0, 50.0)])
    flight = flown(ORCA, meeting)
    figures = arrivals.measure(meeting, flight)
    assert figures.arrived is not None and figures.arrived <= 12
    assert 3.0 - 1e-6 <= figures.separation < 4.0  # they pass closely
    # Speeds are those of the mission, and no robot gets ahead of the clock.
    steps = np.linalg.norm(np.diff(flight.track, axis=0), axis=2)
    assert steps.max() <= meeting.mission.max_step / arrivals.SUBSTEPS + 1e-9


def test_twenty_orca_robots_exchange_places_across_a_circle():
    figures = figures_of(ORCA, arrivals.scene_of("mirrored 20", 0))
    assert figures.arrived is not None
    assert figures.ratio < 2.0 and figures.detour < 1.2


def test_orca_separates_robots_with_an_allowed_velocity():
    rng = np.random.default_rng(3)
    feasible = 0
    for _ in range(300):
        one, two = 0j, complex(*rng.uniform(-8.0, 8.0, 2))
        if abs(two) < 3.0:
            continue
        speeds = a, b = [complex(*rng.uniform(-4.0, 4.0, 2)) for _ in range(2)]
        wishes = [complex(*rng.uniform(-6.0, 6.0, 2)) for _ in range(2)]
        lines = [orca_line(two, a, b, 3.0, 2.0, 0.1), orca_line(-two, b, a, 3.0, 2.0, 0.1)]
        chosen = orca_velocities([one, two], speeds, wishes, **LIMITS)
        if any((along.conjugate() * (v - p)).imag < -1e-9 for (p, along), v in zip(lines, chosen, strict=True)):
            continue
        feasible += 1
        times = np.linspace(0.0, 2.0, 200)
        assert min(abs(two - one + t * (chosen[1] - chosen[0])) for t in times) >= 3.0 - 1e-9
    assert feasible > 150


def test_orca_takes_nearest_grid_velocity_else_the_least_bad():
    rng = np.random.default_rng(1)
    axis = np.linspace(-1.0, 1.0, 201)
    grid = (axis[:, None] + 1j * axis[None, :]).ravel()
    grid = grid[abs(grid) <= 1.0]
    kinds = set()
    for _ in range(60):
        turns = np.exp(1j * rng.uniform(0.0, 2.0 * math.pi, 5))
        points = [complex(*rng.uniform(-0.6, 0.6, 2)) for _ in range(5)]
        lines = list(zip(points, turns.tolist(), strict=True))
        wish = complex(*rng.uniform(-1.0, 1.0, 2))
        found = orca_velocity(lines, 1.0, wish)

        def violation(v, lines=lines):
            return np.max([(along.conjugate() * (p - v)).imag for p, along in lines], axis=0)

        allowed = grid[violation(grid) <= 0.0]
        assert abs(found) <= 1.0 + 1e-9
        if len(allowed):
            assert violation(found) <= 1e-9
            assert abs(found - wish) <= abs(allowed - wish).min() + 1e-9
        else:
            assert violation(found) <= violation(grid).min() + 1e-9
        kinds.add(bool(len(allowed)))
    assert kinds == {True, False}


def test_capt_flies_only_under_its_conditions_never_colliding():
    rng, flights = np.random.default_rng(0), 0
    for _ in range(60):
        start, places = rng.uniform(20.0, 60.0, (2, 6, 2))
        case = scene(start, places)
        assert arrivals.capt(case) is None  # its goals may not be fixed
        free = replace(case, fixed=False)
        flight = arrivals.capt(free)
        apart = min(math.dist(a, b) for points in (start, places) for a, b in combinations(points, 2))
        assert (flight is not None) == (apart >= math.sqrt(2.0) * 3.0)
        if flight is not None:
            figures, flights = arrivals.measure(free, flight), flights + 1
            assert figures.arrived is not None and not figures.violated
    assert 10 < flights < 60


def test_ours_arrives_when_its_summary_says_so():
    case = arrivals.scene_of("line 7", 0)
    assert case.result is not None
    figures, summary = figures_of(OURS, case), case.result.summary
    assert figures.arrived is not None and summary.lower_bound_rounds is not None
    assert figures.arrived == summary.rounds_to_formed
    assert figures.ratio == pytest.approx(figures.arrived / summary.lower_bound_rounds)
    assert figures.separation == pytest.approx(summary.min_separation)


def test_motion_alone_and_straight_steps_keep_the_safe_distance():
    meeting = scene([(40.0, 50.0), (60.0, 50.0)], [(60.0, 50.0), (40.0, 50.0)])
    alone, faced = figures_of(OURS, meeting), figures_of(arrivals.straight, meeting)
    assert alone.arrived is not None and faced.arrived is None  # without right of way they face each other without end
    assert not alone.violated and not faced.violated


def test_variant_of_ours_flies_without_what_it_switches_off():
    meeting = scene([(40.0, 50.0), (60.0, 50.0)], [(60.0, 50.0), (40.0, 50.0)])
    without = arrivals.ours(lambda: mock.patch.object(RightOfWay, "ways", return_value=[]))
    assert figures_of(without, meeting).arrived is None
    again = arrivals.scene_of("line 7", 1)
    short = arrivals.ours(rounds=3)
    cut_short = flown(short, again)
    assert len(cut_short.track) == 4 and arrivals.measure(again, cut_short).arrived is None
    assert short(meeting) is None  # the motion alone has no number of rounds


def test_a_row_counts_arrivals_among_those_flown():
    one = arrivals.Figures(arrived=6, ratio=1.5, detour=1.1, separation=3.2, violated=False)
    lost = arrivals.Figures(arrived=None, ratio=0.0, detour=9.0, separation=2.5, violated=True)
    found = arrivals.row("a", "b", [one, lost, None])
    assert found == "| a | b | 1 of 2 [9, 91] | 6 | 1.50, 1.50 | 1.10 | 2.500000 | 1 |"
    assert arrivals.row("a", "b", [lost]) == "| a | b | 0 of 1 [0, 79] | - | - | - | 2.500000 | 1 |"
    assert arrivals.row("a", "b", [None]) == "| a | b | - | - | - | - | - | - |"
