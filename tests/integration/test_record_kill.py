"""A record survives its writer: the process is killed at random moments, and all it had finished can be read."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from llm_flock.errors import RecordError
from llm_flock.record.reader import read_record

TESTS = Path(__file__).parents[1]

WRITER = """
import sys
from pathlib import Path
from sample_records import FakeRun
from llm_flock.record.schema import RoundEnd
from llm_flock.record.writer import RecordWriter

class Telling(RecordWriter):
    def write(self, entry):
        super().write(entry)
        if isinstance(entry, RoundEnd):
            print(entry.round, flush=True)

with Telling(Path(sys.argv[1])) as writer:
    fake = FakeRun(n=10, rounds=10_000)
    fake.write(writer)
"""


@pytest.mark.parametrize("trial", range(6))
def test_all_rounds_that_were_finished_can_be_read(tmp_path: Path, trial: int) -> None:
    path = tmp_path / "run.mcap"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS), str(TESTS.parent / "src")])}
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, env=environment, text=True
    )
    assert process.stdout is not None
    told = [int(process.stdout.readline())]  # started, and round 0 is finished
    time.sleep(random.Random(trial).uniform(0.0, 0.3))
    process.send_signal(signal.SIGKILL)
    told += [int(line) for line in process.stdout.read().splitlines()]
    process.stdout.close()
    assert process.wait() == -signal.SIGKILL

    record = read_record(path)
    assert not record.complete
    # The process may have died after finishing a round and before telling of it.
    assert record.rounds in (told[-1], told[-1] + 1)
    assert [state.round for state in record.states] == list(range(record.rounds + 1))
    assert len(record.llm) == len(record.events) == 10 * record.rounds
    assert json.loads(record.states[-1].encoded())["round"] == record.rounds


def test_a_writer_killed_before_its_first_round_leaves_a_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    code = WRITER.replace("fake.write(writer)", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS), str(TESTS.parent / "src")])}
    done = subprocess.run([sys.executable, "-c", code, str(path)], env=environment, check=False)
    assert done.returncode == -signal.SIGKILL
    with pytest.raises(RecordError, match=r"empty file|nothing to show"):
        read_record(path)
