"""Animations as GIF files."""

from __future__ import annotations

import io
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from sample_records import make_record

from llm_flock.errors import InputError
from llm_flock.record._reader import RunRecord, read_record
from llm_flock.record._scene import PALETTE
from llm_flock_view._figures import animation
from llm_flock_view._figures.animation import HOLD_S, KEY_INCHES, STEPS_A_ROUND, animate, ease, frames, gif


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return read_record(make_record(tmp_path_factory.mktemp("record") / "run.mcap", n=5, rounds=3))


@pytest.fixture(scope="module")
def pictures(record: RunRecord) -> list[Image.Image]:
    return [picture.copy() for picture in frames(record)]


@pytest.fixture(scope="module")
def animated(record: RunRecord, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record as a GIF, ten frames a second."""
    path = tmp_path_factory.mktemp("gif") / "new" / "a.gif"
    animate(record, path, fps=10)
    return path


def test_a_gif_shows_every_round_for_its_time(animated: Path) -> None:
    shown: list[int] = []
    with Image.open(animated) as picture:
        assert picture.info["loop"] == 0
        for k in range(getattr(picture, "n_frames", 0)):
            picture.seek(k)
            shown.append(picture.info["duration"])
    # Pillow joins frames that are equal, so times are counted, not frames.
    assert sum(shown) == 100 * STEPS_A_ROUND * 3 + 1000 * HOLD_S
    assert shown[-1] >= 1000 * HOLD_S


def test_frames_are_of_one_size_and_move(pictures: list[Image.Image]) -> None:
    assert len(pictures) == 1 + STEPS_A_ROUND * 3
    assert len({picture.size for picture in pictures}) == 1
    for one, two in itertools.pairwise(pictures[:7]):
        assert one.tobytes() != two.tobytes()


def test_no_frame_keeps_what_the_last_one_drew(pictures: list[Image.Image]) -> None:
    """The start holds white robots only; colours of plans above the key would be left over; later ones have them."""
    drawn = [np.asarray(picture) for picture in (pictures[0], pictures[-1])]
    first, last = (picture[: -int(100 * KEY_INCHES)].reshape(-1, 3) for picture in drawn)
    blue = [int(PALETTE[0][i : i + 2], 16) for i in (1, 3, 5)]
    assert not (first == blue).all(axis=1).any()
    assert (last == blue).all(axis=1).sum() > 500


def test_colours_of_plans_survive_in_the_gif(animated: Path) -> None:
    with Image.open(animated) as picture:
        picture.seek(getattr(picture, "n_frames", 1) - 1)
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    blue = [int(PALETTE[0][i : i + 2], 16) for i in (1, 3, 5)]
    assert (pixels == blue).all(axis=1).sum() > 500
    assert (pixels == 255).all(axis=1).mean() > 0.5


def test_same_record_same_file(record: RunRecord, animated: Path, tmp_path: Path) -> None:
    animate(record, tmp_path / "b.gif", fps=10)
    assert animated.read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_robots_fly_from_rest_to_rest() -> None:
    shares = [ease(k / 100) for k in range(101)]
    assert shares[0] == 0.0 and shares[-1] == 1.0 and shares == sorted(shares)
    assert shares[1] < 0.01 * 0.1 and 1.0 - shares[99] < 0.01 * 0.1


def test_a_gif_that_would_be_too_large_has_fewer_frames(
    record: RunRecord, animated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = animated.read_bytes()
    monkeypatch.setattr(animation, "MAX_GIF_PIXELS", len(whole) - 1)
    with Image.open(io.BytesIO(gif(record, 10))) as fewer, Image.open(io.BytesIO(whole)) as all_of_them:
        assert fewer.n_frames < all_of_them.n_frames  # pyright: ignore
        shown = [picture.info["duration"] for picture in (fewer, all_of_them)]
    assert shown[0] == 2 * shown[1], "as fast as before"


def test_a_long_title_keeps_to_one_line(record: RunRecord) -> None:
    long = record.run.model_copy(update={"config": {"protocol": {"consensus": "c" * 90, "assignment": "a" * 200}}})
    plain, titled = (np.asarray(next(frames(r, last=True))) for r in (record, replace(record, run=long)))
    assert (titled[:, :2] == 255).all() and (titled[:, -2:] == 255).all(), "nothing is cut at the edges"
    below = int(100 * 0.3)
    assert (titled[below:-60] == plain[below:-60]).mean() > 0.999, "and it is nowhere else"


def test_animation_names_what_it_cannot_write(
    record: RunRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match=r"ends in \.gif, \.mp4, \.webm"):
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
