"""Animations as GIF files."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from sample_records import make_record

from llm_flock.errors import InputError
from llm_flock.record.reader import RunRecord, read_record
from llm_flock.record.scene import PALETTE
from llm_flock.viz.animation import HOLD_S, STEPS_A_ROUND, animate, frames


@pytest.fixture
def record(tmp_path: Path) -> RunRecord:
    return read_record(make_record(tmp_path / "run.mcap", n=5, rounds=4))


def test_a_gif_shows_every_round_for_its_time(record: RunRecord, tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.gif"
    animate(record, path, fps=10)
    shown: list[int] = []
    with Image.open(path) as picture:
        assert picture.info["loop"] == 0
        for k in range(getattr(picture, "n_frames", 0)):
            picture.seek(k)
            shown.append(picture.info["duration"])
    # Pillow joins frames that are equal, so times are counted, not frames.
    assert sum(shown) == 100 * STEPS_A_ROUND * 4 + 1000 * HOLD_S
    assert shown[-1] >= 1000 * HOLD_S


def test_frames_are_of_one_size_and_move(record: RunRecord) -> None:
    pictures = list(frames(record))
    assert len(pictures) == 1 + STEPS_A_ROUND * 4
    assert len({picture.size for picture in pictures}) == 1
    for one, two in itertools.pairwise(pictures[:7]):
        assert one.tobytes() != two.tobytes()


def test_no_frame_keeps_what_the_last_one_drew(record: RunRecord) -> None:
    """The start holds white robots only; colours of plans in it would be left over, and later ones have them."""
    first, *_, last = (np.asarray(picture).reshape(-1, 3) for picture in frames(record))
    blue = [int(PALETTE[0][i : i + 2], 16) for i in (1, 3, 5)]
    assert not (first == blue).all(axis=1).any()
    assert (last == blue).all(axis=1).sum() > 500


def test_colours_of_plans_survive_in_the_gif(record: RunRecord, tmp_path: Path) -> None:
    animate(record, tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as picture:
        picture.seek(getattr(picture, "n_frames", 1) - 1)
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    blue = [int(PALETTE[0][i : i + 2], 16) for i in (1, 3, 5)]
    assert (pixels == blue).all(axis=1).sum() > 500
    assert (pixels == 255).all(axis=1).mean() > 0.5


def test_same_record_same_file(record: RunRecord, tmp_path: Path) -> None:
    for name in ("a.gif", "b.gif"):
        animate(record, tmp_path / name)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_what_cannot_be_written_is_named(record: RunRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"ends in \.gif or \.mp4"):
        animate(record, tmp_path / "a.avi")
    with pytest.raises(InputError, match="fps = 0"):
        animate(record, tmp_path / "a.gif", fps=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="can be written to"):
        animate(record, tmp_path / "file" / "a.gif")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="once ffmpeg is installed"):
        animate(record, tmp_path / "a.mp4")
    assert not list(tmp_path.glob("a.*"))
