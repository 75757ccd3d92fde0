"""Runs code that the user names as `package.module:name`, and describes its exceptions."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from llm_flock.errors import InputError


def load_own(field: str, name: str, allowed: str) -> Any:
    """The object that the operator named as `package.module:name`. Importing runs the module's code.

    A module that is not installed is also looked for in the current folder.

    Never call it with a name from a record or from stored results: those may come from anywhere.

    Raises:
        InputError: for `field`, with what is `allowed`: the name has another form, or the import fails.
    """
    module, colon, path = name.partition(":")
    if not colon:
        raise InputError(field, name, allowed)
    try:
        value: Any = _import(module)
        for part in path.split("."):
            value = getattr(value, part)
    except Exception as error:
        kind = "" if isinstance(error, ImportError | AttributeError | ValueError) else f"{type(error).__name__}: "
        raise InputError(field, name, f"{allowed} ({kind}{error})") from error
    return value


def _import(module: str) -> ModuleType:
    """Import a module, if need be from the current folder, which scripts do not search."""
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


def describe_exception(error: BaseException) -> str:
    """A one-line description of an exception, even if its `__str__` raises."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001 - user code may raise anything, here too
        return f"{type(error).__name__}, which cannot be shown"
