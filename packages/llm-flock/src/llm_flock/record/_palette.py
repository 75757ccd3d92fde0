"""Colours of plans, the same in records, figures and on pages."""

from __future__ import annotations

PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#7F7F7F")
"""Colours that can be told apart with any colour vision (Okabe, Ito 2008), with grey in place of their black."""

NO_PLAN = "#FFFFFF"
