"""Makes text safe to show: text of models, records and robots must not control a terminal, or mislead a reader."""

from __future__ import annotations

import logging
import re
import unicodedata
from functools import lru_cache

_EMOJI = "[\u2190-\u27ff\u2b00-\u2bff\U0001f000-\U0001faff]"
_JOINED = re.compile(
    rf"(?<={_EMOJI})\ufe0f|\ufe0f(?=\u20e3)|(?:(?<={_EMOJI})|(?<={_EMOJI}\ufe0f))\u200d(?={_EMOJI})"  # within emoji
    "|(?<=[\u0620-\u109f])[\u200c\u200d]"  # after letters of scripts whose forms they change
)
"""Selectors and joiners that draw nothing themselves, where they change what is seen."""

_BLANK = re.compile("(?<!GAP |INE )FILLER$|JOINER$|VOWEL INHERENT|VARIATION SELECTOR|BLANK$|NULL NOTEHEAD$")
"""Names of characters that draw nothing, although their category is that of letters, marks and symbols."""


@lru_cache(maxsize=4096)
def _drawn(letter: str) -> bool:
    """Whether a character is drawn, or a space, and leaves the text around it as it is."""
    # What Python calls not printable is neither, or not assigned, which letters in the blocks of emoji will be.
    space_or_emoji = unicodedata.category(letter) == "Zs" or "\U0001f000" <= letter <= "\U0001faff"
    return (letter.isprintable() or space_or_emoji) and not _BLANK.search(unicodedata.name(letter, ""))


def _seen(found: re.Match[str]) -> bool:
    return _drawn(found[0]) or _JOINED.match(found.string, found.start()) is not None


def hidden(text: str) -> str | None:
    """The first hidden character of a text, line break or tab; None without one."""
    return next((found[0] for found in re.finditer("[^ -~]", text) if not _seen(found)), None)


def _written(found: re.Match[str]) -> str:
    return found[0] if _seen(found) else found[0].encode("unicode_escape").decode("ascii")


def printable(text: str) -> str:
    """The text with such characters written out as escapes; line breaks and tabs stay. Call before showing it."""
    return re.sub("[^ -~\n\t]", _written, text)


def one_line(text: str, most: int = 1_000) -> str:
    """As `printable`, in one line of at most `most` characters: foreign text must not begin a line."""
    text = printable(text[: most + 1]).replace("\n", "\\n").replace("\t", "\\t")
    return text if len(text) <= most else f"{text[: most - 3]}..."


def same_model(asked: str, answered: str) -> bool:
    """Whether `provider:model` agree: the name of one may have a date, a folder or other letter cases besides."""
    one, other = (name.partition(":")[2].casefold() for name in (asked, answered))
    return one in other or other in one


def csv_cell(value: object) -> object:
    """A cell of a CSV file: text as `printable`, quoted if spreadsheets would read a formula (OWASP, CSV injection)."""
    if not isinstance(value, str):
        return value
    text = printable(value)
    return f"'{text}" if re.match("[=+\\-@\t\n\uff1d\uff0b\uff0d\uff20]", text) else text  # some are of full width


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


def shape_title(spec: str) -> str:
    """A shape specification for people: a program by its name instead of its text."""
    if not spec.startswith("program:{"):
        return spec
    name = re.search(r'"name":"([\w .-]*)"', spec)  # in the canonical form; programs have no other text with quotes
    return f"program:{name[1]}" if name else "program"


def counted(count: object, what: str) -> str:
    """A number of things: 1 round, 2 rounds."""
    return f"{count} {what}{'' if count == 1 else 's'}"
