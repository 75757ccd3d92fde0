"""The first look at a run: arena and timeline draw themselves while the rest of the page is still loading."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Sequence
from html import escape
from pathlib import Path

from llm_flock.viewer import canvases

STATIC = Path(__file__).parent / "static"
MODULES = "llm-flock-viewer"
"""Name under which the JavaScript modules import one another."""


def css() -> str:
    """The style of every page."""
    return (STATIC / "viewer.css").read_text(encoding="utf-8")


def preview(runs: Sequence[tuple[str, str]]) -> str:
    """HTML that covers a page with the canvases of runs (key and title of each) until the page has drawn its own."""
    arenas = [canvases.arena(key, title) for key, title in runs]
    pair = len(runs) > 1
    figures = "".join(
        '<figure class="flock-arena">'
        + (f'<div class="flock-caption">{escape(title)}</div>' if pair else "")
        + '<div class="flock-part"></div></figure>'
        for _, title in runs
    )
    listed = json.dumps([*arenas, canvases.timeline([key for key, _ in runs])])
    return PIECE.format(
        title=escape(" and ".join(title for _, title in runs)),
        player="flock-player flock-pair" if pair else "flock-player",
        figures=figures,
        canvases=listed.replace("<", "\\u003c"),  # no title can end the script early
    )


def preview_page(key: str, title: str) -> bytes:
    """A whole page with nothing but the preview; it contains everything but the data of the run."""
    modules: dict[str, str] = {}
    for path in sorted(STATIC.glob("*.js")):
        name = MODULES if path.stem == "index" else f"{MODULES}/{path.name}"
        modules[name] = "data:text/javascript;base64," + b64encode(path.read_bytes()).decode()
    return PAGE.format(
        title=escape(title),
        imports=json.dumps({"imports": modules}),
        css=css(),
        preview=preview([(key, title)]),
    ).encode()


PIECE = """
<div id="flock-preview" aria-busy="true">
<header class="flock-header"><span class="flock-brand">LLM-Flock</span>
<span class="flock-title">{title}</span></header>
<div class="{player}">
<section class="flock-field"><div class="flock-layers"></div><div class="flock-arenas">{figures}</div></section>
<aside class="flock-side"></aside>
<section class="flock-time"><div class="flock-transport"></div><div class="flock-part"></div></section>
</div>
<script type="application/json">{canvases}</script>
</div>
<script type="module" async>import {{ preview }} from "llm-flock-viewer/preview.js"; preview();</script>
"""

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>{title} · LLM-Flock</title><link rel="icon" href="data:,">
<script type="importmap">{imports}</script>
<style>{css}</style></head>
<body>{preview}
<script type="module">
import {{ saveRound }} from "llm-flock-viewer/preview.js";
fetch("/data/open").catch(() => 0).then(() => {{ saveRound(); location.reload(); }});
</script>
</body></html>
"""
