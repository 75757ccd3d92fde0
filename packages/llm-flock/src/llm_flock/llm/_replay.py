"""Cassettes: files with every conversation of a run, one attempt a line, and a model that answers from them.

A cassette is JSON Lines. The first line is `{"llm_flock_cassette": 1}`, with `"simulated": true` if a stand-in may have
answered; each further line is a `CassetteLine`.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, fields, replace
from itertools import zip_longest
from pathlib import Path
from typing import IO, Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from llm_flock.bounds import check_plain
from llm_flock.errors import BudgetExceeded, InputError, ModelError, RecordError, ReplayDrift
from llm_flock.llm._port import Amount, Attempt, Call, ChatMessage, Kind, Reply, Usage
from llm_flock.planner import PlanQuestion

logger = logging.getLogger(__name__)

VERSION = 1
HEADER = "llm_flock_cassette"
MAX_LINE_LENGTH = 1 << 26
"""Lines of a cassette are shorter [bytes]."""


Plain = Annotated[dict[str, Any], AfterValidator(check_plain)]  # values that a record can hold


class CassetteLine(BaseModel):
    """One attempt, with the fields of `port.Attempt`, `Call` and `Reply`.

    Without an answer, `text` is null and `error` has the reason.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    robot: int
    round: int
    attempt: int
    kind: Kind
    request_hash: str
    messages: tuple[ChatMessage, ...]
    answer_schema: dict[str, Any] | None
    model: str
    settings: Plain
    text: str | None
    parsed: Plain | None
    rejected: str | None
    error: tuple[str, str] | None
    usage: Usage
    cost_usd: Amount | None
    latency_s: Amount
    faults: tuple[str, ...]
    finish_reason: str | None
    thought: bool
    clipped: str | None


class _Cassette:
    """An open file; a context manager."""

    _file: IO[Any]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class CassetteWriter(_Cassette):
    """An `AttemptSink` that writes each attempt as soon as it is over; a context manager.

    A killed run loses at most the last line. An existing file is never touched. `simulated` is whether a stand-in may
    answer, which the names of models may not show.
    """

    def __init__(self, path: Path, *, simulated: bool = False) -> None:
        try:
            self._file = path.open("x", encoding="ascii", newline="\n")
        except FileExistsError:
            raise InputError("record_llm", str(path), "a file that does not exist yet") from None
        except OSError as error:
            raise InputError("record_llm", str(path), f"a file that can be created ({error.strerror})") from None
        self._write({HEADER: VERSION, "simulated": True} if simulated else {HEADER: VERSION})

    def __call__(self, attempt: Attempt) -> None:
        """Write one line, the fields of a `CassetteLine`."""
        values = attempt.told() | {"answer_schema": attempt.call.schema}
        self._write({name: values[name] for name in CassetteLine.model_fields})

    def _write(self, line: dict[str, Any]) -> None:
        # ASCII escapes keep any answer, lone surrogates included, on one line that reads back exactly.
        text = json.dumps(line, separators=(",", ":"), allow_nan=False, default=asdict)
        try:
            self._file.write(text + "\n")
            self._file.flush()
        except OSError as error:
            raise RecordError(f"{self._file.name}: cannot be written ({error.strerror})") from None


class ReplayModel(_Cassette):
    """A `LanguageModel` that answers from a cassette, by (robot, round, attempt), in any order.

    It keeps only the offset of each line in memory. It repeats usage, cost, latency, faults and failures as recorded.
    Ask it directly: `limits.Limited` would retry a second time. RecordError for a damaged cassette.
    """

    def __init__(self, path: Path) -> None:
        self.name = f"replay:{path}"
        self._path = path
        self.models: set[str] = set()
        """Names of the models in the cassette."""
        self.exhausted = False
        """Whether it has repeated an error of a used-up budget."""
        self._plans: set[tuple[int, int]] = set()
        self._marked = False
        try:
            with ExitStack() as opened:
                self._file = opened.enter_context(path.open("rb"))
                self._offsets = self._index()
                opened.pop_all()
        except OSError as error:
            raise InputError("model", f"replay:{path}", f"a cassette that can be read ({error.strerror})") from None

    @property
    def simulated(self) -> bool:
        """Whether a simulated stand-in answered in the recorded run."""
        return self._marked or any(model.startswith("simulated:") for model in self.models)

    def was_asked(self, question: PlanQuestion) -> bool:
        """Whether the robot's model was asked for a plan in this round."""
        return (question.robot, question.round) in self._plans

    async def ask(self, call: Call) -> Reply:
        """The recorded answer or error; ReplayDrift if there is no such attempt, or another question."""
        line = self._read(call)
        if line.error is not None:
            kind, detail = line.error
            self.exhausted |= kind == "budget"
            error = BudgetExceeded(detail) if kind == "budget" else ModelError(kind, detail)
            error.faults = line.faults
            error.model = line.model
            raise error
        values: dict[str, Any] = {field.name: getattr(line, field.name) for field in fields(Reply)}
        return replace(Reply(**values), text=line.text or "")

    def _read(self, call: Call) -> CassetteLine:
        where = _key_text(call.robot, call.round, call.attempt)
        offset = self._offsets.get((call.robot, call.round, call.attempt))
        if offset is None:
            rounds = [r for robot, r, _ in self._offsets if robot == call.robot]
            extent = f"rounds {min(rounds)} to {max(rounds)}" if rounds else "nothing"
            raise ReplayDrift(f"{self._path}: no {call.kind} recorded for {where}; it holds {extent} of this robot")
        self._file.seek(offset)
        line = CassetteLine.model_validate_json(self._file.readline())
        if line.request_hash != call.request_hash or line.kind != call.kind:
            raise ReplayDrift(f"{self._path}: another question than recorded for {where}\n{_difference(line, call)}")
        return line

    def _index(self) -> dict[tuple[int, int, int], int]:
        """Byte offset of every attempt; checks the whole file, line by line."""
        offsets: dict[tuple[int, int, int], int] = {}
        self._check_header(self._file.readline(MAX_LINE_LENGTH))
        for number, raw in enumerate(iter(lambda: self._file.readline(MAX_LINE_LENGTH), b""), start=2):
            if len(raw) == MAX_LINE_LENGTH:
                raise RecordError(f"{self._path}, line {number}: damaged: a line of {MAX_LINE_LENGTH} bytes or more")
            try:
                line = CassetteLine.model_validate_json(raw)
            except ValidationError as error:
                if not raw.endswith(b"\n"):
                    logger.warning("%s: line %d was cut off in writing and is left out", self._path, number)
                    break
                first = error.errors()[0]
                at = ".".join(map(str, first["loc"])) or "line"
                raise RecordError(f"{self._path}, line {number}: damaged: {at}: {first['msg']}") from None
            key = (line.robot, line.round, line.attempt)
            if key in offsets:
                raise RecordError(f"{self._path}, line {number}: {_key_text(*key)} is there twice")
            offsets[key] = self._file.tell() - len(raw)
            self.models.add(line.model)
            if line.kind == "plan":
                self._plans.add((line.robot, line.round))
        return offsets

    def _check_header(self, raw: bytes) -> None:
        try:
            header = json.loads(raw)
            version = header[HEADER]
            self._marked = header.get("simulated") is True
        except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
            raise RecordError(f"{self._path}: not a cassette: its first line must hold {HEADER!r}") from None
        if version != VERSION:
            raise RecordError(f"{self._path}: cassette version {version!r}; this program reads version {VERSION}")


def _key_text(robot: int, round_: int, attempt: int) -> str:
    return f"robot {robot}, round {round_}, attempt {attempt}"


def _difference(line: CassetteLine, call: Call) -> str:
    """The first line in which this question differs from the recorded one, of limited length."""
    recorded = _lines(line.kind, line.messages, line.answer_schema)
    asked = _lines(call.kind, call.messages, call.schema)
    for was, is_now in zip_longest(recorded, asked, fillvalue=""):
        if was != is_now:
            return f"-{was[:300]}\n+{is_now[:300]}"
    return "the texts are equal: the recorded hash does not fit its own line"


def _lines(kind: str, messages: tuple[ChatMessage, ...], schema: Mapping[str, Any] | None) -> list[str]:
    text = [line for message in messages for line in (f"[{message.role}]", *message.text.splitlines())]
    form = [] if schema is None else [f"[schema] {json.dumps(schema, sort_keys=True)}"]
    return [f"kind: {kind}", *text, *form]
