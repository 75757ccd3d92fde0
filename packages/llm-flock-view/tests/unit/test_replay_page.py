"""A run as one page: nothing in it comes from elsewhere, and no text of a record becomes markup or script."""

from __future__ import annotations

import errno
import json
import os
import re
import zlib
from base64 import b64decode, b64encode
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure
from sample_records import make_record, run_info

from llm_flock.errors import InputError, RecordError
from llm_flock.record._reader import read_record
from llm_flock_view._figures import figures
from llm_flock_view._figures.animation import animate
from llm_flock_view._viewer import replay_page
from llm_flock_view._viewer.library import Library, load
from llm_flock_view._viewer.page import ALL, PLAYER, STATIC, bundle
from llm_flock_view._viewer.recording import Recording
from llm_flock_view._viewer.replay_page import page, write_page

HOSTILE = """</script><script>alert(1)</script>"><img src=x onerror=alert(2)>$run ${policy} \u202e"""


def loaded(path: Path, title: str = "demo") -> Recording:
    run = Library().add(title, path, live=False)
    load(run)
    return run


def element(kind: str, text: str) -> str:
    (found,) = re.findall(rf"<{kind}>(.*?)</{kind.split()[0]}>", text, re.DOTALL)
    return found


def content(text: str) -> dict[str, Any]:
    return json.loads(zlib.decompress(b64decode(element('script type="text/plain" id="flock-run"', text))))


def test_page_holds_the_run_and_only_its_own_script_and_style(tmp_path: Path) -> None:
    text = page(loaded(make_record(tmp_path / "run.mcap", n=4, rounds=5)))
    policy = re.findall(r'Content-Security-Policy" content="([^"]*)"', text)[0]
    for kind, name in (('script type="module"', "script-src"), ("style", "style-src")):
        digest = b64encode(sha256(element(kind, text).encode()).digest()).decode()
        assert f"{name} 'sha256-{digest}';" in policy
    assert policy.startswith("default-src 'none';") and "unsafe" not in policy and "http" not in policy
    assert not re.search(r'(?:src|href)="(?!data:,")', text)
    run = content(text)
    assert [frame["r"] for frame in run["frames"]] == list(range(6)) and len(run["events"]) == 6
    assert run["news"]["last"] == 5 and run["about"]["robots"] == 4


def test_no_module_is_left_to_be_loaded() -> None:
    for names in (PLAYER, ALL):
        script = bundle(names)
        assert not re.search(r"^\s*(?:import|export)\b", script, re.MULTILINE) and "</" not in script
        asked = set(re.findall(r'= modules\["([^"]+)"\]', script))
        assert asked <= set(re.findall(r'^modules\["([^"]+)"\] =', script, re.MULTILINE))
    assert {path.stem for path in STATIC.glob("*.js")} == {*ALL, "start"}


def test_text_of_a_record_stays_text(tmp_path: Path) -> None:
    run = loaded(make_record(tmp_path / "run.mcap", n=3, rounds=2), HOSTILE)
    run.write(run_info(config={"model": {"model": HOSTILE}, "protocol": {"consensus": HOSTILE, "assignment": "x"}}))
    for event in run.history.events[1]:
        event.detail["reason"] = HOSTILE
    text = page(run)
    assert text.count("<script") == 3 and "<img" not in text and "\u202e" not in text
    assert "&lt;/script&gt;&lt;script&gt;alert(1)" in text and "$run" in text


def test_large_runs_and_files_that_are_no_records_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = make_record(tmp_path / "run.mcap", n=4, rounds=5)
    monkeypatch.setattr(replay_page, "MAX_ROBOT_ROUNDS", 20)
    with pytest.raises(InputError, match="at most 5 for a page of 4 robots"):
        write_page(record, tmp_path / "replay.html")
    (tmp_path / "run.mcap").write_bytes(b"no record")
    for name, cause in (("run.mcap", "not a readable MCAP file"), ("missing.mcap", "no such record")):
        with pytest.raises(RecordError, match=cause):
            write_page(tmp_path / name, tmp_path / "replay.html")
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


@pytest.mark.parametrize("name", ["replay.html", "a.gif", "a.png"])
def test_a_full_disk_leaves_no_half_file(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = make_record(tmp_path / "run.mcap", n=3, rounds=2)
    target = tmp_path / "to" / name
    target.parent.mkdir()
    target.write_bytes(b"older")

    def full(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[:10])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    monkeypatch.setattr(Figure, "savefig", lambda _, path, **options: full(path, bytes(20)))
    found = read_record(record)
    write = {
        "replay.html": lambda: write_page(record, target),
        "a.gif": lambda: animate(found, target),
        "a.png": lambda: figures.save(figures.snapshots(found), target),
    }
    with pytest.raises(InputError, match="No space left"):
        write[name]()
    assert [path.name for path in target.parent.iterdir()] == [name] and target.read_bytes() == b"older"
