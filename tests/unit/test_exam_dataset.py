"""The exam as a dataset: a card that names a file for each section, and files that hold the questions."""

from __future__ import annotations

import ast
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import polars as pl
import pytest
import yaml

from llm_flock.errors import InputError
from llm_flock.exam.dataset import write_dataset
from llm_flock.exam.questions import SECTIONS, read_questions
from llm_flock.exam.session import Paper

ROOT = Path(__file__).parents[2]
PUBLIC = Paper().questions()


def test_each_table_of_the_card_is_a_file_of_its_questions(tmp_path: Path) -> None:
    folder = tmp_path / "exam"
    written = write_dataset(folder, PUBLIC, version=1, split="public")
    assert sorted(folder.iterdir()) == sorted(written)
    _, head, text = (folder / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    configs: list[dict[str, Any]] = yaml.safe_load(head)["configs"]
    assert [config["config_name"] for config in configs] == list(SECTIONS)
    again = [q for c in configs for q in read_questions(folder / c["data_files"][0]["path"])]
    assert sorted(again, key=lambda q: q.id) == sorted(PUBLIC, key=lambda q: q.id)
    for config in configs:
        table = pl.read_ndjson(folder / config["data_files"][0]["path"], infer_schema_length=None)
        assert f"| `{config['config_name']}` | {len(table)} |" in text


def test_no_folder_is_written_over(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="dataset"):
        write_dataset(tmp_path, PUBLIC, version=1, split="public")
    with pytest.raises(InputError, match="dataset"):
        write_dataset(tmp_path / "none" / "exam", PUBLIC, version=1, split="public")
    with pytest.raises(InputError, match=r"dataset = .*cannot be made \(File name too long\)"):
        write_dataset(tmp_path / ("x" * 300), PUBLIC, version=1, split="public")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_breaks_off_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[Path] = []

    def breaks_off(path: Path, text: str, encoding: str) -> None:
        written.append(path)
        path.touch()
        if len(written) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_text", breaks_off)
    with pytest.raises(KeyboardInterrupt):
        write_dataset(tmp_path / "exam", PUBLIC, version=1, split="public")
    assert len(written) == 3 and not list(tmp_path.iterdir())


def test_the_entry_for_the_register_of_inspect_evals_names_the_task() -> None:
    # The fields and types of inspect-evals 0.26, whose own class is asked where it is installed.
    entry: dict[str, Any] = yaml.safe_load(
        (ROOT / "docs/leaderboard/inspect-register.yaml").read_text(encoding="utf-8")
    )
    (task,) = entry["tasks"]
    assert task["dataset_samples"] == len(PUBLIC)
    code = ast.parse((ROOT / task["task_path"]).read_text(encoding="utf-8"))
    tasks = [
        one.name
        for one in ast.walk(code)
        if isinstance(one, ast.FunctionDef)
        and any(isinstance(mark, ast.Name) and mark.id == "task" for mark in one.decorator_list)
    ]
    assert tasks == [task["name"]] == ["exam"]
    words = "full_title", "common_title", "description"
    assert all(isinstance(entry[word], str) and "\n" not in entry[word] for word in words)
    assert set(entry) == {*words, "contributors", "tags", "tasks", "metadata", "source"}
    assert set(entry["source"]) == {"repository_url", "repository_commit"}
    if find_spec("inspect_evals") is not None:
        theirs: Any = import_module("inspect_evals.metadata")
        theirs.ExternalEvalMetadata(**entry, id="llm_flock_exam")
