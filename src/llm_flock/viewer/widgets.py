"""The drawn parts as elements of a page: arena, time line and plots share one clock in the browser."""

from __future__ import annotations

from typing import Any

from nicegui.element import Element

from llm_flock.viewer.parts import Part


class Drawing(Element, component="static/panel.js", esm={"llm-flock-viewer": "static"}):
    """One drawn part.

    Args:
        part: what is drawn.
    """

    def __init__(self, part: Part) -> None:
        super().__init__()
        self._props["kind"] = part.kind
        self._props["options"] = part.options

    def tell(self, name: str, *given: Any) -> None:
        """Call a method of the part in the browser."""
        self.run_method("call", name, *given)
