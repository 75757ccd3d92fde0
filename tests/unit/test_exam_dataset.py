"""The exam as a dataset: a card that names a file for each section, and files that hold the questions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import polars as pl
import pytest
import yaml

from llm_flock.errors import InputError
from llm_flock.exam.dataset import write_dataset
from llm_flock.exam.questions import SECTIONS, read_questions
from llm_flock.exam.session import Paper

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
    assert not list(tmp_path.iterdir())
