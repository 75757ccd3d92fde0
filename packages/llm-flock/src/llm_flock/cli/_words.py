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
    from llm_flock.mission import Mission
    from llm_flock.runtime._config import RunConfig

Words = Annotated[str | None, typer.Option(help="Mission in words, which --reader reads", show_default=False)]
Edit = Annotated[str | None, typer.Option(help="Change of the drawing in words, such as 'wider'", show_default=False)]
ReaderModel = Annotated[
    str | None,
    typer.Option(
        "--reader",
        help="Model that reads words, or simulated:reader:FILE, which knows the sentences of a JSON file [--model]",
        show_default=False,
    ),
]
Yes = Annotated[bool, typer.Option("--yes", help="Fly what the reader made of the words, without asking")]


def confirmed_draft(
    settings: RunConfig,
    base: Mission,
    words: str | None,
    edit: str | None,
    reader: str | None,
    *,
    yes: bool,
    flying: bool = False,
) -> MissionDraft:
    """What a reader made of words or of an edit, shown and confirmed; `base` is what is flown, or set up.

    Raises:
        InputError: both or neither were given, the words cannot be flown, or nobody can be asked.
        typer.Exit: it was not confirmed.
    """
    if (words is None) == (edit is None):
        raise InputError("words", words, says="either --words or --edit")
    from llm_flock.llm import MissionReader

    reads = MissionReader(reader or settings.model.model, settings.model.typed_url)
    work = reads.read(words, base, flying=flying) if words is not None else reads.edit(edit or "", base, flying=flying)
    draft = asyncio.run(work)
    say(draft.in_words, error=True)
    if not yes:
        if not sys.stdin.isatty():
            raise InputError("yes", None, says="nobody can be asked here: add --yes to fly this")
        typer.confirm("Fly this?", abort=True, err=True)
    return draft
