"""Provenance of a run: versions, revision of the code, machine."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from llm_flock.record.schema import RunInfo
from llm_flock.runtime.config import RunConfig

PACKAGES = (
    "llm-flock",
    "numpy",
    "scipy",
    "pydantic",
    "pydantic-ai-slim",
    "openai",
    "anthropic",
    "jinja2",
    "mcap",
    "xllamacpp",
)


def run_info(config: RunConfig, *, simulated: bool, weights: Mapping[str, str] | None = None) -> RunInfo:
    """The first message of a record: what is run, with which versions, and where.

    Args:
        config: without the paths of its files: the same run elsewhere leaves the same record.
        simulated: whether any language model is a simulated stand-in.
        weights: digests of the files of local models, by name.
    """
    return RunInfo(
        format_version=1,
        config=config.model_dump(mode="json", exclude={"trial": {"out"}, "model": {"record_llm"}}),
        versions={**versions(), **(weights or {})},
        git_revision=git_revision(),
        seed=config.trial.seed,
        simulated=simulated,
        created_at=now(),
        environment=environment(),
    )


def versions() -> dict[str, str]:
    """Versions of this package and of those that can change a result."""
    found: dict[str, str] = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def environment() -> dict[str, str]:
    """Interpreter and machine, without any name or path."""
    return {"python": platform.python_version(), "platform": platform.platform(), "machine": platform.machine()}


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
    done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=5, check=True)
    return done.stdout.strip()


def now() -> str:
    """The present moment, UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")
