"""The only module that writes to the terminal. No text that leaves it can control one."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TypeVar

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from llm_flock.printable import printable

P = TypeVar("P")


class Screen(Console):
    """rich's console, without control characters in the text; its own colours and movements pass."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The segments to be written, with cleaned text."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))

    def on_broken_pipe(self) -> None:
        """End the program if standard output is closed; raise BrokenPipeError if it was standard error.

        rich would redirect standard output in both cases.
        """
        if self.stderr:
            raise BrokenPipeError(errno.EPIPE, "standard error is closed")
        super().on_broken_pipe()

    def show(self, table: Table, copied: Collection[str] = ()) -> None:
        """Print a table of texts, or a list of its rows if the table would cut words.

        Columns whose header is in `copied` hold text to copy: these, and those that do not wrap, get no line break.
        """
        heads = [Text.from_markup(str(column.header)) for column in table.columns]
        columns = [[Text.from_markup(str(cell)) for cell in column.cells] for column in table.columns]
        whole = [head.plain in copied or column.no_wrap for head, column in zip(heads, table.columns, strict=True)]
        if not table.show_header:
            whole[:1] = [True]  # names
        widths = _widths(heads, columns, whole, self.width - 3 * len(columns) - 1)
        if widths is not None:
            for column, width in zip(table.columns, widths, strict=True):
                column.width = width
            self.print(table)
            return
        if table.title:
            self.print(table.title, style="italic", soft_wrap=True)
        named = [head.plain.replace("\n", " ") for head in heads[1:]]
        names = max(map(cell_len, named if table.show_header else (cell.plain for cell in columns[0])), default=0)
        for first, *rest in zip(*columns, strict=True):
            if not table.show_header:
                self.print(Text.assemble((first.plain.ljust(names + 2), "dim"), *rest), soft_wrap=True)
                continue
            self.print(first, style="bold", soft_wrap=True)
            for name, cell in zip(named, rest, strict=True):
                if cell.plain:
                    self.print(Text(f"  {name.ljust(names)}  ").append_text(cell), soft_wrap=True)


def _widths(
    heads: Sequence[Text], columns: Sequence[Sequence[Text]], whole: Sequence[bool], room: int
) -> list[int] | None:
    """Widths of columns that cut no word, and no line of `whole` columns; None if there is not enough room."""
    least: list[int] = []
    most: list[int] = []
    for head, cells, uncut in zip(heads, columns, whole, strict=True):
        texts = [head.plain, *(cell.plain for cell in cells)]
        most.append(max(cell_len(line) for text in texts for line in text.split("\n")))
        words = [cell_len(word) for text in texts for word in text.split()]
        least.append(most[-1] if uncut else max(words, default=0))
    spare, wanted = room - sum(least), sum(most) - sum(least)
    if spare < 0:
        return None
    share = min(1.0, spare / wanted) if wanted else 0.0
    return [low + int(share * (high - low)) for low, high in zip(least, most, strict=True)]


def say(text: object, *, error: bool = False) -> None:
    """Print a line: to standard output, or to standard error."""
    print(printable(str(text)), file=sys.stderr if error else sys.stdout, flush=True)


def while_shown(show: Callable[[P], None]) -> Callable[[P], None]:
    """A function that calls `show`, which writes to standard error, and does nothing once that is closed."""

    def shown(what: P) -> None:
        try:
            show(what)
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stderr.fileno())
            os.close(nowhere)

    return shown
