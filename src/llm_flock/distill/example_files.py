"""Files of examples, and examples from the recordings of `--record-llm`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path

from pydantic import ValidationError

from llm_flock.distill.examples import Example
from llm_flock.errors import InputError
from llm_flock.llm.replay import CassetteLine

RECORDED = "recorded"
"""The team of a recorded example: shape and size stand only in its prompt."""


def write_examples(path: Path, examples: Iterable[Example]) -> int:
    """Write examples as JSON lines and return their number."""
    count = 0
    with path.open("w", encoding="utf-8") as file:
        for example in examples:
            file.write(json.dumps(asdict(example)) + "\n")
            count += 1
    return count


def read_examples(path: Path) -> list[Example]:
    """Read what `write_examples` wrote.

    Raises:
        InputError: for field `data`: the file cannot be read, or a line is not an example.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("data", str(path), f"a file of examples that can be read ({error})") from None
    examples: list[Example] = []
    for number, line in enumerate(lines, start=1):
        try:
            examples.append(Example(**json.loads(line)))
        except (TypeError, ValueError) as error:
            raise InputError(
                "data", f"{path}, line {number}", f"an example as `distill data` writes it ({error})"
            ) from None
    if not examples:
        raise InputError("data", str(path), "a file with at least one example")
    return examples


def recorded_examples(path: Path) -> Iterator[Example]:
    """Questions of a run with their accepted answers, as they were asked.

    Questions that were asked again or follow earlier exchanges are left out: an example is one question and one answer.

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
