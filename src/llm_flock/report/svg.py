"""A figure as a part of a page: its colours follow the page's, and its names clash with no other figure's."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import io
import re

from markupsafe import Markup, escape
from matplotlib.figure import Figure

from llm_flock.viz.style import FAINT, GRID, INK, PAPER, RC, SERIES, SERIES_ON_DARK, house_style

AXES_EDGE = str(RC["axes.edgecolor"])

VARIABLES: dict[str, tuple[str, str]] = {
    INK: ("ink", "#E6E6E6"),
    PAPER: ("paper", "#17191C"),
    GRID: ("grid", "#33373C"),
    FAINT: ("faint", "#8A8F95"),
    AXES_EDGE: ("edge", "#6A7077"),
    **{light: (f"series-{k}", dark) for k, (light, dark) in enumerate(zip(SERIES, SERIES_ON_DARK, strict=True))},
}
"""The colours that figures are drawn in, the variable of the page that stands for each, and its value in the dark."""


def page_colours() -> tuple[dict[str, str], dict[str, str]]:
    """Value of every variable on a light and on a dark page."""
    light = {name: colour for colour, (name, _) in VARIABLES.items()}
    return light, dict(VARIABLES.values())


def svg_text(figure: Figure) -> str:
    """The figure as SVG, the same whenever it is made."""
    out = io.StringIO()
    with house_style():
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def inline_svg(figure: Figure, name: str, label: str) -> Markup:
    """The figure as an element of an HTML page.

    Args:
        figure: drawn in the house style.
        name: put before every id.
        label: what it shows, for those who do not see it.
    """
    text = svg_text(figure)
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
