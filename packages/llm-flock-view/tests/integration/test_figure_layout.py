"""Where things are on a figure: panels, titles, words, discs and insets hide nothing of each other."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from sample_records import make_record

from llm_flock.record._reader import RunRecord, read_record
from llm_flock_view._figures import charts, figures
from llm_flock_view._figures.crowd import spots, spread
from llm_flock_view._figures.labels import Outlines, beside, box_at
from llm_flock_view._figures.panel import view
from llm_flock_view._figures.style import DANGER, NOT_BEGUN, QUIET, WITHOUT_PLAN


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return read_record(make_record(tmp_path_factory.mktemp("record") / "run.mcap", n=5, rounds=10))


def words(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(mpl.text.Text))  # pyright: ignore


@pytest.mark.parametrize(("rounds", "shown"), [(10, [0, 1, 5, 10]), (1, [0, 1]), (0, [0])])
def test_rounds_chosen_by_default(tmp_path: Path, rounds: int, shown: list[int]) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=3, rounds=rounds))
    titles = [axes.get_title().split(" · ")[0] for axes in figures.snapshots(record).axes]
    assert titles == ["start", *(f"round {k}" for k in shown[1:])]


def test_many_panels_go_into_rows(record: RunRecord) -> None:
    figure = figures.snapshots(record, list(range(6)))
    places = [axes.get_position() for axes in figure.axes]
    assert len(places) == 6 and len({round(place.y0, 3) for place in places}) == 2, "two rows of three"
    five = [axes.get_position() for axes in figures.snapshots(record, list(range(5))).axes]
    middle = (min(place.x0 for place in five[:3]) + max(place.x1 for place in five[:3])) / 2
    assert (five[3].x0 + five[4].x1) / 2 == pytest.approx(middle, abs=0.01), "no blank cell: the last row is centred"


def boxes(axes: Axes) -> tuple[list[Bbox], list[Bbox]]:
    """Where the words beside discs are, and the discs, as drawn [pixels]."""
    figure = axes.figure
    assert isinstance(figure, Figure)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    words = [text.get_window_extent(renderer) for text in axes.texts if text.get_zorder() >= 6]
    discs = [
        Bbox.from_bounds(x - half, y - half, 2 * half, 2 * half)
        for c in axes.collections
        if isinstance(c, PathCollection) and np.asarray(c.get_offsets()).shape == (1, 2)
        for x, y in axes.transData.transform(np.asarray(c.get_offsets()))
        for half in [np.sqrt(c.get_sizes()[0]) * figure.dpi / 72 / 2 / np.sqrt(2)]  # the square in the disc
    ]
    return words, discs


@pytest.mark.parametrize(("n", "wide"), [(5, 100.0), (10, 40.0), (10, 12.0), (15, 12.0)])
def test_no_word_lies_on_another_or_on_a_disc(tmp_path: Path, n: int, wide: float) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=n, rounds=2))
    rng = np.random.default_rng(n)
    record = replace(record, positions=rng.uniform(50.0 - wide / 2, 50.0 + wide / 2, record.positions.shape))
    for axes in figures.snapshots(record, [1, 2]).axes:
        words, discs = boxes(axes)
        assert len(discs) == n and len(words) > 0.5 * n
        assert not [(a, b) for a, b in itertools.combinations(words, 2) if a.overlaps(b)]
        assert not [(word, disc) for word in words for disc in discs if word.overlaps(disc)]
        inside = axes.get_window_extent()
        assert all(inside.x0 <= word.x0 and word.x1 <= inside.x1 for word in words)


@pytest.mark.parametrize("seed", range(3))
def test_every_disc_of_a_crowd_is_visible(seed: int) -> None:
    rng = np.random.default_rng(seed)
    discs = np.concatenate([np.full((3, 2), 50.0), [[90.0, 50.0], [90.5, 50.0]], rng.uniform(0.0, 100.0, (6, 2))])
    at, crowds = spread(discs, 5.0)
    assert [list(one.members[:3]) for one in crowds][:1] == [[0, 1, 2]], "robots in one place are a crowd"
    apart = np.linalg.norm(at[:, None] - at[None], axis=2) + np.diag(np.full(len(at), np.inf))
    assert apart.min() > 5.0, "no disc hides the middle of another"
    for crowd in crowds:
        if crowd.spot is not None:
            assert np.linalg.norm(at - crowd.spot, axis=1).min() > 5.0 + 5.0
    size, bounds = (8.0, 6.0), (-50.0, 150.0, -50.0, 150.0)
    told = spots(at, crowds, 5.0, size, bounds)
    assert len(told) == len(crowds) and all(one.spot is not None for one in told), "in the middle or beside it"
    alone = np.linalg.norm(discs[:, None] - discs[None], axis=2) + np.diag(np.full(len(at), np.inf))
    far = alone.min(axis=1) > 40.0
    np.testing.assert_array_equal(at[far], discs[far])


def test_robots_in_one_place_are_red_and_counted(record: RunRecord) -> None:
    stacked = record.positions.copy()
    stacked[2, :2] = stacked[2, 2]
    metrics = tuple(row.model_copy(update={"min_separation": 0.0}) for row in record.metrics)
    figure = figures.snapshots(replace(record, positions=stacked, metrics=metrics), [2, 10])
    assert "3\u00d7" in [text.get_text() for text in figure.axes[0].texts]
    assert not [text for text in figure.axes[1].texts if "\u00d7" in text.get_text()]
    assert "nearer than the safe distance" in words(figure) and "obstacle" not in words(figure)
    red = [
        c
        for c in figure.axes[0].collections
        if isinstance(c, PathCollection) and to_hex(np.asarray(c.get_edgecolor())[0]) == DANGER.lower()
    ]
    assert [len(np.asarray(c.get_offsets())) for c in red] == [3]
    assert "nearer than the safe distance" not in words(figures.snapshots(record, [2, 10]))
    stacked[10] = stacked[2]
    both = figures.comparison([record, replace(record, positions=stacked, metrics=metrics)], ["one", "other"])
    assert "nearer than the safe distance" in words(both), "the legend is for all panels"
    assert "hide one another: too near" in words(both) and "one above the other" not in words(both)


def test_robots_above_one_another_are_counted_and_not_red(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=3, rounds=2, dim=3))
    tower = record.positions.copy()
    tower[2] = [[50.0, 50.0, 10.0], [50.0, 50.0, 30.0], [50.5, 50.0, 60.0]]
    figure = figures.snapshots(replace(record, positions=tower), [2])
    axes, side = figure.axes
    assert not [text for text in side.texts if "\u00d7" in text.get_text()], "from the side they stand apart"
    (count,) = [text for text in axes.texts if text.get_text() == "3\u00d7"]
    patch = count.get_bbox_patch()
    assert patch is not None and to_hex(patch.get_facecolor()) == QUIET.lower()
    assert "hide one another, as one above the other: not too near" in words(figure)
    assert "too near\n" not in words(figure).replace("not too near", "") and "nearer than" not in words(figure)
    colours = {to_hex(colour) for c in axes.collections for colour in np.atleast_2d(c.get_edgecolor())}
    assert DANGER.lower() not in colours


def test_not_begun_and_no_plan_look_different(record: RunRecord) -> None:
    phases = ["asleep", *["idle"] * 4]
    state = record.states[2].model_copy(
        update={"phases": phases, "plan_ids": [None, None, *record.states[2].plan_ids[2:]]}
    )
    figure = figures.snapshots(replace(record, states=(*record.states[:2], state, *record.states[3:])), [2])
    (axes,) = figure.axes
    discs = [c for c in axes.collections if isinstance(c, PathCollection) and c.get_zorder() >= 4]
    fills = [to_hex(np.asarray(c.get_facecolor())[0]) for c in discs]
    assert fills[:2] == [NOT_BEGUN.fill.lower(), WITHOUT_PLAN.fill.lower()]
    said = [text.get_text() for text in axes.texts if text.get_zorder() >= 6]
    assert len(said) == 6, "a letter and a number for each of the three robots with a plan, and no bare number"
    assert "has not begun yet" in words(figure) and "robot without a plan" in words(figure)
    assert "dashed rim" not in words(figure)


def test_dashed_rims_are_in_the_legend_where_there_are_any(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=11, rounds=1, agree=False))
    assert "dashed rim: another plan, its colour used again" in words(figures.snapshots(record, [1]))


def test_word_beside_a_disc_crosses_outlines_only_without_room() -> None:
    disc, word, bounds = np.array([[50.0, 50.0]]), [(8.0, 6.0)], (0.0, 100.0, 0.0, 100.0)
    plain, *_ = beside(disc, 5.0, word, bounds)
    assert plain is not None and plain[1] > 0, "above the disc"
    way = np.array([[[50.0, 50.0], [50.0, 90.0]], [[20.0, 38.0], [80.0, 38.0]]])
    outlines = Outlines(np.array([[50.0, 50.0, 7.0]]), way)
    moved, *_ = beside(disc, 5.0, word, bounds, outlines=outlines)
    assert moved is not None and not outlines.cross(box_at(np.array(moved) + 50.0, word[0]))
    assert np.hypot(*moved) > 7.0, "outside the ring of the goal"
    walls = Outlines(np.empty((0, 3)), np.array([[[0.0, y], [100.0, y]] for y in range(0, 100, 4)], dtype=float))
    assert beside(disc, 5.0, word, bounds, outlines=walls) == [plain], "rather on a line than nowhere"


@pytest.mark.parametrize("rounds", [[10], [0, 5, 10], [0, 2, 5, 8, 10]])
def test_titles_labels_and_legend_keep_apart_within_the_figure(record: RunRecord, rounds: list[int]) -> None:
    mission = {**record.mission.mission, "obstacles": [{"center": [20.0, 20.0], "radius": 5.0}]}
    states = tuple(state.model_copy(update={"phases": ["asleep", "dead", *["idle"] * 3]}) for state in record.states)
    metrics = tuple(row.model_copy(update={"min_separation": 0.0}) for row in record.metrics)
    full = replace(
        record, states=states, metrics=metrics, missions=(record.mission.model_copy(update={"mission": mission}),)
    )
    # The plain key is shorter: where it is the widest part, in the narrowest figure, it is looked at as well.
    for one in (record, full) if len(rounds) == 1 else (full,):
        figure = figures.snapshots(one, rounds)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        renderer = canvas.get_renderer()
        (legend,) = figure.legends
        heading_of = figure._suptitle  # pyright: ignore[reportAttributeAccessIssue]
        parts = [heading_of, legend, *(text for axes in figure.axes for text in (axes.title, axes.xaxis.label))]
        boxes_of = [part.get_window_extent(renderer) for part in parts]
        whole = figure.bbox
        assert all(whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 for box in boxes_of)
        assert not [(a, b) for a, b in itertools.combinations(boxes_of, 2) if a.overlaps(b)]


def test_formation_fills_its_panel_and_an_inset_shows_where(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=6, rounds=4))
    close = record.positions.copy()
    close[4] = 50.0 + 0.1 * (close[4] - 50.0)
    states = [*record.states[:4], record.states[4].model_copy(update={"goals": [None] * 6})]
    wide, near = figures.snapshots(replace(record, positions=close, states=tuple(states)), [0, 4]).axes
    assert not wide.child_axes and near.get_xlim()[1] - near.get_xlim()[0] < 61.0
    (inset,) = near.child_axes
    assert inset.get_xlim() == (0.0, 100.0)
    left, right = near.get_xlim()
    assert left < close[4, :, 0].min() and close[4, :, 0].max() < right


def test_an_inset_hides_no_robot(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=25, rounds=1))
    grid = np.stack(np.meshgrid(np.linspace(30.0, 70.0, 5), np.linspace(30.0, 70.0, 5)), axis=-1).reshape(25, 2)
    spacing = record.mission.model_copy(update={"mission": {**record.mission.mission, "spacing": 5.0}})
    states = tuple(state.model_copy(update={"goals": [None] * 25}) for state in record.states)
    (axes,) = figures.snapshots(
        replace(record, positions=np.stack([grid, grid]), states=states, missions=(spacing,)), [1]
    ).axes
    (inset,) = axes.child_axes
    places = axes.transData.transform(grid)
    assert not [place for place in places if inset.get_window_extent().contains(*place)]


def test_the_window_holds_arena_robots_and_goals(record: RunRecord) -> None:
    assert view(record) == pytest.approx((-8.0, 108.0, -8.0, 108.0))
    far = record.positions.copy()
    far[3, 2] = (150.0, 50.0)
    left, right, *_ = view(replace(record, positions=far), margin=0.0)
    assert (left, right) == (0.0, 150.0)


def test_titles_of_a_column_are_whole_and_apart(tmp_path: Path) -> None:
    run = read_record(make_record(tmp_path / "run.mcap", n=10, rounds=3, agree=False))
    figure = figures.comparison([run, run], ["flock", "baseline"], width=3.5, font=8.0)
    FigureCanvasAgg(figure).draw()
    one, other = (axes.title.get_window_extent() for axes in figure.axes[:2])
    assert "\n10 goals" in figure.axes[0].get_title()
    assert figure.bbox.x0 <= one.x0 and one.x1 < other.x0 and other.x1 <= figure.bbox.x1


def test_a_title_of_two_lines_is_above_the_panels(record: RunRecord) -> None:
    config = {**record.run.config, "model": {"model": "simulated:distorted@0.3,overshoot@0.3,malformed@0.2"}}
    run = record.run.model_copy(update={"config": config})
    figure = figures.snapshots(replace(record, run=run, llm=()), [0, 10])
    FigureCanvasAgg(figure).draw()
    title = figure._suptitle  # pyright: ignore
    assert title is not None and "\n" in title.get_text()
    assert not [axes for axes in figure.axes if title.get_window_extent().overlaps(axes.title.get_window_extent())]


def test_a_long_label_of_an_axis_ends_below_the_legend() -> None:
    line = np.arange(5.0)
    series = ["flock", "paper", "baseline"]
    curves = [charts.Curve(series=name, x=line, mean=line, low=line, high=line) for name in series]
    panels = [charts.Facet(title="circle 6", marks=curves)]
    figure = charts.bands([("", panels)], series, "round", "mean distance to the ideal shape [units]")
    FigureCanvasAgg(figure).draw()
    label = figure._supylabel.get_window_extent()  # pyright: ignore
    assert not label.overlaps(figure.legends[0].get_window_extent())


@pytest.mark.filterwarnings("error")
def test_names_from_anywhere_are_shown_in_a_figure(tmp_path: Path) -> None:
    """Letters that a font lacks are warned of by their raw form; a name of a megabyte takes minutes to set."""
    record = read_record(make_record(tmp_path / "run.mcap", n=3, rounds=1))
    name = "$x_{$\x1b[2J\u202e\nerror: forged" + "x" * 1_000_000
    mission = record.mission.model_copy(update={"mission": {**record.mission.mission, "shape": name}})
    config = {**record.run.config, "protocol": {"consensus": name, "assignment": name}, "model": {"model": name}}
    hostile = replace(record, missions=(mission,), run=record.run.model_copy(update={"config": config}), llm=())
    for number, drawn in enumerate([figures.snapshots(hostile), figures.error_over_time([hostile], [name])]):
        figures.save(drawn, tmp_path / f"{number}.svg")
        assert "\x1b" not in (tmp_path / f"{number}.svg").read_text(encoding="utf-8")
