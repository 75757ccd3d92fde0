"""Failures of a simulated model and their rates: `distorted@0.3,overshoot@0.3`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches

from llm_flock.errors import InputError, unknown
from llm_flock.llm._simulated.seen import SEEN, SMALL_MODELS

PROFILES: Mapping[str, str] = {
    "ideal": "nothing: exact formations in a random orientation, straight steps that end at the goal",
    "distorted": "plans: uneven, scaled and noisy formations (the paper's first failure, lines 652-664)",
    "overshoot": "steps: always of full length, past a goal that is near (the paper's second failure, lines 666-744)",
    "collapse": "steps: towards the centroid of itself and the robots it sees",
    "malformed": "all answers: unreadable, cut off, of the wrong length, with an illegal index, or not finite",
    "slow": "no answer is wrong, but it takes about a second (log-normal, median 1 s, spread factor 1.6)",
    "flaky": "the call fails as a provider's would: 429 with Retry-After, 500 or a time-out",
    "brisk": "no answer is wrong, but it takes a moment (log-normal, median 0.3 s, spread factor 1.8)",
    "overlong": "steps: towards the goal, but three times the limit while that is farther than one step",
    "careful": "no answer is wrong: it also keeps away from the robots that the prompt names, in steps and plans",
    "random": "all answers: numbers by chance, in the form that was asked for",
    "canonical": "no answer is wrong: plans are not turned, as one model's at temperature 0; a rate leaves slips",
    "first": "no answer is wrong: takes the first place of its plan, as in the paper's example (line 381)",
    "any": "no answer is wrong: takes a place of its plan by chance",
    "alike": "no answer is wrong: all robots draw the same chances, so they turn plans and err alike, as one model",
    "misread": "programs: the named shape that follows in the list, which is the same for all robots",
    "stranger": "programs: another named shape by chance",
    "mirrored": "programs: mirrored, left and right in exchange",
    "open": "programs: a filled outline that is not closed",
    "crowded": "programs: a size without room for the robots",
    "misjudge": "judgements: another option than the right one, by chance",
}
"""Every profile, and its failure or habit."""

PROGRAM_FAULTS = frozenset({"misread", "stranger", "mirrored", "open", "crowded"})

NOT_IN_STEPS = frozenset({"careful", "canonical", "first", "any", "alike", "misjudge"}) | PROGRAM_FAULTS
"""Profiles that do not change how a step is made, or only where others are near."""

FAILURES = tuple(name for name in PROFILES if name != "ideal")
"""The failures, in the order in which they are drawn. At most one of `SEEN` comes on top."""

_KNOWN = [*PROFILES, *SEEN, *SMALL_MODELS]


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """Share of calls that each of FAILURES, and of SEEN, affects, in [0, 1]; `text` is the operator's spelling."""

    text: str = "ideal"
    rates: Mapping[str, float] = field(default_factory=dict[str, float])
    seen: Mapping[str, float] = field(default_factory=dict[str, float])


def parse_profile(text: str) -> Profile:
    """Read profiles separated by commas, each with an optional rate: `overshoot`, `distorted@0.3,slow@0.5`.

    A rate is a share of calls, 1 if left out. `ideal` adds nothing to the others and takes no rate. A small model
    stands for its faults at their shares; shares of `SEEN` add up to 1 at most, for an answer has one of them.
    """
    rates: dict[str, float] = {}
    seen: dict[str, float] = {}
    for part in text.split(","):
        name, at, rate = part.strip().partition("@")
        if name not in _KNOWN:
            near = get_close_matches(name, _KNOWN, 1)
            raise InputError("model", f"simulated:{text}", says=unknown(f"profile {name!r}", name, near or PROFILES))
        if name in rates:
            raise InputError("model", f"simulated:{text}", says=f"profile {name!r} is there twice")
        if name == "ideal" and at:
            raise InputError("model", f"simulated:{text}", "ideal without a rate")
        rates[name] = _rate(text, name, rate) if at else 1.0
        for fault, share in SMALL_MODELS.get(name, {name: 1.0} if name in SEEN else {}).items():
            seen[fault] = seen.get(fault, 0.0) + share * rates[name]
    if sum(seen.values()) > 1 + 1e-9:
        raise InputError("model", f"simulated:{text}", "rates of what an answer says that add up to 1 at most")
    return Profile(text=text, rates={name: rates[name] for name in FAILURES if name in rates}, seen=seen)


def _rate(text: str, name: str, rate: str) -> float:
    try:
        value = float(rate)
    except ValueError:
        value = math.nan
    if not 0 <= value <= 1:
        raise InputError("model", f"simulated:{text}", f"{name}@RATE with a rate from 0 to 1")
    return value
