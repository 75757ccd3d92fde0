"""Figures: what they show, in numbers; and that a user's own settings stay as they were."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from sample_records import make_record

from llm_flock.errors import InputError
from llm_flock.record._reader import RunRecord, read_record
from llm_flock_view._figures import figures
from llm_flock_view._figures.animation import frames
from llm_flock_view._figures.panel import short
from llm_flock_view._figures.style import heading, model_names


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return read_record(make_record(tmp_path_factory.mktemp("record") / "run.mcap", n=5, rounds=10))


def words(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(mpl.text.Text))  # pyright: ignore


def test_snapshots_show_paths_plans_influence_and_links(record: RunRecord) -> None:
    figure = figures.snapshots(record, [0, 2, 10])
    assert [axes.get_title().split(" · ")[0] for axes in figure.axes] == ["start", "round 2", "round 10"]
    start, second, last = figure.axes
    assert all(axes.get_aspect() == 1.0 for axes in figure.axes)
    names = [[t.get_text() for t in axes.texts] for axes in figure.axes]
    # Numbers, then plan and influence of each; no robot has a plan at the start, and no number stands alone there, and
    # all have the first at the end.
    assert all(shown[:5] == ["0", "1", "2", "3", "4"] for shown in names)
    shares = [[short(share) for share in record.states[k].influence] for k in (0, 2, 10)]
    assert names[0][5:] == []
    assert names[1][5:] == [text for pair in zip("AACDA", shares[1], strict=True) for text in pair]
    assert names[2][5:] == [text for share in shares[2] for text in ("A", share)]
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


def test_a_sheet_has_a_row_for_each_run_and_fits_a_page(record: RunRecord) -> None:
    figure = figures.sheet([("above", record, (0, 4, 12)), ("below", record, (1, 2, 3))])
    titles = [axes.get_title().split(" · ")[0] for axes in figure.axes]
    assert titles == ["start", "round 4", "round 10", "round 1", "round 2", "round 3"], (
        "a run that ended shows its last"
    )
    assert figure.get_figwidth() == 7.16
    assert [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()] == ["above", "below"]
    sizes = [text.get_fontsize() for text in figure.findobj(mpl.text.Text) if text.get_text()]  # pyright: ignore
    assert min(sizes) >= 6.0 and "simulated language models" in words(figure)


def test_title_says_what_was_flown_and_that_it_was_simulated(record: RunRecord) -> None:
    said = words(figures.snapshots(record))
    assert "circle · 5 robots" in said and "simulated:ideal" in said and "simulated language models" in said
    real = replace(record, run=record.run.model_copy(update={"simulated": False}))
    assert "simulated language models" not in words(figures.snapshots(real))
    assert "simulated language models" in model_names([real, record])
    rules = {"protocol": {"protocol": "paper", "consensus": "influence", "assignment": "nearest-free", "shield": False}}
    ruled = replace(record, run=record.run.model_copy(update={"config": rules}))
    assert heading(ruled, 10).startswith("circle · 5 robots · protocol: paper · simulated:ideal")
    assert max(len(line) for line in heading(ruled, 3).splitlines()) <= 45


def test_without_calls_the_configured_model_is_named(record: RunRecord) -> None:
    assert model_names([replace(record, llm=())]) == "simulated:ideal · simulated language models"
    run = record.run.model_copy(update={"config": {}, "simulated": False})
    assert model_names([replace(record, llm=(), run=run)]) == ""


@pytest.mark.parametrize("rounds", [[], [-1], [0, 11]])
def test_rounds_that_the_record_lacks_are_refused(record: RunRecord, rounds: list[int]) -> None:
    with pytest.raises(InputError, match="0 to 10"):
        figures.snapshots(record, rounds)


def test_errors_of_one_label_are_averaged_with_t_intervals() -> None:
    from scipy import stats  # takes a second to import

    curves = [np.array([4.0, 2.0, 1.0]), np.array([6.0, 4.0]), np.array([5.0, 6.0, 3.0])]
    mean, lows, highs = figures.mean_and_interval(curves)
    assert mean == pytest.approx([5.0, 4.0, 8.0 / 3.0])
    for k, sample in enumerate([[4, 6, 5], [2, 4, 6], [1, 4, 3]]):
        low, high = stats.t.interval(0.95, 2, loc=np.mean(sample), scale=stats.sem(sample))
        assert (lows[k], highs[k]) == pytest.approx((max(0.0, low), high))
    alone, *none = figures.mean_and_interval(curves[:1])
    assert alone.tolist() == [4.0, 2.0, 1.0] and np.isnan(none).all()


def test_error_over_time_draws_a_line_per_label_with_a_band(tmp_path: Path) -> None:
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
    assert figures.outcome(replace(good, result=None)) == "broke off: 1 plan, 4 goals"


def test_records_and_labels_must_fit(record: RunRecord) -> None:
    with pytest.raises(InputError, match="at least one record"):
        figures.error_over_time([], [])
    with pytest.raises(InputError, match="one label for each of the 2 records"):
        figures.comparison([record, record], ["only one"])
    rows = tuple(row.model_copy(update={"procrustes_mean": None}) for row in record.metrics)
    with pytest.raises(InputError, match="known after every round"):
        figures.error_over_time([replace(record, metrics=rows)], ["free text"])
    assert "error" not in words(figures.snapshots(replace(record, metrics=rows)))


@pytest.mark.parametrize(
    ("kind", "width"), [("snapshots", 3.5), ("snapshots", 7.16), ("error", 3.5), ("comparison", 7.16)]
)
def test_figure_of_a_column_keeps_its_width_and_letters(
    record: RunRecord, tmp_path: Path, kind: str, width: float
) -> None:
    drawn = {
        "snapshots": lambda: figures.snapshots(record, [0, 1, 2, 3], width=width, font=9.0),
        "error": lambda: figures.error_over_time([record], ["a"], width=width, font=9.0),
        "comparison": lambda: figures.comparison([record, record], ["a", "b"], width=width, font=9.0),
    }[kind]()
    assert drawn.axes[0].xaxis.label.get_fontsize() == 9.0
    figures.save(drawn, tmp_path / "figure.pdf")
    content = (tmp_path / "figure.pdf").read_bytes()
    box = re.search(rb"/MediaBox \[ ?0 0 ([0-9.]+)", content)
    assert box is not None and float(box[1]) == pytest.approx(72 * width, abs=0.1)
    assert b"/Subtype /Type3" not in content and b"/FontFile2" in content, "journals refuse letters of Type 3"


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
