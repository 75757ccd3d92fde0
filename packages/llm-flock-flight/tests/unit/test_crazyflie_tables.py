"""The cache of a Crazyflie's tables of contents (TOC)."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from llm_flock_flight._crazyflie.link import default_folder, keep_whole


class Cache:
    """Like cflib's cache: writes a table straight to its final name."""

    def __init__(self, rw_cache: str) -> None:
        self.folder = Path(rw_cache)

    def insert(self, checksum: int, table: object) -> None:
        (self.folder / f"{checksum:08X}.json").write_text(json.dumps(table))


class Drone:
    def __init__(self, folder: Path) -> None:
        self._toc_cache = Cache(str(folder))


def test_a_table_appears_whole_and_is_replaced_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drone = Drone(tmp_path)
    keep_whole(drone, tmp_path)
    written: list[Path] = []
    plain = Path.write_text

    def spy(self: Path, text: str) -> int:
        written.append(self)
        return plain(self, text)

    monkeypatch.setattr(Path, "write_text", spy)
    for table in ([1], [2]):
        drone._toc_cache.insert(0xAB, table)
        assert json.loads((tmp_path / "000000AB.json").read_text()) == table
    assert all(path.parent != tmp_path for path in written), "never written in place"
    assert [path.name for path in tmp_path.iterdir()] == ["000000AB.json"]


def test_the_folder_is_in_the_users_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert default_folder() == Path("/somewhere/llm-flock/crazyflie")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert default_folder() == Path.home() / ".cache" / "llm-flock" / "crazyflie"
