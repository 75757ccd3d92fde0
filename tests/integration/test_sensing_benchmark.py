"""The judge of `benchmarks.sensing` sees what it is to see, and its table keeps lines that were not measured again."""

import math
from pathlib import Path

import numpy as np
import pytest
from benchmarks import sensing

from llm_flock.obstacles import MovingObstacle

ONE = MovingObstacle(center=(0.0, 50.0), radius=2.0, speed=5.0, path=((100.0, 50.0),), since=2)


def test_gaps_are_those_on_the_way_too() -> None:
    """A robot that stands is passed between two rounds; one that flies along keeps its distance."""
    still, along = (7.5, 52.5), [(0.0 if k < 2 else 5.0 * (k - 2), 45.0) for k in range(8)]
    positions = np.array([[still, place] for place in along])
    gaps = sensing.gaps(positions, ONE)
    assert gaps.shape == (7, 2) and gaps[:, 1] == pytest.approx([3.0] * 7)
    assert gaps[:, 0].min() == pytest.approx(0.5) and int(gaps[:, 0].argmin()) == 3
    assert min(math.dist(still, ONE.at(k)) for k in range(8)) > 2.5 + 0.5


def test_rounds_count_from_when_obstacles_have_left() -> None:
    places = np.array([[40.0, 50.0], [60.0, 50.0]])
    left = sensing.left([ONE], places, 6.0)
    assert ONE.at(left)[0] - 60.0 > 24.0 - 5.0 and ONE.at(left - 1)[0] - 60.0 <= 24.0
    assert sensing.left([], places, 6.0) == 0


def test_obstacles_of_a_seed_cross_the_middle_and_leave() -> None:
    case = sensing.CASES["3 obstacles"]
    for one in sensing.crossing(case, 7):
        assert min(math.dist(one.at(k / 10), sensing.CENTER) for k in range(1500)) <= 16.0
        assert one.at(1000) == one.path[-1] and max(abs(x - 50.0) for x in one.path[-1]) > 50.0
    assert sensing.crossing(case, 7) == sensing.crossing(case, 7) != sensing.crossing(case, 8)


def test_other_lines_of_the_table_stay(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sensing, "TABLE", tmp_path / "sensing.csv")
    monkeypatch.setattr(sensing, "stamp", lambda name: None)
    monkeypatch.setattr(sensing, "CASES", {"exact": sensing.Case(), "other": sensing.Case()})
    sensing.main(["--seeds", "1", "--case", "exact"])
    before = sensing.kept()
    assert [row["Formed"] for row in before.values()] == ["1 of 1"] * 2
    sensing.main(["--seeds", "1", "--case", "other"])
    assert {key: sensing.kept()[key] for key in before} == before and len(sensing.kept()) == 4
