"""What docs/how-to/drive-an-agent.md shows runs as it is written, and prints what the page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[4] / "docs/how-to/drive-an-agent.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The page's only fenced block in this language."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    return found


def test_the_page_prints_what_it_shows(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(block("python"), "drive-an-agent.md", "exec"), {})
    assert capsys.readouterr().out == block("text")


def test_the_default_rules_give_each_robot_its_own_place(capsys: pytest.CaptureFixture[str]) -> None:
    swapped = block("python").replace("InfluenceConsensus", "ProvenanceConsensus")
    swapped = swapped.replace("agreement.assignment", "agreement.auction").replace("Nearest", "Auction")
    exec(compile(swapped, "drive-an-agent.md", "exec"), {})
    assert sorted(re.findall(r"place (\d)", capsys.readouterr().out)) == ["0", "1", "2"]
