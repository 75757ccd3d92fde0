"""`llm-flock view`: look at runs in a browser."""

from __future__ import annotations

from llm_flock.viewer.command import view

__all__ = ["view"]
