"""A panel: where robots, links, walls and obstacles are drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from sample_records import FakeRun, make_record

from llm_flock.record._reader import RunRecord, read_record
from llm_flock_view._figures import figures
from llm_flock_view._figures.panel import Panel


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return read_record(make_record(tmp_path_factory.mktemp("record") / "run.mcap", n=5, rounds=10))


def words(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(mpl.text.Text))  # pyright: ignore


def test_a_large_team_is_drawn_without_letters(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=40, rounds=2, llm=False))
    (axes,) = figures.snapshots(record, [2]).axes
    assert not axes.texts
    robots = np.asarray(axes.collections[-1].get_offsets())
    np.testing.assert_allclose(robots, record.positions[2])


def drawn_on(axes: Axes, record: RunRecord, round_number: int, part: float) -> None:
    panel = Panel(record)
    panel.frame(axes)
    panel.draw_team(axes, round_number, part)


def test_the_dead_keep_their_numbers(record: RunRecord) -> None:
    states = tuple(state.model_copy(update={"phases": ["idle", "dead", *["idle"] * 3]}) for state in record.states)
    (axes,) = figures.snapshots(replace(record, states=states), [10]).axes
    assert [text.get_text() for text in axes.texts].count("1") == 1
    assert "dead (\u00d7), with its number" in words(axes.figure)  # type: ignore[arg-type]


def test_between_rounds_robots_are_on_the_straight_way(record: RunRecord) -> None:
    axes = Figure().add_subplot()
    drawn_on(axes, record, 3, 0.25)
    middle = 0.75 * record.positions[2] + 0.25 * record.positions[3]
    drawn = np.concatenate([np.asarray(c.get_offsets()) for c in axes.collections[-5:]])
    np.testing.assert_allclose(drawn, middle)


def test_space_is_seen_from_above_and_from_the_side(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=4, rounds=2, dim=3))
    above, side = figures.snapshots(record, [2]).axes
    for axes, seen in ((above, [0, 1]), (side, [0, 2])):
        drawn = np.concatenate([np.asarray(c.get_offsets()) for c in axes.collections[-4:]])
        assert drawn.shape == (4, 2)
        if seen == [0, 1]:  # from the side, those of one height stand aside of one another
            np.testing.assert_allclose(drawn, record.positions[2][:, seen])
    assert [axes.get_ylabel() for axes in (above, side)] == ["y [units]", "z [units]"]


def test_radio_links_span_all_space_also_seen_from_above(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=3, rounds=1, dim=3))
    # Over one another, but only the lower two within the range of 15.
    positions = np.array([[[50.0, 50.0, z], [51.0, 50.0, z + 10.0], [52.0, 50.0, 80.0]] for z in (5.0, 6.0)])
    axes = Figure().add_subplot()
    drawn_on(axes, replace(record, positions=positions), 1, 0.5)
    links = next(c for c in axes.collections if isinstance(c, LineCollection))
    assert [np.asarray(s).tolist() for s in links.get_segments()] == [[[50.0, 50.0], [51.0, 50.0]]]


def test_one_robot_can_be_drawn(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=1, rounds=1))
    assert "1 robot ·" in words(figures.snapshots(record))
    assert FakeRun(n=1).mission.n_robots == 1


def test_walls_and_obstacles_are_drawn(record: RunRecord) -> None:
    disc = {"center": [20.0, 30.0], "radius": 4.0, "polygon": None}
    corners = {"center": None, "radius": None, "polygon": [[1.0, 1.0], [9.0, 1.0], [5.0, 7.0]]}
    mission = record.mission.model_copy(update={"mission": {**record.mission.mission, "obstacles": [disc, corners]}})
    patches = figures.snapshots(replace(record, missions=(mission,)), [0]).axes[0].patches
    (left, bottom), (right, top) = mission.mission["arena"]
    boxes = [patch.get_path().get_extents(patch.get_patch_transform()).bounds for patch in patches]
    expected = [(left, bottom, right - left, top - bottom), (16.0, 26.0, 8.0, 8.0), (1.0, 1.0, 8.0, 6.0)]
    assert np.allclose(boxes, expected)
    without = {key: value for key, value in mission.mission.items() if key != "obstacles"}
    older = record.mission.model_copy(update={"mission": without})
    assert len(figures.snapshots(replace(record, missions=(older,)), [0]).axes[0].patches) == 1
