"""Makes text safe to show: text of models, records and robots must not control a terminal, or mislead a reader."""

from __future__ import annotations

import logging
import re

_HIDDEN = re.compile(
    "["
    "\x00-\x08\x0b-\x1f\x7f-\x9f"  # control characters but tab and line feed: escape sequences, carriage returns
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u206f"  # direction: text that turns around
    "\u00ad\u180e\u200b\u2060-\u2065\ufeff\ufff9-\ufffb\U000e0000-\U000e0fff"  # invisible letters
    "\u2028\u2029\ud800-\udfff"  # other line breaks; half characters, which no terminal can be sent
    "]"
)
"""Characters that change how a terminal, or a reader, takes the text around them."""


FORMULA = "^[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]"
"""Beginning of a text that spreadsheets read as a formula, also in full width: a pattern for `re` and Polars."""


def hidden(text: str) -> str | None:
    """The first hidden character of a text, line break or tab; None without one."""
    match = re.search(f"[\t\n]|{_HIDDEN.pattern}", text)
    return None if match is None else match[0]


def printable(text: str) -> str:
    """The text with such characters written out as escapes; line breaks and tabs stay. Call before showing it."""
    return _HIDDEN.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def one_line(text: str, most: int = 1_000) -> str:
    """As `printable`, in one line of at most `most` characters: foreign text must not begin a line."""
    text = printable(text[: most + 1]).replace("\n", "\\n").replace("\t", "\\t")
    return text if len(text) <= most else f"{text[: most - 3]}..."


def csv_cell(text: str) -> str:
    """The text for a cell of a CSV file, with a quote before it if a spreadsheet would read it as a formula.

    See OWASP, CSV injection. Only texts need it: a negative number is no formula.
    """
    return f"'{text}" if re.match(FORMULA, text) else text


class CleanFormatter(logging.Formatter):
    """Formats log records as printable text."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as text."""
        return printable(super().format(record))


def log_to_stderr() -> None:
    """Show warnings. Call once, at the start of a process."""
    handler = logging.StreamHandler()
    handler.setFormatter(CleanFormatter("%(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    logging.captureWarnings(True)  # libraries quote names and labels in theirs
