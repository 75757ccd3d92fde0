"""The leaderboard: its page is what the rows say, and what is not its own is left alone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from command_line import flock

from llm_flock.errors import InputError
from llm_flock_lab._exam.leaderboard import PAGE, page_text, publish
from llm_flock_lab._exam.questions import SECTIONS
from llm_flock_lab._exam.rows import Row, read_rows
from llm_flock_lab._exam.splits import paper

FOLDER = Path(__file__).parents[4] / "docs" / "leaderboard"
ROWS = read_rows(FOLDER)
IDEAL = next(row for row in ROWS if row.model == "simulated:ideal")


def test_the_page_is_what_the_command_writes() -> None:
    assert (FOLDER / PAGE).read_text(encoding="utf-8") == page_text(ROWS), "llm-flock exam --page docs/leaderboard"


def test_stand_ins_are_apart_and_labelled() -> None:
    models, stand_ins = (FOLDER / PAGE).read_text(encoding="utf-8").split("## Stand-ins")
    assert "simulated:" not in models and "`geometry`" not in models
    rows = [line for line in stand_ins.split("### How")[0].splitlines() if line.startswith("| `simulated:")]
    assert len(rows) >= 8 and all("*simulated*" in line for line in rows)
    assert {"geometry", "local:smollm2", "local:smollm2+none"} <= {row.model for row in ROWS if not row.simulated}


def test_every_row_has_all_questions_of_its_sections() -> None:
    stand_ins = [row for row in ROWS if row.stand_in]
    assert {row.questions for row in stand_ins} == {IDEAL.questions} and {row.count for row in stand_ins} == {726}
    for row in ROWS:
        assert row.count == sum(found.questions for found in row.sections.values())
        assert (row.total is None) == ({*row.sections} != {*SECTIONS}), "totals are over the same sections"
    assert IDEAL.count == len(paper()) and "benchmarks.twenty_lines:Short" in {row.model for row in stand_ins}


def test_no_total_is_surer_than_its_sections_allow() -> None:
    for row in (row for row in ROWS if row.total is not None):
        assert row.total is not None
        widest = max(found.first.high - found.first.low for found in row.sections.values())
        assert row.total.high - row.total.low >= widest / len(row.sections) - 1e-5, row.model


def test_rows_and_page_are_written_and_added_to(tmp_path: Path) -> None:
    other = IDEAL.model_copy(update={"model": "simulated:other", "split": "private 7"})
    assert [path.name for path in publish(tmp_path, [IDEAL])] == ["simulated-ideal.json", PAGE]
    assert [path.name for path in publish(tmp_path, [other])] == ["simulated-other-private-7.json", PAGE]
    assert read_rows(tmp_path) == [IDEAL, other]
    assert (tmp_path / PAGE).read_text(encoding="utf-8") == page_text([other, IDEAL])


def test_a_row_of_other_questions_or_models_is_not_replaced(tmp_path: Path) -> None:
    publish(tmp_path, [IDEAL])
    publish(tmp_path, [IDEAL])  # the same exam again
    with pytest.raises(InputError, match="a row of 726 questions; one of 1 goes into another folder"):
        publish(tmp_path, [IDEAL.model_copy(update={"count": 1})])
    with pytest.raises(InputError, match=r"simulated-ideal\.json is the row of simulated:ideal"):
        publish(tmp_path, [IDEAL.model_copy(update={"model": "simulated:ideal!"})])
    assert read_rows(tmp_path) == [IDEAL]


def test_taught_scores_stay_with_the_same_prompts(tmp_path: Path) -> None:
    publish(tmp_path, [IDEAL.model_copy(update={"taught": {"step": 0.5}})])
    publish(tmp_path, [IDEAL])
    assert read_rows(tmp_path)[0].taught == {"step": 0.5}
    publish(tmp_path, [IDEAL.model_copy(update={"prompts": "0" * 16})])
    assert read_rows(tmp_path)[0].taught is None


def test_a_page_of_somebody_else_is_left_alone(tmp_path: Path) -> None:
    page = tmp_path / PAGE
    page.write_text("# My notes\n", encoding="utf-8")
    with pytest.raises(InputError, match="not written by this command"):
        publish(tmp_path, [IDEAL])
    assert [path.name for path in tmp_path.iterdir()] == [PAGE] and page.read_text() == "# My notes\n"


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        (r'"model": "[^"]*",', "", "field 'model' is missing"),
        (r'"seconds": [0-9.e-]+', '"seconds": 1' + "0" * 400, "seconds = "),
        (r'"count": \d+', '"count": "many"', "count = "),
        (r"\{", "", ""),
        (r'"model"', '"modle": 1, "model"', "unknown field 'modle'"),
    ],
)
def test_a_file_that_is_no_row_is_named_with_its_field(old: str, new: str, where: str, tmp_path: Path) -> None:
    (tmp_path / "row.json").write_text(re.sub(old, new, IDEAL.model_dump_json(indent=1), count=1), encoding="utf-8")
    done = flock("exam", "--page", str(tmp_path), cwd=tmp_path, check=False)
    assert done.returncode == 2 and f"a row of the leaderboard ({where}" in done.stderr, done.stderr
    assert done.stderr.count("\n") == 1


def test_no_name_of_a_model_breaks_the_table() -> None:
    text = page_text([Row(**{**dict(IDEAL), "answered_by": "a|b\n| c |", "simulated": False})])
    columns = {len(re.findall(r"(?<!\\)\|", line)) for line in text.splitlines() if "a&#124;b" in line}
    header = next(line for line in text.splitlines() if "Answered by" in line)
    assert columns == {header.count("|")}


def test_the_entry_for_inspects_register_names_the_task() -> None:
    # The fields and types of inspect-evals 0.26.
    yaml = pytest.importorskip("yaml")
    entry: dict[str, Any] = yaml.safe_load((FOLDER / "inspect-register.yaml").read_text(encoding="utf-8"))
    (task,) = entry["tasks"]
    assert task["dataset_samples"] == len(paper())
    code = (FOLDER.parents[1] / task["task_path"]).read_text(encoding="utf-8")
    assert re.findall(r"^@task\ndef (\w+)", code, re.MULTILINE) == [task["name"]] == ["exam"]
    words = "full_title", "common_title", "description"
    assert all(isinstance(entry[word], str) and "\n" not in entry[word] for word in words)
    assert set(entry) == {*words, "contributors", "tags", "tasks", "metadata", "source"}
    assert set(entry["source"]) == {"repository_url", "repository_commit"}
