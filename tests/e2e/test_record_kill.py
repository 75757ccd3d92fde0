"""A record survives its writer: the process is killed at random moments, and all it had finished can be read."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from llm_flock.errors import RecordError
from llm_flock.record._reader import read_record

TESTS = Path(__file__).parents[1]

WRITER = """
import os, signal, sys
from pathlib import Path
from sample_records import FakeRun
from llm_flock.record._schema import RoundEnd
from llm_flock.record._writer import RecordWriter

def say(number):
    os.write(1, b"%d\\n" % number)  # at once: a killed process says a whole line or none

class Telling(RecordWriter):
    def write(self, entry):
        super().write(entry)
        if isinstance(entry, RoundEnd):
            say(entry.round)

def write(path, rounds):
    with Telling(Path(path)) as writer:
        say(os.getpid())
        if not int(rounds):
            os.kill(os.getpid(), signal.SIGKILL)
        FakeRun(n=10, rounds=int(rounds)).write(writer)

for line in sys.stdin:
    child = os.fork()
    if child == 0:
        write(*line.rsplit(maxsplit=1))
    print("ended", os.waitpid(child, 0)[1], flush=True)
"""
"""Forks a writer for each path and number of rounds that it reads. The writer says its id, and each finished round."""


@pytest.fixture(scope="module")
def writers() -> Iterator[subprocess.Popen[str]]:
    environment = os.environ | {"PYTHONPATH": str(TESTS)}
    command = [sys.executable, "-c", WRITER]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, text=True
    ) as process:
        yield process


def lines(process: subprocess.Popen[str], path: Path, rounds: int) -> Iterator[list[str]]:
    """What the writer of this path says, until it has ended."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(f"{path} {rounds}\n")
    process.stdin.flush()
    while True:
        yield (line := process.stdout.readline().split())
        if line[0] == "ended":
            return


@pytest.mark.parametrize("trial", range(6))
def test_all_rounds_that_were_finished_can_be_read(writers: subprocess.Popen[str], tmp_path: Path, trial: int) -> None:
    path = tmp_path / "run.mcap"
    said = lines(writers, path, 10_000)
    (pid,) = next(said)
    told = [int(*next(said))]  # round 0 is finished
    time.sleep(random.Random(trial).uniform(0.0, 0.3))
    os.kill(int(pid), signal.SIGKILL)
    *rounds, ended = said
    told += [int(*line) for line in rounds]
    assert ended == ["ended", str(int(signal.SIGKILL))]

    record = read_record(path)
    assert not record.complete
    # The process may have died after finishing a round and before telling of it.
    assert record.rounds in (told[-1], told[-1] + 1)
    assert [state.round for state in record.states] == list(range(record.rounds + 1))
    assert len(record.llm) == len(record.events) == 10 * record.rounds
    assert json.loads(record.states[-1].encoded())["round"] == record.rounds


def test_writer_killed_before_first_round_leaves_a_clear_error(writers: subprocess.Popen[str], tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    assert list(lines(writers, path, 0))[-1] == ["ended", str(int(signal.SIGKILL))]
    with pytest.raises(RecordError, match=r"empty file|nothing to show"):
        read_record(path)
