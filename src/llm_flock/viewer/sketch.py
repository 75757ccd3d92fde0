"""The first look at a run: arena and time line draw themselves while all that belongs around them is still loaded."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Sequence
from html import escape
from pathlib import Path

from llm_flock.viewer.parts import Part, arena, timeline

STATIC = Path(__file__).parent / "static"
MODULES = "llm-flock-viewer"
"""Name under which the browser's modules import one another."""


def css() -> str:
    """The style of every page."""
    return (STATIC / "viewer.css").read_text(encoding="utf-8")


def sketch(runs: Sequence[tuple[str, str]]) -> str:
    """A piece of a page that covers it with the drawn parts of a run, or of two, until the page has drawn them itself.

    Args:
        runs: key and title of each.
    """
    arenas = [arena(key, title) for key, title in runs]
    pair = len(runs) > 1
    figures = "".join(
        '<figure class="flock-arena">'
        + (f'<div class="flock-caption">{escape(title)}</div>' if pair else "")
        + '<div class="flock-part"></div></figure>'
        for _, title in runs
    )
    return PIECE.format(
        title=escape(" and ".join(title for _, title in runs)),
        stage="flock-stage flock-pair" if pair else "flock-stage",
        figures=figures,
        parts=_in_script([*arenas, timeline([key for key, _ in runs])]),
    )


def sketch_page(key: str, title: str) -> bytes:
    """A whole page with nothing but the first look; everything that it needs but the run itself is in it."""
    modules = {
        MODULES if path.stem == "index" else f"{MODULES}/{path.name}": _inline(path)
        for path in sorted(STATIC.glob("*.js"))
    }
    return PAGE.format(
        title=escape(title),
        imports=json.dumps({"imports": modules}),
        css=css(),
        sketch=sketch([(key, title)]),
    ).encode()


def _inline(path: Path) -> str:
    return "data:text/javascript;base64," + b64encode(path.read_bytes()).decode()


def _in_script(parts: Sequence[Part]) -> str:
    """Parts as JSON that nothing in a title can end early."""
    return json.dumps([[part.kind, part.options] for part in parts]).replace("<", "\\u003c")


PIECE = """
<div id="flock-sketch" aria-busy="true">
<header class="flock-header"><span class="flock-brand">LLM-Flock</span>
<span class="flock-title">{title}</span></header>
<div class="{stage}">
<section class="flock-field"><div class="flock-layers"></div><div class="flock-arenas">{figures}</div></section>
<aside class="flock-side"></aside>
<section class="flock-time"><div class="flock-transport"></div><div class="flock-part"></div></section>
</div>
<script type="application/json">{parts}</script>
</div>
<script type="module" async>import {{ sketch }} from "llm-flock-viewer/sketch.js"; sketch();</script>
"""

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>{title} · LLM-Flock</title><link rel="icon" href="data:,">
<script type="importmap">{imports}</script>
<style>{css}</style></head>
<body>{sketch}
<script type="module">
import {{ keep }} from "llm-flock-viewer/sketch.js";
fetch("/data/open").catch(() => 0).then(() => {{ keep(); location.reload(); }});
</script>
</body></html>
"""
