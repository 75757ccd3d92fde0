"""What a simulated model gets wrong, and how often: `distorted@0.3,overshoot@0.3`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from llm_flock.errors import InputError

PROFILES: Mapping[str, str] = {
    "ideal": "nothing: exact formations in a random orientation, straight steps that end at the goal",
    "distorted": "plans: uneven, scaled and noisy formations (the paper's first failure, lines 652-666)",
    "overshoot": "steps: always of full length, past a goal that is near (the paper's second failure, lines 675-745)",
    "collapse": "steps: towards the centroid of itself and the robots it sees",
    "malformed": "all answers: unreadable, cut off, of the wrong length, with an illegal index, or not finite",
    "slow": "no answer is wrong, but it takes about a second (log-normal, median 1 s, spread factor 1.6)",
    "brisk": "no answer is wrong, but it takes a moment (log-normal, median 0.3 s, spread factor 1.8)",
    "flaky": "the call fails as a provider's would: 429 with Retry-After, 500 or a time-out",
}
"""Every profile, and what it gets wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """Share of calls, in [0, 1], that each failure befalls; `text` is how the operator wrote it."""

    text: str = "ideal"
    distorted: float = 0.0
    overshoot: float = 0.0
    collapse: float = 0.0
    malformed: float = 0.0
    slow: float = 0.0
    flaky: float = 0.0
    brisk: float = 0.0


FAILURES = tuple(field.name for field in fields(Profile) if field.name != "text")
"""The failures, in the order in which chance decides on them."""


def parse_profile(text: str) -> Profile:
    """Read profiles separated by commas, each with an optional rate: `overshoot`, `distorted@0.3,slow@0.5`.

    A rate is the share of calls; without one it is 1. `ideal` adds nothing to the others and takes no rate.

    Raises:
        InputError: for field `model`: unknown or repeated profile, or a rate outside [0, 1].
    """
    rates: dict[str, float] = {}
    for part in text.split(","):
        name, at, rate = part.strip().partition("@")
        if name not in PROFILES:
            raise InputError("model", f"simulated:{text}", f"profiles of {', '.join(PROFILES)}, separated by commas")
        if name in rates:
            raise InputError("model", f"simulated:{text}", f"each profile once; {name} is there twice")
        if name == "ideal" and at:
            raise InputError("model", f"simulated:{text}", "ideal without a rate")
        rates[name] = _rate(text, name, rate) if at else 1.0
    rates.pop("ideal", None)
    return Profile(text=text, **rates)


def _rate(text: str, name: str, rate: str) -> float:
    try:
        value = float(rate)
    except ValueError:
        value = math.nan
    if not 0 <= value <= 1:
        raise InputError("model", f"simulated:{text}", f"{name}@RATE with a rate from 0 to 1")
    return value
