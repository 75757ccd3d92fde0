"""Objects of the user's own code, by `package.module:name`: found in the current folder too."""

from __future__ import annotations

import asyncio
import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from llm_flock.errors import InputError


def load_own(field: str, name: str, allowed: str) -> Any:
    """The object that the operator named as `package.module:name`. Importing runs the module's code.

    Never call it with a name from a record or from stored results: those may come from anywhere.

    Raises:
        InputError: for `field`, with what is `allowed`: the name has another form, or the import fails.
    """
    module, colon, path = name.partition(":")
    if not colon:
        raise InputError(field, name, allowed)
    try:
        found: Any = _import(module)
        for part in path.split("."):
            found = getattr(found, part)
    except Exception as error:
        kind = "" if isinstance(error, ImportError | AttributeError | ValueError) else f"{type(error).__name__}: "
        raise InputError(field, name, f"{allowed} ({kind}{error})") from error
    return found


def _import(module: str) -> ModuleType:
    """Import a module; one that is not installed may be in the current folder, which scripts do not search."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        here = str(Path.cwd())
        # Last in the path: no installed module is ever replaced by a file that happens to lie here.
        if error.name != module.partition(".")[0] or here in sys.path or sys.flags.safe_path:
            raise
        sys.path.append(here)
    importlib.invalidate_caches()
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        sys.path.remove(here)
        raise


def shown(error: BaseException) -> str:
    """An exception of a user's code in words, also one that has none."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001 - a user's code may raise anything, here too
        return f"{type(error).__name__}, which cannot be shown"


def is_cancelled() -> bool:
    """Whether the running task is being cancelled. A user's code may also raise a cancellation of its own."""
    task = asyncio.current_task()
    return task is None or task.cancelling() > 0
