"""Which entries a journal builds, and for which sinks."""

from __future__ import annotations

import pytest

from llm_flock.events import Note
from llm_flock.llm._port import Attempt, Call, Reply
from llm_flock.mission import Mission
from llm_flock.record._schema import Entry, LlmEntry, NullWriter, ProtocolEvent, RecordSink
from llm_flock.runtime import _journal as journals
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._journal import Journal

CALL = Call(robot=0, round=1, kind="step", attempt=0, messages=())


class Entries:
    """Keeps what it is given."""

    def __init__(self) -> None:
        self.kept: list[Entry] = []

    def write(self, entry: Entry) -> None:
        self.kept.append(entry)


def kept(sink: RecordSink) -> Journal:
    journal = Journal(RunConfig(mission=Mission(shape="line", n_robots=3)), sink)
    journal.note(1, None, 0, Note("proposed", {"plan": "a", "slot": 1, "by": "model"}))
    journal.attempt(Attempt(call=CALL, reply=Reply(text="", model="x", faults=("timeout",)), error=("timeout", "x")))
    journal.flush_attempts()
    return journal


def test_notes_and_calls_are_written_to_the_sink() -> None:
    sink = Entries()
    kept(sink)
    assert [entry.kind for entry in sink.kept if isinstance(entry, ProtocolEvent | LlmEntry)] == ["proposed", "step"]


def test_without_a_reader_calls_are_counted_and_not_written_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journals, "ProtocolEvent", None)
    monkeypatch.setattr(journals, "llm_entry", None)
    journal = kept(NullWriter())
    assert (journal.calls, journal.calls_failed, journal.faults["timeout"]) == (1, 1, 1)
