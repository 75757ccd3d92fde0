"""What a program reaches for while it reads hostile input, told by Python's audit events."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hostile import BAIT

ROOT = Path(__file__).resolve().parents[1]
HOME = Path.home()
OWN = tuple(
    str(path)
    for path in (
        *(sys.prefix, sys.base_prefix, ROOT, "/usr/lib", "/usr/share", "/usr/local", "/etc/fonts"),
        *(HOME / ".cache/matplotlib", HOME / ".config/matplotlib", HOME / ".fonts", HOME / ".local/share/fonts"),
    )
)
"""What the interpreter and its libraries read."""

SYSTEM = ("/dev/null", "/dev/urandom", "/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/sys/fs/cgroup", "/etc/mime")
PRIVATE = f"{tempfile.gettempdir()}/llm-flock-"
"""Temporary folders of the program itself."""

FORBIDDEN = frozenset(
    {
        *("socket.connect", "socket.bind", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto"),
        *("subprocess.Popen", "os.system", "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn"),
        *("pty.spawn", "webbrowser.open", "os.kill", "os.chdir", "os.chown", "os.chroot"),
    }
)
PLACED = {
    **dict.fromkeys(("os.listdir", "os.scandir", "os.walk", "glob.glob", "shutil.rmtree"), 1),
    **dict.fromkeys(("os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.truncate", "os.utime"), 1),
    **dict.fromkeys(("os.rename", "os.link", "os.symlink"), 2),
}
"""Events about paths, with how many they have."""

UNWANTED_MODULES = frozenset({BAIT, "this", "antigravity"})

_inside: list[str] = []
_readable: list[str] = []
_reached: list[str] = []


def _is_within(path: str, *folders: str) -> bool:
    return any(path == folder or path.startswith(folder.rstrip("/") + "/") for folder in folders)


def _place(path: Any) -> str:
    return os.path.abspath(os.fsdecode(path))  # noqa: PTH100 - follows no link, and asks no file


def _is_own(path: Any, *, reads: bool) -> bool:
    if path is None or isinstance(path, int):
        return True
    place = _place(path)
    if _is_within(place, *_inside) or place.startswith(PRIVATE):
        return True
    known = BAIT not in place and (_is_within(place, *OWN) or place.startswith(SYSTEM))
    return reads and (known or _is_within(place, *_readable))


def _hook(event: str, args: tuple[Any, ...]) -> None:
    if not _inside:
        return
    if event == "open":
        path, _, flags = args
        reads = not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) if isinstance(flags, int) else True
        allowed = _is_own(path, reads=reads)
    elif event == "import":
        allowed = args[0].partition(".")[0] not in UNWANTED_MODULES
    elif event in PLACED:
        allowed = all(_is_own(path, reads=event in ("os.listdir", "os.scandir")) for path in args[: PLACED[event]])
    else:
        allowed = event not in FORBIDDEN
    if not allowed:
        _reached.append(f"{event} {args[:2]!r}"[:300])
        raise PermissionError(1, "hostile input reaches out", event)  # before it is done


@contextmanager
def reading_anywhere() -> Iterator[None]:
    """For a configuration of one's own, which may name files to read; what it imports or calls still fails."""
    _readable.append("/")
    try:
        yield
    finally:
        _readable.clear()


_hooked = False


@contextmanager
def kept_inside(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Work in a folder `here` with bait in it, and beside it; gives its path.

    Fails if anything outside `here` is opened or changed, bait imported, a process started, or a host called.
    """
    global _hooked
    here = folder / "here"
    here.mkdir()
    (here / f"{BAIT}.py").write_text("raise SystemExit('imported')\n")
    (folder / BAIT).mkdir()
    (folder / BAIT / "file").write_text("[[1, 2], [3, 4], [5, 6]]")
    monkeypatch.chdir(here)
    if not _hooked:
        sys.addaudithook(_hook)  # for the rest of this process
        _hooked = True
    for name in UNWANTED_MODULES:
        sys.modules.pop(name, None)
    _reached.clear()
    _inside[:] = [str(here)]
    look = os.stat

    def stat(path: Any, *args: Any, **kwargs: Any) -> os.stat_result:
        if not isinstance(path, int) and BAIT in os.fsdecode(path) and not _is_own(path, reads=True):
            _reached.append(f"os.stat {path!r}")
        return look(path, *args, **kwargs)

    try:
        with monkeypatch.context() as patch:
            patch.setattr(os, "stat", stat)
            patch.setattr(sys, "dont_write_bytecode", True)  # of modules that are first needed here
            yield here
    finally:
        _inside.clear()
    assert not _reached, _reached
