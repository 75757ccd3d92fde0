"""A figure of the report: as files, and as a part of a page whose colours it follows."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field

from markupsafe import Markup, escape
from matplotlib.figure import Figure

from llm_flock.viz.style import FAINT, GRID, INK, PAPER, RC, SERIES, SERIES_ON_DARK, house_style

AXES_EDGE = str(RC["axes.edgecolor"])
INTERVALS = {"student": "95 % Student-t interval", "bootstrap": "95 % bootstrap interval (BCa)"}
"""Names of the methods that find the interval of a mean."""

VARIABLES: dict[str, tuple[str, str]] = {
    INK: ("ink", "#E6E6E6"),
    PAPER: ("paper", "#17191C"),
    GRID: ("grid", "#33373C"),
    FAINT: ("faint", "#8A8F95"),
    AXES_EDGE: ("edge", "#6A7077"),
    **{light: (f"series-{k}", dark) for k, (light, dark) in enumerate(zip(SERIES, SERIES_ON_DARK, strict=True))},
}
"""Colours of figures: for each, the page's CSS variable, and the variable's value on a dark page."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """One figure of the report.

    Attributes:
        name: of its files.
        section: section of the page.
        title: its title.
        caption: how to read it.
        figure: drawn, on white.
    """

    name: str
    section: str
    title: str
    caption: str
    figure: Figure = field(repr=False)


def page_colours() -> tuple[dict[str, str], dict[str, str]]:
    """Values of the CSS variables on a light and on a dark page."""
    light = {name: colour for colour, (name, _) in VARIABLES.items()}
    return light, dict(VARIABLES.values())


def inline_svg(figure: Figure, name: str, label: str) -> Markup:
    """The figure as an element of an HTML page, the same whenever it is made.

    Args:
        figure: drawn in the house style.
        name: prefix of every id, so that no two figures of a page share one.
        label: a description for screen readers.
    """
    out = io.StringIO()
    with house_style():
        figure.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Its style sheet would hold for the whole page.
    text = re.sub(r"<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    text = re.sub(r'\bhref="#([^"]+)"', rf'href="#{name}-\1"', text)
    for colour, (variable, _) in VARIABLES.items():
        text = re.sub(re.escape(colour), f"var(--{variable})", text, flags=re.IGNORECASE)
    box = re.search(r'viewBox="([^"]+)"', text)
    assert box is not None, "matplotlib writes a view box"
    width = float(box[1].split()[2])
    head = (
        f'<svg viewBox="{box[1]}" role="img" aria-label="{escape(label)}" style="max-width:{width * 1.25:.0f}px" '
        'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'
    )
    return Markup(head + text[text.index(">", text.index("<svg")) + 1 :].strip())
