"""Teach a small model to plan and to step: examples, training, evaluation, and an adapter file."""

from __future__ import annotations

import importlib
from typing import Any

from llm_flock.extras import require


def need(module: str) -> Any:
    """Import a module of the extra `distill` where it is used; InputError if the extra is not installed."""
    require("distill", "distill")
    return importlib.import_module(module)
