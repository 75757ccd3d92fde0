"""Colours of plans, the same in records, figures and on pages."""

from __future__ import annotations

PALETTE: tuple[str, ...] = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#D55E00",
    "#F0E442",
    "#7F7F7F",
)
"""Colours that people of any colour vision tell apart (Okabe, Ito 2008), grey in place of their black."""

NO_PLAN = "#FFFFFF"
