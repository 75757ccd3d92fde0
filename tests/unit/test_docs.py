"""What README and docs tell a reader to type exists: make targets, commands, flags, fields, files."""

from __future__ import annotations

import csv
import functools
import importlib
import itertools
import re
import shlex
import sys
import tomllib
from pathlib import Path
from typing import Any, get_args

import pytest
import typer.main

from llm_flock import plugins
from llm_flock.bounds import MAX_PROGRAM_BYTES
from llm_flock.cli import app
from llm_flock.formation import Element, Group, Program, parse_program
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._result import Summary
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_lab._experiments.sweep_file import load_sweep
from llm_flock_swarm._network.config import SwarmConfig

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))
from_code: Any = importlib.import_module("from_code")

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
IDS = [str(page.relative_to(ROOT)) for page in PAGES]

FENCE = re.compile(r"^```([^\n`]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`([^`\n]+)`")
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


def code_in(text: str) -> list[str]:
    """Lines of shell code, in blocks and in spans; continued lines are joined."""
    blocks = [body for language, body in FENCE.findall(text) if language in ("bash", "sh", "shell", "console")]
    lines = [line for body in blocks for line in body.replace("\\\n", " ").splitlines()]
    return lines + SPAN.findall(FENCE.sub("", text))


def make_targets() -> set[str]:
    """Targets that the Makefile offers."""
    return set(re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def mentioned_targets(line: str) -> list[str]:
    """Targets of a `make` command on this line."""
    match = re.match(r"\s*(?:\$ )?make((?: [A-Za-z0-9=_.-]+)*)", line)
    return [] if match is None else [word for word in match[1].split() if "=" not in word]


@functools.cache
def commands() -> dict[str, set[str]]:
    """Every command of the command line, with the options that it takes."""

    def options(command: Any) -> set[str]:
        own = {"--help", "--help-all"} | {
            opt for param in command.params for opt in (*param.opts, *param.secondary_opts)
        }
        return own.union(*(options(part) for part in getattr(command, "commands", {}).values()))

    group: Any = typer.main.get_command(app)
    return {name: options(command) for name, command in group.commands.items()}


def faults_in(line: str, known: dict[str, set[str]]) -> list[str]:
    """Commands and options of `llm-flock` on this line that do not exist."""
    line = line.split(" #")[0].replace("...", "")
    match = re.search(r"(?:^|/|\s)llm-flock\s+(.*)", line)
    if match is None:
        flags = re.fullmatch(r"(--[a-z-]+)(?:[ =].*)?", line.strip())
        everywhere = set().union(*known.values())
        return [] if flags is None or flags[1] in everywhere else [flags[1]]
    words = shlex.split(match[1].strip("[]"))
    if not words or words[0].startswith("-"):
        return []
    if words[0] not in known:
        return [words[0]]
    options = {word.split("=")[0] for word in words[1:] if word.startswith("-") and not re.match(r"-\d", word)}
    return sorted(options - known[words[0]])


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_commands_and_links_of_a_page_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    known = commands()
    assert {target for line in code_in(text) for target in mentioned_targets(line)} <= make_targets()
    assert [fault for line in code_in(text) for fault in faults_in(line, known)] == []
    links = [link for link in LINK.findall(text) if "://" not in link]
    assert [link for link in links if not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", [page for page in PAGES if "```toml" in page.read_text(encoding="utf-8")])
def test_configuration_examples_are_valid(page: Path, tmp_path: Path) -> None:
    for language, body in FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "toml":
            found = tomllib.loads(body)
            if "project" in found:  # an entry point of a distribution of one's own
                assert found["project"]["entry-points"].keys() <= {
                    f"llm_flock.{kind}" for kind in get_args(plugins.Kind)
                }
            elif "draw" in found:
                parse_program(found)
            elif "sweep" in found:
                (tmp_path / "sweep.toml").write_text(body, encoding="utf-8")
                assert load_sweep(tmp_path / "sweep.toml").trials
            else:
                kind = FlightConfig if "fleet" in found else SwarmConfig if "network" in found else RunConfig
                kind.model_validate(found)


def test_the_language_of_programs_is_on_its_page() -> None:
    page = (
        (ROOT / "docs" / "reference" / "formations.md")
        .read_text(encoding="utf-8")
        .partition("## Formation programs")[2]
    )
    fields = {*Program.model_fields, *Group.model_fields, *Element.model_fields}
    assert {name for name in fields if f"`{name}`" not in page} == set()
    assert f"{MAX_PROGRAM_BYTES:,} bytes" in page


def test_tests_that_pages_name_exist() -> None:
    existing = {
        name
        for file in (*ROOT.glob("tests/**/test_*.py"), *ROOT.glob("packages/*/tests/**/test_*.py"))
        for name in (file.name, *re.findall(r"^def (test_\w+)\(", file.read_text(encoding="utf-8"), re.MULTILINE))
    }
    examples = {"test_my_model", "test_my_own_model", "test_my_prompts", "test_my_shape"}
    for page in (*PAGES, *(ROOT / "docs" / "data").glob("*.csv")):
        named = {Path(span).name for span in SPAN.findall(FENCE.sub("", page.read_text(encoding="utf-8")))}
        assert {name for name in named if name.startswith("test_")} <= existing | examples, page.name


def test_every_page_is_in_a_table_of_contents() -> None:
    docs = ROOT / "docs"
    listed: set[Path] = {docs / "index.md"}
    for index in docs.rglob("index.md"):
        for body in re.findall(r"```\{toctree\}\n(.*?)```", index.read_text(encoding="utf-8"), re.DOTALL):
            names = [line for line in body.splitlines() if line and not line.startswith(":")]
            listed |= {index.parent / f"{name}.md" for name in names}
    assert listed == set(docs.rglob("*.md"))


@pytest.mark.parametrize(
    ("line", "faults"),
    [
        ("llm-flock run --nonsense 3", ["--nonsense"]),
        (".venv/bin/llm-flock dance", ["dance"]),
        ("llm-flock run --seed 3", []),
        ("--no-such-flag", ["--no-such-flag"]),
        ("pip install llm-flock", []),
    ],
)
def test_the_check_itself_finds_faults(line: str, faults: list[str]) -> None:
    assert faults_in(line, {"run": {"--seed"}}) == faults


def test_every_file_of_figures_has_its_command() -> None:
    with (ROOT / "docs" / "data" / "commands.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(row["What was asked"] and row["Command"] for row in rows)
    known = commands()
    assert [fault for row in rows for line in SPAN.findall(row["Command"]) for fault in faults_in(line, known)] == []
    files = {path.name for path in (ROOT / "docs" / "data").iterdir()} - {"commands.csv", "theorem-tests.csv"}
    assert {row["File"] for row in rows} == files


def test_every_key_of_the_summary_is_documented() -> None:
    documented = [name for name, _ in from_code.commented(Summary.__module__, "Summary")]
    assert documented == list(Summary.__dataclass_fields__)


GLOSSARY = (ROOT / "docs" / "reference" / "glossary.md").read_text(encoding="utf-8")
GLOSSARY_NAMES = sorted(
    {
        name
        for line in GLOSSARY.splitlines()
        if line.startswith("| ")
        for name in SPAN.findall(line.rstrip("| ").rpartition("|")[2])
    }
)


def found(name: str) -> bool:
    """Whether a dotted name below the package is a module, or an attribute of one."""
    parts = name.split(".") if name.startswith("llm_flock") else ["llm_flock", *name.split(".")]
    for k in range(len(parts), 0, -1):
        try:
            thing: Any = importlib.import_module(".".join(parts[:k]))
        except ImportError:
            continue
        try:
            functools.reduce(getattr, parts[k:], thing)
        except AttributeError:
            return False
        return True
    return False


def test_the_glossary_has_forty_terms_with_their_code() -> None:
    terms = [line for line in GLOSSARY.splitlines() if line.startswith("| ") and not line.startswith("| Term ")]
    assert 0 < len(terms) <= 40
    assert all(SPAN.findall(line.split("|")[-2]) for line in terms)


@pytest.mark.parametrize("name", GLOSSARY_NAMES)
def test_the_code_that_the_glossary_names_exists(name: str) -> None:
    assert found(name)


PAPER = (ROOT / "docs" / "explanation" / "the-paper-in-this-code.md").read_text(encoding="utf-8")
PAPER_NAMES = sorted({name for name in SPAN.findall(PAPER) if re.fullmatch(r"[a-z_]+(\.\w+)+", name)})


@pytest.mark.parametrize("name", PAPER_NAMES)
def test_the_code_of_the_paper_exists(name: str) -> None:
    assert found(name)


def test_a_name_that_does_not_exist_is_noticed() -> None:
    assert not found("agent.Mind") and not found("protocol.talks") and found("agent.Agent.goal")


def test_every_package_and_module_says_what_it_is_for() -> None:
    files = [path for top in from_code.TOPS for path in top.rglob("*.py")]
    assert [path.name for path in files if not from_code.first_line(path)] == []
    assert {"llm_flock_swarm._trust", "record", "protocol._agreement"} <= {name for name, _ in from_code.packages()}


def test_the_layers_are_those_of_the_import_contract() -> None:
    named = {name for _, name in from_code.by_layer()}
    top = {path.stem for path in from_code.SOURCE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert named == top - {"__init__"}


def test_the_written_table_of_layers_is_the_contract() -> None:
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text(encoding="utf-8")
    table = page.partition("| Layer | Purpose |\n|---|---|\n")[2].partition("\n\n")[0]
    layers: dict[int, set[str]] = {}
    for number, name in from_code.by_layer():
        layers.setdefault(number, set()).add(name)
    assert [set(SPAN.findall(line.split("|")[1])) for line in table.splitlines()] == list(layers.values())


def test_constants_are_read_with_value_and_meaning(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        'A = 3\n"""Rounds\nto wait."""\nB = 4\n_C = 5\n"""Private."""\nD, E = 1, 2\n"""Two."""\nF = 6  # a share\n'
    )
    two = ("D, E", "(1, 2)", "Two.")
    assert from_code.constants(module) == [("A", "3", "Rounds to wait."), two, ("F", "6", "A share.")]


def test_events_that_every_phase_takes_are_drawn_once() -> None:
    edges = [("a", "Go", ["b"]), ("b", "Go", ["a"]), ("a", "Hear", ["a"]), ("b", "Hear", ["a", "b"])]
    assert from_code.everywhere(edges) == ["Hear"]
    edges += [("a", "Stop", ["end"]), ("b", "Stop", ["end"])]
    assert from_code.final(edges, "Stop") == "end" and not from_code.final(edges, "Go")


def test_each_promise_of_security_names_tests_that_exist() -> None:
    text = (ROOT / "docs" / "reference" / "security.md").read_text(encoding="utf-8")
    rows = [line for line in text.partition("| Promise |")[2].splitlines()[2:] if line.startswith("| ")]
    promises = list(itertools.takewhile(lambda line: not line.startswith("| Input"), rows))
    named = [re.findall(r"`([a-z/-]*tests/\w+/[\w/]+\.py)`", line) for line in promises]
    assert len(promises) > 15 and all(named)
    assert [path for paths in named for path in paths if not (ROOT / path).is_file()] == []
    assert len(text.split()) <= 1_500
