"""A page of the viewer as one HTML text: its style, its one script, and its options; it loads nothing but data.

The script's parts live in `static`. Options and runs are in the page as data, never as markup or script, and the script
sets everything that comes from a run as text.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from llm_flock.printable import one_line

STATIC = Path(__file__).parent / "static"
MODULES = "llm-flock-viewer"
"""Name under which the scripts import one another."""

PLAYER = (
    *(
        "dom",
        "keys",
        "surface",
        "geometry",
        "labels",
        "clock",
        "recording",
        "crowd",
        "arena_view",
        "robot_signs",
        "arena",
        "timeline",
        "plots",
    ),
    *("banner", "legend", "mind", "steer", "transport", "moment", "player"),
)
"""Scripts that a replay needs, each after those that it imports."""

ALL = (*PLAYER, "shapes", "ground", "cockpit", "runs", "pages")

_IMPORT = re.compile(r'^import \{([^}]*)\} from "([^"]+)";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?:async )?(?:class|function|const) (\w+)", re.MULTILINE)
_FROM = r'const {\1} = modules["\2"];'

PAGE = Template("""<!doctype html>
<html lang="en"><head><meta charset="utf-8">$policy
<meta name="viewport" content="width=device-width, initial-scale=1"><meta name="color-scheme" content="light dark">
<meta name="referrer" content="no-referrer"><title>$title · LLM-Flock</title><link rel="icon" href="data:,">
<style>$style</style></head>
<body><div id="flock"><header class="flock-header"><span class="flock-brand">LLM-Flock</span>
<span class="flock-title">$title</span></header></div>
<noscript>This page draws with a script of its own, which is switched off.</noscript>
<script type="application/json" id="flock-options">$options</script>$run
<script type="module">$script</script>
</body></html>
""")


def html(title: str, options: Mapping[str, Any]) -> str:
    """A page of the viewer; its options say which one: see `static/start.js`."""
    return PAGE.substitute(
        policy="",
        title=escape(one_line(title)),
        style=css(),
        options=as_data({"title": one_line(title), **options}),
        run="",
        script=bundle(ALL),
    )


def as_data(options: Mapping[str, Any]) -> str:
    """JSON that can stand in a page: no text in it can end its element."""
    return json.dumps(options).replace("<", "\\u003c")


@cache
def css() -> str:
    return (STATIC / "viewer.css").read_text(encoding="utf-8")


@cache
def bundle(names: tuple[str, ...]) -> str:
    """These scripts and the one that starts the page as one, each in a function of its own."""
    parts = ["const modules = {};"]
    for name in names:
        text = (STATIC / f"{name}.js").read_text(encoding="utf-8")
        exports = ", ".join(_EXPORT.findall(text))
        body = _IMPORT.sub(_FROM, text)
        parts.append(f'modules["{MODULES}/{name}.js"] = (() => {{\n{_plain(body)}\nreturn {{ {exports} }};\n}})();')
    start = (STATIC / "start.js").read_text(encoding="utf-8")
    parts.append(_plain(_IMPORT.sub(_FROM, start)))
    return "\n".join(parts)


def _plain(text: str) -> str:
    return re.sub(r"^export (?=(?:async )?(?:class|function|const) )", "", text, flags=re.MULTILINE)
