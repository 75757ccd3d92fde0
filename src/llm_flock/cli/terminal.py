"""The only place of the command line that writes to the terminal: nothing leaves it that drives one."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from llm_flock.printable import printable


class Screen(Console):
    """rich's console: its own colours and movements pass, those in the text do not."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The segments to be written, with cleaned text."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


def say(text: object, *, error: bool = False) -> None:
    """Print a line: to standard output, or to standard error."""
    print(printable(str(text)), file=sys.stderr if error else sys.stdout, flush=True)
