"""Provenance of a run: versions, and revision of the code."""

from __future__ import annotations

import os
import subprocess
from importlib import metadata
from pathlib import Path

_PACKAGES = (
    *("llm-flock", "numpy", "scipy", "pydantic", "pydantic-ai-slim", "openai", "anthropic", "jinja2", "mcap"),
    "xllamacpp",
)


def versions() -> dict[str, str]:
    """Versions of this package and of those that can change a result."""
    found: dict[str, str] = {}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def git_revision() -> str | None:
    """Revision of the checkout that this package runs from, `+dirty` with local changes; None outside a checkout."""
    here = Path(__file__).parent
    try:
        revision = _git(here, "rev-parse", "HEAD")
        changed = _git(here, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{revision}+dirty" if changed else revision


def _git(folder: Path, *arguments: str) -> str:
    # Asked by many workers at once: none of them may lock the index, and on a full machine this takes seconds.
    done = subprocess.run(
        ["git", "-C", str(folder), *arguments],
        env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
        capture_output=True,
        text=True,
        timeout=60.0,
        check=True,
    )
    return done.stdout.strip()
