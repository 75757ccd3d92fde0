"""The project's own files: pins that work anywhere, and a changelog that keeps up."""

from __future__ import annotations

import ast
import re
import tomllib
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PARTS = sorted(ROOT.glob("packages/*/pyproject.toml"))
PROJECTS = [tomllib.loads(path.read_text(encoding="utf-8"))["project"] for path in PARTS]
PROJECT = next(project for project in PROJECTS if project["name"] == "llm-flock")


TEXT = (ROOT / "requirements.txt").read_text(encoding="utf-8").replace("\\\n", "")
LOCK = [line for line in TEXT.splitlines() if not line.startswith("# ")]
"""What `make everything` installs: a requirement and its hashes on one line."""


def pins() -> list[str]:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return [line.split(" ")[0] for line in (*LOCK, *lines) if line and not line.startswith("#")]


def normal(name: str) -> str:
    """A package name as the index compares it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def test_pins_are_exact_and_name_no_place() -> None:
    assert pins()
    assert [line for line in pins() if not re.fullmatch(r"[a-z0-9._-]+==[A-Za-z0-9.!+]+", line)] == []


def test_every_file_that_is_installed_has_a_hash() -> None:
    marker = r"( ; [A-Za-z0-9_.' <>=!()]+)?"
    assert len(LOCK) > 100
    for line in LOCK:
        assert re.fullmatch(rf"[a-z0-9.-]+==[A-Za-z0-9.!+]+{marker}( +--hash=sha256:[0-9a-f]{{64}})+", line), line[:80]
    assert [line for line in LOCK if "uv==" in line[:4]], "pip installs uv from here"


def test_every_declared_dependency_is_pinned() -> None:
    declared = [d for project in PROJECTS for d in project.get("dependencies", ())]
    declared += [d for extra in PROJECT["optional-dependencies"].values() for d in extra]
    names = {normal(re.split(r"[^A-Za-z0-9._-]", line)[0]) for line in declared}
    ours = {path.name for path in (ROOT / "packages").iterdir()}
    assert names <= {normal(line.split("==")[0]) for line in pins()} | ours | {"llm-flock"}


def test_the_changelog_speaks_of_this_version() -> None:
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest is not None
    assert newest[1] in ("Unreleased", PROJECT["version"])


def test_a_class_name_is_used_once() -> None:
    found = Counter(
        name
        for path in ROOT.glob("packages/*/src/**/*.py")
        for name in re.findall(r"^class ([A-Z]\w*)", path.read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert [name for name, count in found.items() if count > 1] == []


def test_the_parts_have_one_version() -> None:
    assert {project["version"] for project in PROJECTS} == {PROJECT["version"]}
    ours = [d for project in PROJECTS for d in project.get("dependencies", ()) if d.startswith("llm-flock")]
    assert ours and {d.partition("==")[2] for d in ours} == {PROJECT["version"]}


def private(module: str, name: str = "") -> bool:
    """Whether an import reaches into the core below its public modules."""
    return module.split(".")[0] == "llm_flock" and any(part.startswith("_") for part in f"{module}.{name}".split("."))


def imports(path: Path) -> list[tuple[str, str]]:
    """Module and name of every import of a file."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    found = [(alias.name, "") for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    return found + [
        (node.module or "", alias.name) for node in nodes if isinstance(node, ast.ImportFrom) for alias in node.names
    ]


def test_a_part_imports_only_public_modules_of_the_core() -> None:
    files = list(ROOT.glob("packages/llm-flock-*/src/**/*.py"))
    assert len(files) > 100
    assert [(path.name, *found) for path in files for found in imports(path) if private(*found)] == []
    assert (
        private("llm_flock.llm._port", "Call")
        and private("llm_flock.llm", "_port")
        and not private("llm_flock.llm", "Call")
    )


def test_no_files_import_each_other_in_a_circle() -> None:
    files = {
        ".".join(path.relative_to(src).with_suffix("").parts).removesuffix(".__init__"): path
        for src in ROOT.glob("packages/*/src")
        for path in src.rglob("*.py")
    }
    graph = {
        name: {inner if (inner := f"{module}.{thing}") in files else module for module, thing in imports(path)} - {name}
        for name, path in files.items()
    }
    assert len(graph) > 300
    tuple(TopologicalSorter(graph).static_order())  # raises CycleError, with the circle
    with pytest.raises(CycleError, match="cycle"):
        tuple(TopologicalSorter({**graph, "llm_flock.errors": {"llm_flock.agent"}}).static_order())


def test_names_of_tests_are_short() -> None:
    files = [*ROOT.glob("packages/*/tests/**/test_*.py"), *ROOT.glob("tests/**/test_*.py")]
    names = [name for path in files for name in re.findall(r"def (test_\w+)", path.read_text(encoding="utf-8"))]
    assert len(names) > 2000
    assert [name for name in names if len(name) > 60] == []
