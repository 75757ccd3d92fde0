"""The drones' tables on disk."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from llm_flock_flight._crazyflie.link import default_folder, keep_whole


class Cache:
    """As cflib's: writes a file bit by bit."""

    def __init__(self, rw_cache: str) -> None:
        self.folder = Path(rw_cache)
        self.seen: list[bool] = []

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
    monkeypatch.setattr(Path, "write_text", lambda self, *text: (written.append(self), plain(self, *text))[1])
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
