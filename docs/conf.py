"""Sphinx configuration. The build reads this checkout only: no inventories, fonts or scripts are fetched."""

import re
import sys
import tomllib
from pathlib import Path

from sphinx.util import logging

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), *map(str, HERE.parent.glob("packages/*/src"))]

project = "LLM-Flock"
author = "LLM-Flock contributors"
copyright = author
CORE = HERE.parent / "packages" / "llm-flock"
release = tomllib.loads((CORE / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "from_code",
]
exclude_patterns = ["_ext"]
nitpicky = False

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = f"LLM-Flock {release}"
html_copy_source = False

smartquotes = False
default_role = "code"
autodoc_default_options = {"members": True, "member-order": "bysource", "show-inheritance": True}
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
autodoc_preserve_defaults = True
napoleon_use_ivar = True

_CODE_SPAN = re.compile(r"(`+[^`]*`+)")
_COLON = "\N{OBJECT REPLACEMENT CHARACTER}"


def _name_stale_figures(app):
    root = str(HERE.parent)
    sys.path.append(root)
    from benchmarks import figures

    for name in figures.stale():
        logging.getLogger(__name__).info("docs/data/%s: older than the code, or undated", name)
    sys.path.remove(root)


def _before_napoleon(app, what, name, obj, options, lines):
    """Docstrings are plain prose with `code`: bars, stars and colons in them are not markup."""
    for i, line in enumerate(lines):
        parts = _CODE_SPAN.split(line)
        parts[::2] = [re.sub(r"([|*])", r"\\\1", part) for part in parts[::2]]
        lines[i] = "".join(parts)
        # Napoleon takes what stands before a colon in an attribute's docstring for its type.
        if what in ("attribute", "property"):
            lines[i] = lines[i].replace(":", _COLON)


def _after_napoleon(app, what, name, obj, options, lines):
    lines[:] = [line.replace(_COLON, ":") for line in lines]


def _before_build(app):
    """Autodoc evaluates the types of a struct's fields, and one of them is imported for type checkers only."""
    from llm_flock.protocol._agreement import assignment
    from llm_flock.roadmap import Roadmap

    assignment.Roadmap = Roadmap


def setup(app):
    app.connect("builder-inited", _before_build)
    app.connect("builder-inited", _name_stale_figures)
    app.connect("autodoc-process-docstring", _before_napoleon, priority=400)
    app.connect("autodoc-process-docstring", _after_napoleon, priority=600)
