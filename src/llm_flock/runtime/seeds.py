"""Independent random streams of one run, all from its seed: a part drawing more never shifts another part."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What a stream is for; the numbers are part of reproducibility and never change."""

    START = 0
    LINKS = 1
    NOISE = 2
    MODEL = 3
    BACKOFF = 4
    FAULTS = 5


def stream(seed: int, purpose: Stream, robot: int = 0) -> np.random.Generator:
    """The generator for one purpose, and one robot where each has its own."""
    return np.random.default_rng(np.random.SeedSequence([seed, int(purpose), robot]))
