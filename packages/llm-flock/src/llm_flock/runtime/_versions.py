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
    describe = ("describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+dirty")
    # Asked by many workers at once: none of them may lock the index, and on a full machine this takes seconds.
    environment = {**os.environ, "GIT_OPTIONAL_LOCKS": "0"}
    command = ["git", "-C", str(Path(__file__).parent), *describe]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
