"""How hard property tests try: LLM_FLOCK_EFFORT=10 draws ten times as many random cases as a plain run."""

import os

from hypothesis import settings

EFFORT = float(os.environ.get("LLM_FLOCK_EFFORT", "1"))


def cases(number: int) -> settings:
    """Draw this number of random cases in a plain run. For tests that fly whole teams."""
    return settings(max_examples=max(1, round(number * EFFORT)), deadline=None)
