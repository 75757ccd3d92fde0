"""The recordings of an exam: one for each session, counted for the budget, compared with the results, and joined."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import ValidationError

from llm_flock.errors import RecordError
from llm_flock.exam.ask import SCRIPT, Outcome
from llm_flock.experiments.store import write_whole
from llm_flock.llm.port import Usage
from llm_flock.llm.replay import HEADER, VERSION, CassetteLine

MOST_NAMED = 3
"""Most questions that an error names."""


@dataclass(slots=True, kw_only=True)
class Conversations:
    """What the sessions of an exam recorded.

    Attributes:
        header: first line of the recordings; None where none was written whole.
        lines: the newest conversation of each robot and `round_of` its question, line by line.
        calls: calls of the model, those of questions that were cut off or asked again included.
        usage: tokens of these calls.
        cost_usd: money, as far as prices are known [US dollars].
    """

    header: str | None = None
    lines: dict[tuple[int, int], list[str]] = field(default_factory=dict[tuple[int, int], list[str]])
    calls: int = 0
    usage: Usage = field(default_factory=Usage)
    cost_usd: float = 0.0

    def check(self, outcomes: Iterable[Outcome], rounds: Iterable[int], folder: Path) -> None:
        """Check that the answers to some results are there; `rounds` holds `round_of` each of them.

        Raises:
            RecordError: one is not, so that its row could not be asked again.
        """
        known = {round_ for _, round_ in self.lines}
        lost = [o.question for o, round_ in zip(outcomes, rounds, strict=True) if o.calls and round_ not in known]
        if lost:
            named = ", ".join(lost[:MOST_NAMED]) + (", ..." if len(lost) > MOST_NAMED else "")
            says = f"{len(lost)} results have no recording ({named}); put the missing part back, or give another --out"
            raise RecordError(f"{folder}: {says}")

    def save(self, path: Path) -> bool:
        """Write one recording, which `replay:FILE` can answer from; False where there is nothing to write.

        Raises:
            RecordError: the file cannot be written; it is as it was.
        """
        if self.header is None:
            return False
        lines = [self.header, *(line for lines in self.lines.values() for line in lines)]
        write_whole(path, ("\n".join(lines) + "\n").encode("ascii"))
        return True


def read_parts(parts: Sequence[Path]) -> Conversations:
    """Read the recordings of all sessions, in their order.

    A line that was cut off when its session was killed is left out. A question that was cut off was asked again: its
    last conversation counts.

    Raises:
        RecordError: a part cannot be read, is no recording, or is damaged.
    """
    found = Conversations()
    for part in parts:
        session: dict[tuple[int, int], list[str]] = {}
        for number, text in enumerate(_whole_lines(part), start=1):
            if number == 1:
                found.header = _header(part, text) if found.header is None else found.header
                continue
            try:
                line = CassetteLine.model_validate_json(text)
            except ValidationError as error:
                says = error.errors(include_url=False)[0]["msg"]
                raise RecordError(f"{part}, line {number}: damaged: {says}") from None
            session.setdefault((line.robot, line.round), []).append(text)
            if line.model != SCRIPT:
                found.calls += line.error is None or line.error[0] != "budget" or bool(line.faults)
                found.usage += line.usage
                found.cost_usd += line.cost_usd or 0.0
        found.lines |= session
    return found


def _whole_lines(part: Path) -> list[str]:
    try:
        return part.read_text(encoding="ascii").split("\n")[:-1]
    except OSError as error:
        raise RecordError(f"{part}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise RecordError(f"{part}: not a recording of an exam (it is no ASCII text)") from None


def _header(part: Path, text: str) -> str:
    try:
        version = json.loads(text)[HEADER]
    except (ValueError, TypeError, LookupError, RecursionError):
        raise RecordError(f"{part}: not a recording: its first line must hold {HEADER!r}") from None
    if version != VERSION:
        raise RecordError(f"{part}: recording of version {version!r}; this program reads version {VERSION}")
    return text
