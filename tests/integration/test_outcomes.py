"""All that read a record say the same of its outcome: commands, viewer, table, report, notebook and exports."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
from benchmarks import outcomes
from benchmarks.outcomes import BRISK, LONG, ROOT, verdicts
from command_line import flock
from sample_records import make_record

from llm_flock.record import read_record
from llm_flock_view._viewer.data import answer
from llm_flock_view._viewer.library import Library, load

FLY = f"fly --config {ROOT / 'examples' / 'flight.toml'} --yes {BRISK}"
KINDS = {
    "lockstep": ("run --robots 4 --shape square --seed 2", "formed"),
    "a gap": (f"run --robots 6 --seed 4 --kill 3@20 {LONG} 30", "formed"),
    "a gap that is about to be closed": (f"run --robots 6 --seed 4 --kill 3@20 --gaps replan {LONG} 24", "not formed"),
    "swarm": ("swarm --robots 4 --shape square --seed 1", "formed"),
    "flight": (FLY, "formed"),
    "rounds": ("run --robots 6 --seed 4 --rounds 6", "not formed"),
    "budget": ("run --robots 6 --seed 4 --max-calls 20", "not formed"),
    "no plan": ("run --robots 4 --seed 1 --model simulated:malformed", "not formed"),
}


def in_process(*arguments: str) -> str:
    return flock(*arguments, cwd=ROOT, check=False).stdout


def read(record: Path, printed: str) -> dict[str, str]:
    return outcomes.read(record, printed, in_process)


@pytest.mark.parametrize("kind", KINDS)
def test_all_readers_agree_on_the_outcome(tmp_path: Path, kind: str) -> None:
    command, wanted = KINDS[kind]
    fly = outcomes.flock if command.startswith(("swarm", "fly")) else in_process
    printed = fly(*command.split(), "--quiet", "--out", str(tmp_path))
    told = read(tmp_path / "run.mcap", printed)
    assert verdicts(told) == {wanted} and all(told.values()), told
    assert told["viewer"] == told["table"] == told["page"] == told["inspect"].removesuffix(".")
    assert told["notebook"].startswith(told["viewer"])


@pytest.mark.parametrize(("formed", "end"), [(True, "formed since round 10"), (False, "the record ends early")])
def test_all_readers_say_that_a_killed_run_broke_off(tmp_path: Path, formed: bool, end: str) -> None:
    record = tmp_path / "run.mcap"
    if formed:
        command = f"run --robots 6 --seed 4 {LONG} 100000 --quiet --out {tmp_path}"
        outcomes.flock(*command.split(), end=signal.SIGKILL, record=record)
    else:
        make_record(record, n=4, rounds=5, finish=False, agree=False)
    told = read(record, "")
    assert verdicts(told) == {"not formed"} and read_record(record).outcome().ending == "broke off", told
    assert told["viewer"].endswith(end) and told["report"] == "broke off"


def test_two_runs_side_by_side_have_their_own_outcomes(tmp_path: Path) -> None:
    library, said = Library(), list[str]()
    for name, options in (("one", "--protocol baseline --rounds 9"), ("two", "--protocol flock")):
        in_process(*f"run --robots 4 --shape square --seed 2 {options} --quiet --out {tmp_path / name}".split())
        load(library.add(name, tmp_path / name / "run.mcap", live=False))
    for key in library.runs:
        said.append(json.loads(answer(library, f"data/{key}/news", {}) or b"")["outcome"]["headline"])
    assert said == [read_record(tmp_path / name).outcome().headline for name in ("one", "two")]
    assert said[0].startswith("Not formed: all 9 rounds") and said[1].startswith("Formed in round ")
