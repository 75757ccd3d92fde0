"""A run as one HTML file that can be mailed: arena, timeline, plots and events, with no network and no other file.

It draws with the viewer's own scripts. The run is in the page as packed data, never as markup; the page's policy allows
its one script and its one style, by their hashes, and nothing else.
"""

from __future__ import annotations

import zlib
from base64 import b64encode
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import Any

from pydantic_core import to_json

from llm_flock.errors import InputError, RecordError
from llm_flock.printable import one_line
from llm_flock.record import LlmEntry, RecordStream
from llm_flock_view._figures.style import whole_file
from llm_flock_view._viewer.canvases import CHARTS, player_options
from llm_flock_view._viewer.data import MAX_FRAMES, about, event_lines, frames, news
from llm_flock_view._viewer.page import PAGE, PLAYER, as_data, bundle, css
from llm_flock_view._viewer.paths import title_of
from llm_flock_view._viewer.recording import Recording

MAX_ROBOT_ROUNDS = 200_000  # most robots times rounds of a page


def write_page(record: Path, target: Path) -> int:
    """Write a record as a page, and return its size [bytes]. An older page is replaced; missing folders are made."""
    if not record.is_file():
        raise RecordError(f"{record}: no such record")
    run = Recording("1", title_of(record), record, live=False)
    for entry in RecordStream(record).entries():
        # The page has no conversations, which are most of a record.
        no_text: dict[str, Any] = {"messages": [], "text": None, "parsed": None, "settings": {}}
        run.write(entry.model_copy(update=no_text) if isinstance(entry, LlmEntry) else entry)
    run.open = False
    if not run.ready:
        raise RecordError(f"{record}: the run ended before its start was recorded; there is nothing to show")
    text = page(run).encode()
    with whole_file(target) as part:
        part.write_bytes(text)
    return len(text)


def page(run: Recording) -> str:
    history = run.history
    size = history.n_robots * (history.last_round + 1)
    if size > MAX_ROBOT_ROUNDS:
        most = MAX_ROBOT_ROUNDS // history.n_robots
        raise InputError("rounds", history.last_round, f"at most {most} for a page of {history.n_robots} robots")
    script, style = bundle(PLAYER), css()
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    packed = b64encode(zlib.compress(to_json(_content(run)), 9)).decode()
    title = one_line(run.title)
    return PAGE.substitute(
        policy=f'\n<meta http-equiv="Content-Security-Policy" content="{policy}">',
        title=escape(title),
        style=style,
        options=as_data({"title": title, **player_options([(run.key, title)]), "charts": CHARTS[:3]}),
        run=f'\n<script type="text/plain" id="flock-run">{packed}</script>',
        script=script,
    )


def _content(run: Recording) -> dict[str, Any]:
    """The run as a page asks for it. Conversations are left out: they are most of a record."""
    kept: list[dict[str, Any]] = []
    history = run.history
    for first in range(0, history.last_round + 1, MAX_FRAMES):
        kept += frames(history, first, MAX_FRAMES)
    return {
        "about": {**about(run), "export": False},
        "news": news(run, 0, 0, 0),
        "frames": kept,
        "events": [event_lines(history, number) for number in range(history.last_round + 1)],
    }


def _hash(text: str) -> str:
    return "sha256-" + b64encode(sha256(text.encode()).digest()).decode()
