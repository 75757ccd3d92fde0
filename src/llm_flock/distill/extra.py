"""What only teaching needs: imported when it is used, and asked for by name where it is missing."""

from __future__ import annotations

import importlib
from typing import Any

from llm_flock.errors import InputError


def need(module: str) -> Any:
    """A module of the extra `distill`.

    Raises:
        InputError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError("distill", module, "used only with its extra: pip install 'llm-flock[distill]'") from None
