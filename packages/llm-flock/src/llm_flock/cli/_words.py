"""Missions and edits in words on the command line: read by a model, shown, and flown once they are confirmed."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from llm_flock.cli._terminal import say
from llm_flock.errors import InputError

if TYPE_CHECKING:
    from llm_flock.llm import MissionDraft
    from llm_flock.runtime._config import RunConfig

Words = Annotated[str | None, typer.Option(help="Mission in words, which --reader reads", show_default=False)]
EDITS = "Change of the drawing in words, such as 'wider'"
Edit = Annotated[str | None, typer.Option("--edit", help=EDITS, show_default=False)]
READS = "Model that reads words, or simulated:reader:FILE, which knows the sentences of a JSON file [--model]"
ReaderModel = Annotated[str | None, typer.Option("--reader", help=READS, show_default=False)]
CONFIRMS = "Fly what the reader made of the words, without asking"
Yes = Annotated[bool, typer.Option("--yes", help=CONFIRMS)]


def confirmed_draft(
    now: RunConfig, words: str | None, edit: str | None, reader: str | None, *, yes: bool, flying: bool = False
) -> MissionDraft:
    """What a reader made of words or of an edit of the mission `now`, shown and confirmed.

    Raises:
        InputError: not one of words and edit, the reader refuses, or nobody can be asked.
        typer.Abort: it was not confirmed.
    """
    if words is not None and edit is not None:
        raise InputError("edit", edit, says="either --words or --edit")
    from llm_flock.llm import MissionReader

    asked = MissionReader(reader or now.model.model, now.model.typed_url)
    work = asked.edit(edit or "", now.mission) if words is None else asked.read(words, now.mission, flying=flying)
    try:
        draft = asyncio.run(work)
    except InputError as error:  # the reader's fields are no flags that were typed
        says = error.says if error.field == "words" else str(error)
        raise InputError("edit" if words is None else "words", None, says=says) from None
    say(draft.in_words, error=True)
    if not yes and not sys.stdin.isatty():
        raise InputError("yes", None, says="nobody can be asked here: add --yes to fly this")
    if not yes:
        typer.confirm("Fly this?", abort=True, err=True)
    return draft
