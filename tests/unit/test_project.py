"""The project's own files: pins that work anywhere, and a changelog that keeps up."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


LOCK = (ROOT / "requirements.txt").read_text(encoding="utf-8").replace("\\\n", "").splitlines()
"""What `make setup` installs: a requirement and its hashes on one line."""


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
    declared = [*PROJECT["dependencies"], *(d for extra in PROJECT["optional-dependencies"].values() for d in extra)]
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
        for path in (ROOT / "src").rglob("*.py")
        for name in re.findall(r"^class ([A-Z]\w*)", path.read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert [name for name, count in found.items() if count > 1] == []
