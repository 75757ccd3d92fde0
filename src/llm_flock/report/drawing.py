"""One figure of the report, and what its intervals are called."""

from __future__ import annotations

from dataclasses import dataclass, field

from matplotlib.figure import Figure

INTERVALS = {"student": "95 % Student-t interval", "bootstrap": "95 % bootstrap interval (BCa)"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """One figure of the report.

    Attributes:
        name: of its files.
        section: where on the page it belongs.
        title: what it shows.
        caption: how it is to be read.
        figure: drawn, on white.
    """

    name: str
    section: str
    title: str
    caption: str
    figure: Figure = field(repr=False)
