"""Animations as MP4 files, by a stand-in for ffmpeg and, where it is installed, by ffmpeg itself."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest
from sample_records import make_record

from llm_flock.errors import InputError
from llm_flock.record._reader import RunRecord, read_record
from llm_flock_view._figures.animation import HOLD_S, STEPS_A_ROUND, animate, frames

FFMPEG = shutil.which("ffmpeg")

STAND_IN = """#!{python}
import sys
arguments = sys.argv[1:]
width, height = map(int, arguments[arguments.index("-s") + 1].split("x"))
data = sys.stdin.buffer.read()
frames, rest = divmod(len(data), 3 * width * height)
open(arguments[-1], "w").write(f"{{frames}} {{rest}} {{arguments[arguments.index('-r') + 1]}} {{width}} {{height}}")
"""

REFUSES = """#!{python}
import sys
sys.exit("no such encoder")
"""


@pytest.fixture
def record(tmp_path: Path) -> RunRecord:
    return read_record(make_record(tmp_path / "run.mcap", n=4, rounds=3))


def install(script: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = folder / "bin" / "ffmpeg"
    path.parent.mkdir()
    path.write_text(script.format(python=sys.executable))
    path.chmod(0o755)
    monkeypatch.setenv("PATH", str(path.parent))


def test_ffmpeg_gets_every_frame_whole_and_the_last_for_a_while(
    record: RunRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(STAND_IN, tmp_path, monkeypatch)
    animate(record, tmp_path / "a.mp4", fps=5)
    count, rest, fps, width, height = map(int, (tmp_path / "a.mp4").read_text().split())
    assert (width, height) == next(frames(record)).size
    # The encoder takes even sizes only.
    assert width % 2 == height % 2 == 0
    assert (rest, fps) == (0, 5)
    assert count == 1 + STEPS_A_ROUND * 3 + HOLD_S * 5


def test_the_reason_of_ffmpeg_is_passed_on(record: RunRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(REFUSES, tmp_path, monkeypatch)
    with pytest.raises(InputError, match="no such encoder"):
        animate(record, tmp_path / "a.mp4")


@pytest.mark.skipif(FFMPEG is None, reason="ffmpeg is not installed")
def test_with_ffmpeg_itself(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "short.mcap", n=2, rounds=1))
    animate(record, tmp_path / "a.mp4")
    assert (tmp_path / "a.mp4").read_bytes()[4:8] == b"ftyp"
    animate(record, tmp_path / "a.webm")
    assert (tmp_path / "a.webm").read_bytes()[:4] == b"\x1aE\xdf\xa3"
