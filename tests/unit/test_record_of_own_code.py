"""A record is shown and tabulated without the user's own code that it names."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import llm_flock

MODEL = """
class Corners:
    async def ask(self, call):
        return "no usable answer"
"""


def test_record_is_read_without_the_code_that_it_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    monkeypatch.delitem(sys.modules, "my_own_models", raising=False)
    (tmp_path / "my_own_models.py").write_text(MODEL)
    llm_flock.run(n_robots=3, shape="triangle", model="my_own_models:Corners", rounds=1, out=tmp_path / "run")
    del sys.modules["my_own_models"]
    record = llm_flock.read_record(tmp_path / "run")
    assert record._repr_html_() and record.to_polars().height
    assert "my_own_models" not in sys.modules
