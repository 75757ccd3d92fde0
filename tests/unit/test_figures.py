"""Figures: what they show, in numbers; and that a user's own settings stay as they were."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from sample_records import FakeRun, make_record
from scipy import stats

from llm_flock.errors import InputError
from llm_flock.record.reader import RunRecord, read_record
from llm_flock.record.scene import PALETTE
from llm_flock.viz import figures
from llm_flock.viz.animation import frames
from llm_flock.viz.crowd import spread
from llm_flock.viz.panel import Panel, short, view
from llm_flock.viz.style import DANGER, heading, ink_on, letters, line_colour, luminance, model_names, plan_looks


@pytest.fixture
def record(tmp_path: Path) -> RunRecord:
    return read_record(make_record(tmp_path / "run.mcap", n=5, rounds=10))


def words(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(mpl.text.Text))  # pyright: ignore


def test_snapshots_at_chosen_rounds_show_paths_plans_influence_and_links(record: RunRecord) -> None:
    figure = figures.snapshots(record, [0, 2, 10])
    assert [axes.get_title().split(" · ")[0] for axes in figure.axes] == ["start", "round 2", "round 10"]
    start, second, last = figure.axes
    assert all(axes.get_aspect() == 1.0 for axes in figure.axes)
    names = [[t.get_text() for t in axes.texts] for axes in figure.axes]
    # Numbers, then plan and influence of each; nobody has a plan at the start, and all have the first at the end.
    assert all(shown[:5] == ["0", "1", "2", "3", "4"] for shown in names)
    shares = [[short(share) for share in record.states[k].influence] for k in (0, 2, 10)]
    assert names[0][5:] == shares[0]
    assert names[1][5:] == [f"{name} {share}" for name, share in zip("AACDA", shares[1], strict=True)]
    assert names[2][5:] == [f"A {share}" for share in shares[2]]
    links, paths = (c for c in last.collections if isinstance(c, LineCollection))
    assert links.get_zorder() > paths.get_zorder()
    ends = {tuple(np.round(p, 6)) for p in record.positions[10]}
    assert len(links.get_segments()) > 0
    assert {tuple(np.round(p, 6)) for segment in links.get_segments() for p in segment} <= ends
    assert len(paths.get_segments()) == 5 * 10
    drawn = {tuple(np.round(np.asarray(c.get_offsets())[0], 6)) for c in last.collections[3:]}
    assert ends <= drawn
    assert start.get_xlim() == second.get_xlim() == (-8.0, 108.0)
    assert last.get_xlim()[1] - last.get_xlim()[0] < 0.7 * 116.0, "a formation fills its panel"


def test_the_title_says_what_was_flown_and_that_the_models_were_simulated(record: RunRecord) -> None:
    said = words(figures.snapshots(record))
    assert "circle · 5 robots" in said and "simulated:ideal" in said and "simulated language models" in said
    real = replace(record, run=record.run.model_copy(update={"simulated": False}))
    assert "simulated language models" not in words(figures.snapshots(real))
    assert "simulated language models" in model_names([real, record])
    rules = {"protocol": {"consensus": "provenance", "assignment": "auction"}}
    ruled = replace(record, run=record.run.model_copy(update={"config": rules}))
    assert heading(ruled, 10).startswith("circle · 5 robots · provenance + auction · simulated:ideal")
    assert max(len(line) for line in heading(ruled, 3).splitlines()) <= 45


def test_without_calls_the_configured_model_is_named(record: RunRecord) -> None:
    assert model_names([replace(record, llm=())]) == "simulated:ideal · simulated language models"
    run = record.run.model_copy(update={"config": {}, "simulated": False})
    assert model_names([replace(record, llm=(), run=run)]) == ""


@pytest.mark.parametrize("rounds", [[], [-1], [0, 11]])
def test_rounds_that_the_record_lacks_are_refused(record: RunRecord, rounds: list[int]) -> None:
    with pytest.raises(InputError, match="0 to 10"):
        figures.snapshots(record, rounds)


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


def test_errors_of_runs_with_one_label_are_averaged_with_student_t_intervals() -> None:
    curves = [np.array([4.0, 2.0, 1.0]), np.array([6.0, 4.0]), np.array([5.0, 6.0, 3.0])]
    mean, lows, highs = figures.mean_and_interval(curves)
    assert mean == pytest.approx([5.0, 4.0, 8.0 / 3.0])
    for k, sample in enumerate([[4, 6, 5], [2, 4, 6], [1, 4, 3]]):
        low, high = stats.t.interval(0.95, 2, loc=np.mean(sample), scale=stats.sem(sample))
        assert (lows[k], highs[k]) == pytest.approx((max(0.0, low), high))
    alone, *none = figures.mean_and_interval(curves[:1])
    assert alone.tolist() == [4.0, 2.0, 1.0] and np.isnan(none).all()


def test_error_over_time_draws_one_line_a_label_with_a_band_for_many_runs(tmp_path: Path) -> None:
    runs = [read_record(make_record(tmp_path / f"{i}.mcap", n=3, rounds=5 + i, seed=i)) for i in range(3)]
    figure = figures.error_over_time(runs, ["ours", "ours", "theirs"])
    (axes,) = figure.axes
    assert [line.get_label() for line in axes.lines] == ["ours (mean of 2 runs, 95% interval)", "theirs"]
    assert len(axes.collections) == 1
    assert np.asarray(axes.lines[1].get_ydata()).tolist() == runs[2].errors.tolist()
    assert "simulated language models" in words(figure)
    one, two = axes.lines
    assert one.get_linestyle() != two.get_linestyle() and one.get_marker() != two.get_marker()


def test_comparison_shows_the_end_of_every_run_and_all_errors(tmp_path: Path) -> None:
    good = read_record(make_record(tmp_path / "a.mcap", n=4, rounds=6))
    bad = read_record(make_record(tmp_path / "b.mcap", n=4, rounds=8, agree=False))
    figure = figures.comparison([good, bad], ["ours", "theirs"])
    assert [axes.get_title() for axes in figure.axes] == [
        "ours\nformed in round 6",
        "theirs\nnot formed: 4 plans, 4 goals",
        "",
    ]
    assert figure.axes[0].get_xlim() == figure.axes[1].get_xlim()
    assert len(figure.axes[2].lines) == 2
    assert figures.outcome(replace(good, result=None)) == "not formed: 1 plan, 4 goals"


def test_records_and_labels_must_fit(record: RunRecord) -> None:
    with pytest.raises(InputError, match="at least one record"):
        figures.error_over_time([], [])
    with pytest.raises(InputError, match="one label for each of the 2 records"):
        figures.comparison([record, record], ["only one"])
    rows = tuple(row.model_copy(update={"procrustes_mean": None}) for row in record.metrics)
    with pytest.raises(InputError, match="known after every round"):
        figures.error_over_time([replace(record, metrics=rows)], ["free text"])
    assert "error" not in words(figures.snapshots(replace(record, metrics=rows)))


def test_save_writes_by_ending_and_names_what_it_cannot(record: RunRecord, tmp_path: Path) -> None:
    figure = figures.snapshots(record, [10])
    for name, magic in (("a/b.png", b"\x89PNG"), ("c.pdf", b"%PDF"), ("d.svg", b"<?xml")):
        figures.save(figure, tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(magic)
    with pytest.raises(InputError, match=r"out = .*figure\.doc.* png"):
        figures.save(figure, tmp_path / "figure.doc")
    with pytest.raises(InputError, match="can be written to"):
        figures.save(figure, tmp_path / "c.pdf" / "x.png")


def test_a_users_settings_are_neither_used_nor_changed(record: RunRecord) -> None:
    with mpl.rc_context({"font.size": 30.0, "axes.facecolor": "red"}):
        figure = figures.snapshots(record, [0])
        assert mpl.rcParams["font.size"] == 30.0
    assert figure.axes[0].get_facecolor() == (1.0, 1.0, 1.0, 1.0)


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


def boxes(axes: Axes) -> tuple[list[Bbox], list[Bbox]]:
    """Where the words beside discs are, and the discs, as drawn [pixels]."""
    figure = axes.figure
    assert isinstance(figure, Figure)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    words = [text.get_window_extent(renderer) for text in axes.texts if not text.get_text().isdecimal()]
    discs = [
        Bbox.from_bounds(x - half, y - half, 2 * half, 2 * half)
        for c in axes.collections
        if isinstance(c, PathCollection) and np.asarray(c.get_offsets()).shape == (1, 2)
        for x, y in axes.transData.transform(np.asarray(c.get_offsets()))
        for half in [np.sqrt(c.get_sizes()[0]) * figure.dpi / 72 / 2 / np.sqrt(2)]  # the square in the disc
    ]
    return words, discs


@pytest.mark.parametrize(("n", "wide"), [(5, 100.0), (5, 12.0), (10, 100.0), (10, 40.0), (10, 12.0), (15, 12.0)])
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


@pytest.mark.parametrize("seed", range(6))
def test_every_disc_of_a_crowd_is_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    discs = np.concatenate([np.full((3, 2), 50.0), [[90.0, 50.0], [90.5, 50.0]], rng.uniform(0.0, 100.0, (6, 2))])
    at, crowds = spread(discs, 5.0)
    assert [list(one.members[:3]) for one in crowds][:1] == [[0, 1, 2]], "robots in one place are a crowd"
    apart = np.linalg.norm(at[:, None] - at[None], axis=2) + np.diag(np.full(len(at), np.inf))
    assert apart.min() > 5.0, "no disc hides the middle of another"
    for crowd in crowds:
        if crowd.middle is not None:
            assert np.linalg.norm(at - crowd.middle, axis=1).min() > 5.0 + 5.0
    alone = np.linalg.norm(discs[:, None] - discs[None], axis=2) + np.diag(np.full(len(at), np.inf))
    far = alone.min(axis=1) > 40.0
    np.testing.assert_array_equal(at[far], discs[far])


def test_robots_in_one_place_are_red_and_counted(record: RunRecord) -> None:
    apart = tuple(row.model_copy(update={"min_separation": 9.0}) for row in record.metrics)
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
    assert "nearer than the safe distance" not in words(figures.snapshots(replace(record, metrics=apart), [2, 10]))
    both = figures.comparison(
        [replace(record, metrics=apart), replace(record, positions=stacked, metrics=metrics)], ["one", "other"]
    )
    assert "nearer than the safe distance" in words(both), "the legend is for all panels"


@pytest.mark.parametrize("rounds", [[10], [2, 10], [0, 5, 10], [0, 2, 5, 10], [0, 2, 5, 8, 10]])
def test_titles_labels_and_legend_keep_apart_and_within_the_figure(record: RunRecord, rounds: list[int]) -> None:
    mission = {**record.mission.mission, "obstacles": [{"center": [20.0, 20.0], "radius": 5.0}]}
    states = tuple(state.model_copy(update={"phases": ["asleep", "dead", *["idle"] * 3]}) for state in record.states)
    metrics = tuple(row.model_copy(update={"min_separation": 0.0}) for row in record.metrics)
    full = replace(
        record, states=states, metrics=metrics, missions=(record.mission.model_copy(update={"mission": mission}),)
    )
    for one in (record, full):
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


def test_the_dead_keep_their_numbers(record: RunRecord) -> None:
    states = tuple(state.model_copy(update={"phases": ["idle", "dead", *["idle"] * 3]}) for state in record.states)
    (axes,) = figures.snapshots(replace(record, states=states), [10]).axes
    assert [text.get_text() for text in axes.texts].count("1") == 1
    assert "dead robot" in words(axes.figure)  # type: ignore[arg-type]


def test_a_formation_fills_its_panel_and_an_inset_shows_where_it_is(tmp_path: Path) -> None:
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


def test_between_rounds_robots_are_on_the_straight_way(record: RunRecord) -> None:
    axes = Figure().add_subplot()
    drawn_on(axes, record, 3, 0.25)
    middle = 0.75 * record.positions[2] + 0.25 * record.positions[3]
    drawn = np.concatenate([np.asarray(c.get_offsets()) for c in axes.collections[-5:]])
    np.testing.assert_allclose(drawn, middle)


def test_three_dimensions_are_seen_from_above(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=4, rounds=2, dim=3))
    (axes,) = figures.snapshots(record, [2]).axes
    drawn = np.concatenate([np.asarray(c.get_offsets()) for c in axes.collections[-4:]])
    np.testing.assert_allclose(drawn, record.positions[2, :, :2])


def test_radio_links_are_of_the_whole_space_also_when_seen_from_above(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=3, rounds=1, dim=3))
    # Over one another, but only the lower two within the range of 15.
    positions = np.array([[[50.0, 50.0, z], [51.0, 50.0, z + 10.0], [52.0, 50.0, 80.0]] for z in (5.0, 6.0)])
    axes = Figure().add_subplot()
    drawn_on(axes, replace(record, positions=positions), 1, 0.5)
    links = next(c for c in axes.collections if isinstance(c, LineCollection))
    assert [np.asarray(s).tolist() for s in links.get_segments()] == [[[50.0, 50.0], [51.0, 50.0]]]


def with_shape(record: RunRecord, shape: str) -> RunRecord:
    mission = record.mission.model_copy(update={"mission": {**record.mission.mission, "shape": shape}})
    return replace(record, missions=(mission,))


def test_words_of_the_operator_begin_no_formula(record: RunRecord, tmp_path: Path) -> None:
    words_given = r"cost $\foo{$ and"
    shown = with_shape(record, "text:" + words_given)
    for number, figure in enumerate(
        [
            figures.snapshots(shown, [1]),
            figures.error_over_time([shown], [words_given]),
            figures.comparison([shown], [words_given]),
        ]
    ):
        figures.save(figure, tmp_path / f"{number}.png")
    assert next(frames(shown)).size == next(frames(record)).size


def test_runs_without_a_known_ideal_are_compared_without_errors(record: RunRecord, tmp_path: Path) -> None:
    rows = tuple(row.model_copy(update={"procrustes_mean": None}) for row in record.metrics)
    free = replace(with_shape(record, "text:a cloud"), metrics=rows)
    figure = figures.comparison([free, record], ["one", "two"])
    assert [axes.get_title() for axes in figure.axes] == ["one\nformed in round 10", "two\nformed in round 10"]
    figures.save(figure, tmp_path / "compared.png")
    with pytest.raises(InputError, match="known after every round"):
        figures.error_over_time([free], ["one"])


def test_the_window_holds_arena_robots_and_goals(record: RunRecord) -> None:
    assert view(record) == pytest.approx((-8.0, 108.0, -8.0, 108.0))
    far = record.positions.copy()
    far[3, 2] = (150.0, 50.0)
    left, right, *_ = view(replace(record, positions=far), margin=0.0)
    assert (left, right) == (0.0, 150.0)


def test_plans_look_different_even_without_colour(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=20, rounds=1, llm=False))
    looks = plan_looks(record)
    assert list(looks)[1:] == [plan.plan_id for plan in record.plans]
    assert len({look.name for look in looks.values()}) == 21
    assert len({(look.fill, look.rim) for look in looks.values()}) == 21
    assert looks[None].name == ""


def test_a_plan_that_was_not_announced_still_has_a_look(record: RunRecord) -> None:
    assert set(plan_looks(replace(record, plans=()))) - {None} <= {plan.plan_id for plan in record.plans}
    assert len(plan_looks(replace(record, plans=()))) > 1


def test_letters_count_on() -> None:
    assert [letters(k) for k in (0, 25, 26, 27, 51, 52, 701, 702)] == ["A", "Z", "AA", "AB", "AZ", "BA", "ZZ", "AAA"]


def test_letters_and_lines_can_be_read() -> None:
    for fill in PALETTE:
        light, letter = luminance(fill), luminance(ink_on(fill))
        contrast = (max(light, letter) + 0.05) / (min(light, letter) + 0.05)
        assert contrast >= 3.9, fill
        assert luminance(line_colour(fill)) <= 0.6, fill
    assert line_colour(PALETTE[0]) == PALETTE[0]


def test_influence_in_few_signs() -> None:
    assert [short(x) for x in (0.0, 0.1, 0.25, 1.0)] == ["0", ".10", ".25", "1"]


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
