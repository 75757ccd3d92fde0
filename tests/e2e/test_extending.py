"""What `extending.md` and `own-rule.md` of the guides show works as it is written, from an empty folder."""

import json
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

import llm_flock
from llm_flock.testing import check_consensus_rule

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/how-to/extending.md").read_text(encoding="utf-8")
RULE_PAGE = (ROOT / "docs/how-to/own-rule.md").read_text(encoding="utf-8")
BLOCKS = [
    textwrap.dedent(found)
    for found in re.findall(r"^ *```python\n(.*?)^ *```", PAGE + RULE_PAGE, re.MULTILINE | re.DOTALL)
]
FILES = {"my_rules.py": "class LowestSpeaker", "my_models.py": "class Mine"}

# As the installed script starts it: the folder of the script is searched for modules, not the current one.
COMMAND = "from llm_flock.__main__ import main; main()"


def block(words: str) -> str:
    """The one block of code with these words."""
    (found,) = (text for text in BLOCKS if words in text)
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the page's files, and the command beside it."""
    for name, words in FILES.items():
        (tmp_path / "work" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "work" / name).write_text(block(words), encoding="utf-8")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "llm_flock_command.py").write_text(COMMAND, encoding="utf-8")
    return tmp_path / "work"


def command(folder: Path, *words: str) -> str:
    """Run the command in a folder; it must succeed."""
    script = folder.parent / "bin" / "llm_flock_command.py"
    environment = {**os.environ}
    done = subprocess.run(
        [sys.executable, str(script), *words], cwd=folder, env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_rule_in_the_current_folder_flies(folder: Path) -> None:
    words = ("run", "--robots", "4", "--shape", "square", "--rounds", "3", "--no-record", "--quiet")
    assert "my_rules:LowestSpeaker" in command(folder, *words, "--consensus", "my_rules:LowestSpeaker")
    (line,) = (line.split() for line in RULE_PAGE.splitlines() if line.strip().startswith("llm-flock run"))
    told = json.loads(command(folder, *line[1:], "--json"))
    assert told["plans_in_use"] >= 2 and "several plans stay in use" in RULE_PAGE


def test_a_model_in_the_current_folder_flies_for_some_robots(folder: Path) -> None:
    models = "0=my_models:Mine,1-2=simulated:ideal"
    said = command(folder, "run", "--shape", "triangle", "--robots", "3", "--model", models, "--out", "run", "--quiet")
    assert "simulated language models" in said
    record = llm_flock.read_record(folder / "run")
    assert record.run.simulated and record.result is not None and record.result["formed"]
    assert "my_models:Mine" in command(folder, "inspect", "run"), "what cannot be repeated is said"


def test_the_pages_own_tests_pass() -> None:
    names: dict[str, Any] = {"__name__": "page"}
    for words in (*FILES.values(), "def test_my_own_model"):
        exec(block(words), names)
    check_consensus_rule(names["LowestSpeaker"]())
    names["test_my_own_model"]()


def test_the_page_s_shape_flies_and_passes_its_test(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (points,) = re.findall(r"`arrow\.csv`.*?^```text\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    (folder / "arrow.csv").write_text(points, encoding="utf-8")
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {"__name__": "page"}
    exec(block("def test_my_shape"), names)
    names["test_my_shape"]()
    (line,) = (line for line in PAGE.splitlines() if line.startswith("llm-flock run --shape points:"))
    assert "5 robots" in command(folder, *line.split()[1:], "--no-record", "--quiet")


def test_the_pages_model_flies_alone(folder: Path) -> None:
    said = command(
        folder, "run", "--shape", "triangle", "--robots", "3", "--model", "my_models:Mine", "--no-record", "--json"
    )
    summary = json.loads(said)
    assert summary["formed"] and summary["simulated"] and summary["calls_failed"] == 0
