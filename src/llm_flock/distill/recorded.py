"""Examples from the conversations of real runs, as `--record-llm` keeps them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pydantic import ValidationError

from llm_flock.distill.examples import Example
from llm_flock.errors import InputError
from llm_flock.llm.replay import CassetteLine

RECORDED = "recorded"
"""What stands for shape and size, which a conversation does not tell apart from its words."""


def recorded_examples(path: Path) -> Iterator[Example]:
    """Questions and the answers to them that passed the checks of their run, in the words in which they were asked.

    Answers to questions that were asked again are left out, and so are those in whose question earlier ones are told:
    an example is one question with its answer.

    Raises:
        InputError: for field `cassette`: it cannot be read, or a line is not of a cassette.
    """
    try:
        _, *lines = path.read_text(encoding="ascii").splitlines()
    except (OSError, ValueError) as error:
        raise InputError("cassette", str(path), f"a recording of --record-llm ({error})") from None
    for number, text in enumerate(lines, start=2):
        try:
            line = CassetteLine.model_validate_json(text)
        except ValidationError:
            raise InputError("cassette", f"{path}, line {number}", "a line of a recording of --record-llm") from None
        if line.parsed is None or line.text is None or [m.role for m in line.messages] != ["system", "user"]:
            continue
        system, user = (message.text for message in line.messages)
        kind = "plan" if line.kind == "plan" else "path" if "path" in line.parsed else "step"
        yield Example(kind=kind, system=system, user=user, answer=line.text.strip(), team=RECORDED)
