"""Teach a small model to plan and to step: examples, training, evaluation, and an adapter file."""

from __future__ import annotations

import importlib
from typing import Any

from llm_flock.errors import InputError


def need(module: str) -> Any:
    """Import a module of the extra `distill` where it is used; InputError if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError("distill", module, "used only with its extra: pip install 'llm-flock[distill]'") from None
