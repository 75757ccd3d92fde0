"""Stored configurations are data: nothing that they name is opened, imported, called or written."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from pydantic import BaseModel
from sample_records import FakeRun, run_info
from sample_trials import stored_trial
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.errors import FlockError, RecordError
from llm_flock.mission import build_mission
from llm_flock.record import read_record
from llm_flock.record._schema import Entry, RunInfo
from llm_flock.record._writer import RecordWriter
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._schedule import TrialConfig
from llm_flock.validation import fields_of
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_lab._exam.rows import read_rows
from llm_flock_lab._experiments.store import Store, read_trial
from llm_flock_lab._experiments.tables import export_csv
from llm_flock_lab._report import gallery
from llm_flock_lab._report.results import Results
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_view._figures.style import whole_file

REPOSITORY = Path(__file__).parents[2]
_watching: list[Path] = []
_seen: list[str] = []


def _note(event: str, args: tuple[Any, ...]) -> None:
    """Note what a stranger's file must not cause: anything outside the watched folder and this program."""
    if not _watching:
        return
    if event == "open" and isinstance(args[0], str | bytes):
        path, flags = os.path.realpath(os.fsdecode(args[0])), args[2] if isinstance(args[2], int) else 0
        own = [str(_watching[0]), str(Path(tempfile.gettempdir(), "llm-flock-")), os.devnull]
        if not flags & (os.O_WRONLY | os.O_RDWR):
            own += [sys.prefix, sys.base_prefix, str(REPOSITORY), "/usr", "/etc/ld", "/proc", "/sys"]
        if not path.startswith(tuple(own)):
            _seen.append(f"open {path}")
    elif event == "import" and str(args[0]).startswith("stranger"):
        _seen.append(f"import {args[0]}")
    elif event in ("socket.connect", "socket.getaddrinfo", "socket.gethostbyname", "os.system"):
        _seen.append(event)
    elif event == "subprocess.Popen" and args[0] not in ("git", "uname"):  # what a record says of its machine
        _seen.append(f"start {args[0]}")


sys.addaudithook(_note)  # cannot be taken away again


@contextmanager
def nothing_outside(folder: Path) -> Iterator[None]:
    """Fail if anything outside of a folder is opened, imported, started or connected to."""
    _seen.clear()
    _watching.append(folder.resolve())
    try:
        yield
    finally:
        _watching.clear()
    assert not _seen


@pytest.fixture
def names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Sequence[str]:
    """What a stranger may name: a file, a pipe that blocks, code, a model, an address, a file to write."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret.csv").write_text("1,2\nroot:x:0\n")
    (outside / "stranger.py").write_text("class Stranger: ...\n")
    (outside / "stranger.gguf").write_text("GGUF")
    os.mkfifo(outside / "pipe")
    monkeypatch.chdir(outside)
    files = [str(outside / name) for name in ("secret.csv", "pipe", "new")]
    forms = [*files, *(f"points:{file}" for file in files[:2]), f"replay:{files[1]}", f"local:{outside}/stranger.gguf"]
    return [*forms, "stranger:Stranger", "openai:gpt-5", "http://127.0.0.1:9/v1"]


def walked(model: type[BaseModel], value: Any) -> Iterator[dict[str, Any]]:
    """For each field of a model, at any depth, fields that give it the value, or a list of lists with it."""
    for field, info in fields_of(model).items():
        yield from ({field: given} for given in (value, [[value]]))
        parts = [info.annotation, *get_args(info.annotation)]
        for inner in [part for part in parts if fields_of(part)][:1]:
            yield from ({field: given} for one in walked(inner, value) for given in (one, [one]))


def variants(model: type[RunConfig], names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Stored configurations, each with one hostile value in one field."""
    plain = model(mission=build_mission(n_robots=3), trial=TrialConfig(rounds=1)).model_dump(mode="json")
    yield plain
    known = {name: info.annotation for name, info in RunConfig.model_fields.items() if model is not RunConfig}
    for name in names:
        for fields in walked(model, name):
            ((section, given),) = fields.items()
            if known.get(section) is model.model_fields[section].annotation:
                continue  # a section of every run
            yield {**plain, section: {**plain[section], **given} if isinstance(given, dict) else given}
        for shape in ({"shape": name}, {"points": name}):
            yield {**plain, "trial": {**plain["trial"], "changes": [{"round": 1, "robot": 0, "set": shape}]}}


@pytest.mark.parametrize("model", [RunConfig, SwarmConfig, FlightConfig])
def test_reading_a_stored_configuration_reaches_nothing(
    model: type[RunConfig], names: Sequence[str], tmp_path: Path
) -> None:
    kept: list[str] = []
    with nothing_outside(tmp_path / "results"):
        for values in variants(model, names):
            with suppress(FlockError):
                config, outside = model.stored(values)
                assert not outside or config == model.stored(config.model_dump(mode="json"))[0]
                kept += outside
    named = {"model", "base_url", "prompts", "record_llm", "out", "consensus", "assignment"}
    assert (named if model is RunConfig else {"keys"} if model is SwarmConfig else {"cache", "robot"}) <= {*kept}


def test_a_stored_trial_that_is_flown_again_reaches_nothing(
    names: Sequence[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All fields of the configuration, by the gallery of a report, which flies failed trials again."""
    monkeypatch.setattr(gallery, "snapshots", lambda *_: None)
    store, outside = Store(tmp_path / "results"), tmp_path / "outside"
    for number, values in enumerate(variants(RunConfig, names)):
        with suppress(FlockError):
            RunConfig.stored(values)  # reports refuse a folder of others
            store.save(stored_trial(f"t{number}", config=values))
    there = sorted(outside.iterdir())
    with nothing_outside(store.folder):
        sources = [failure.source for failure in gallery.gallery(Results.read(store.folder), 10_000)]
    assert sum("flown again from" in source for source in sources) == 1
    assert sum("not flown again: its configuration names" in source for source in sources) > 50
    assert not any("root:" in source for source in sources) and sorted(outside.iterdir()) == there


class _Stored:
    """Writes a record whose configuration is another."""

    def __init__(self, writer: RecordWriter, config: dict[str, Any]) -> None:
        self._writer, self._config = writer, config

    def write(self, entry: Entry) -> None:
        self._writer.write(run_info(config=self._config) if isinstance(entry, RunInfo) else entry)


COMMANDS = ("inspect", "figure", "export --html", "export --foxglove", "view --no-browser --port 1 --host 256.0.0.1")


def test_commands_that_show_a_record_reach_nothing(names: Sequence[str], tmp_path: Path) -> None:
    for number, name in enumerate(names[::3]):
        path = tmp_path / "results" / str(number) / "run.mcap"
        config: dict[str, Any] = {
            section: dict.fromkeys(fields_of(info.annotation), name)
            for model in (RunConfig, SwarmConfig, FlightConfig)
            for section, info in model.model_fields.items()
        }
        with RecordWriter(path) as writer:
            FakeRun(n=3, rounds=2).write(_Stored(writer, config))
        with nothing_outside(tmp_path / "results"):
            read_record(path).html()
            for command in COMMANDS[: 5 if number == 0 else 1]:
                verb, *flags = command.split()
                CliRunner().invoke(app, [verb, str(path), *flags])


def test_a_stored_trial_names_its_own_record_only(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for record in ("/etc/passwd", "../records/a.mcap", "records/b.mcap"):
        store.save(stored_trial("a", record=record))
        with pytest.raises(RecordError, match="its record is another file"):
            read_trial(store.trial_path("a"))


def test_links_and_pipes_in_a_folder_of_results_lead_nowhere(names: Sequence[str], tmp_path: Path) -> None:
    store, outside = Store(tmp_path / "results"), tmp_path / "outside"
    store.save(stored_trial("a", record="records/a.mcap"))
    for link in ("sweep.toml", "plan.json", "records/a.mcap"):
        (store.folder / link).symlink_to(outside / "pipe")
    with nothing_outside(store.folder):
        results = Results.read(store.folder)
        (failure,) = gallery.gallery(results, 1, fly_again=False)
    assert results.planned is None and failure.source.startswith("No record was kept")
    (outside / "b.json").write_bytes(msgspec.json.encode(stored_trial("b")))
    for target in (outside / "b.json", outside / "pipe"):
        store.trial_path("b").symlink_to(target)
        with nothing_outside(store.folder), pytest.raises(RecordError, match="not a file of this folder"):
            Results.read(store.folder)
        store.trial_path("b").unlink()
    (store.folder / "row.json").symlink_to(outside / "pipe")
    with nothing_outside(store.folder), pytest.raises(FlockError, match="a row of the leaderboard"):
        read_rows(store.folder)


def test_what_is_written_into_a_strangers_folder_follows_no_link(names: Sequence[str], tmp_path: Path) -> None:
    store, secret = Store(tmp_path / "results"), tmp_path / "outside" / "secret.csv"
    store.save(stored_trial("a"))
    before = secret.read_text()
    for link in ("trials.csv", "rounds.csv", "figure.png", "figure.part.png"):
        (store.folder / link).symlink_to(secret)
    with nothing_outside(store.folder):
        export_csv(store.folder, store.folder)
        with whole_file(store.folder / "figure.png") as part:
            part.write_text("a picture")
    assert secret.read_text() == before and (store.folder / "figure.png").read_text() == "a picture"
    assert not (store.folder / "trials.csv").is_symlink()
