"""What a mission may wish, in words: taught wordings, held-out ones, and a program that matches taught words."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from functools import lru_cache
from typing import Literal, TypeAlias

Split: TypeAlias = Literal["train", "held-out"]
Wish: TypeAlias = Literal["far", "slow", "left", "right", "clear", "yield"]

_LEFT = (
    *(
        "Keep {side}.",
        "Pass on the {side}.",
        "Go round on the {side} side.",
        "Prefer the {side}.",
        "Take the {side} way.",
    ),
    *("Turn {side}.", "Swing to the {side}.", "Bear {side}.", "The {side} flank is yours.", "Go {side}, if you can."),
    *(
        "Choose the {side}-hand side.",
        "Go by the {side}.",
        "Veer {side}.",
        "Make a bend to the {side}.",
        "Drift {side}.",
    ),
    *("Stay to the {side} of the others.", "Use the {side} lane.", "{port} side, please.", "Steer to {port}."),
    *("Leave the others on your {other}.", "Not {other}, but {side}."),
)
_LEFT_HELD_OUT = (
    *("Curve around {side}wards.", "Go past anyone by their {side} side.", "Dodge to your {side}."),
    *("If in doubt, {side}.", "Sidestep to {port}.", "Everybody else belongs on your {other}-hand side."),
    *("The {other} side is closed to you, the {side} one open.", "Have your turns made {side}, never {other}."),
)


def _sides(wordings: tuple[str, ...], side: str, other: str, port: str) -> tuple[str, ...]:
    said = (wording.format(side=side, other=other, port=port) for wording in wordings)
    return tuple(text[0].upper() + text[1:] for text in said)


WORDINGS: Mapping[Wish, Mapping[Split, tuple[str, ...]]] = {
    "far": {
        "train": (
            *("None.", "No wish.", "Nothing special.", "Just go to the goal.", "Whatever gets you forward."),
            *("Go as far as you can.", "Be quick.", "Lose no time.", "Make speed.", "We are late.", "Get there soon."),
            *("Take the longest safe way.", "Do not dawdle.", "As fast as possible.", "Time is short.", "Full speed."),
            *("Reach the goal early.", "Push on.", "No delay.", "The sooner you arrive, the better.", "Rush."),
            "Cover much ground.",
        ),
        "held-out": (
            *("Hurry up.", "Make the most of this step.", "There is a deadline to meet.", "Waste not a second."),
            *("Advance with all your power.", "We want you home before the rain.", "Anything goes."),
            "Head for your place without losing a moment.",
        ),
    },
    "slow": {
        "train": (
            *(
                "Go slowly.",
                "Take a short step.",
                "Creep forward.",
                "Do not rush.",
                "Half a step is enough.",
                "Gently.",
            ),
            *("Easy now.", "Save power and move little.", "Small steps, please.", "Keep the speed low.", "Crawl."),
            *("Only a bit forward.", "Slow down.", "Be gentle with the motors.", "Move at half pace.", "Not so fast."),
            *("A small move will do.", "Inch ahead.", "Walk, do not run.", "Tread softly.", "Take it easy."),
        ),
        "held-out": (
            *("Little by little.", "Reduce your pace.", "Ease off a bit.", "Baby steps.", "At a snail's pace."),
            *("There is plenty of time, so dawdle.", "Let the batteries rest with shorter moves.", "Stroll."),
        ),
    },
    "left": {
        "train": _sides(_LEFT, "left", "right", "port"),
        "held-out": _sides(_LEFT_HELD_OUT, "left", "right", "port"),
    },
    "right": {
        "train": _sides(_LEFT, "right", "left", "starboard"),
        "held-out": _sides(_LEFT_HELD_OUT, "right", "left", "starboard"),
    },
    "clear": {
        "train": (
            *("Stay far from the others.", "Keep your distance.", "Take the widest gap.", "Give the others much room."),
            *("Avoid everyone.", "Do not crowd.", "Keep well away from obstacles.", "Go where it is free."),
            *(
                "Choose the emptiest way.",
                "Safety first.",
                "Leave plenty of space.",
                "Be careful not to touch anybody.",
            ),
            *("Steer clear of the rest.", "Make a wide berth.", "Stay out of tight places.", "No close passes."),
            *("Room matters more than speed.", "Keep to open ground.", "Play it safe.", "Move where nobody is."),
        ),
        "held-out": (
            *("Give everyone a generous margin.", "Take no risk of a collision.", "Seek the open.", "Get near no one."),
            *("Large distances, please.", "Shun narrow passages.", "Caution before pace.", "Prefer the roomiest path."),
        ),
    },
    "yield": {
        "train": (
            *("Let others go first.", "Give way.", "Wait for the others.", "Others have priority.", "Yield."),
            *(
                "Hold back if someone is close.",
                "After you, say to the others.",
                "Be polite and wait.",
                "Let them pass.",
            ),
            *("Stop when somebody comes.", "Stand back for traffic.", "You are the last in line.", "Halt for anyone."),
            *("The rest of the team comes first.", "Pause while others are near.", "Stay until they have gone."),
            *("Do not move before your neighbours.", "Be patient with the others.", "Everyone else is more urgent."),
        ),
        "held-out": (
            *("The others come before you.", "Remain in place while someone passes.", "Allow your teammates through."),
            *("Your neighbours take precedence.", "Be courteous: they may proceed.", "Don't budge until it is empty."),
            *("They move, you stay.", "Queue behind the rest."),
        ),
    },
}
"""What a mission may wish, in words. No held-out wording is taught."""

BESIDE: Mapping[Split, tuple[str, ...]] = {
    "train": (
        *("The battery on the right is new.", "Yesterday the team left late.", "The slow computer was repaired."),
        *("Wind comes from the left.", "The first test went well.", "Others have flown here before."),
        *("It is a quick job.", "This arena has four walls.", "Paint dries on the wall to the right."),
        *("The shape will look good.", "The camera on the left works.", "The waiting room is upstairs."),
    ),
    "held-out": (
        *("The visitors left an hour ago.", "You were right about the weather.", "The radio is slow to start."),
        *("A clear sky is expected.", "The judges wait outside.", "The last run was fast."),
    ),
}
"""Sentences that ask for nothing, though some hold a word of a wish."""

BESIDE_SHARE = 0.25
"""Share of wishes with such a sentence, before or after."""


def _words(text: str) -> list[str]:
    return re.findall(r"[a-z]+", text.lower())


class KeywordReader:
    """Reads wishes by the words of the taught wordings: naive Bayes with add-one smoothing, no model of language."""

    def __init__(self) -> None:
        self._counts = {
            wish: Counter(word for text in said["train"] for word in _words(text)) for wish, said in WORDINGS.items()
        }
        self._known = frozenset(word for counts in self._counts.values() for word in counts)

    def read(self, text: str) -> Wish:
        """The likeliest wish; the first of `WORDINGS` where no word is known."""
        found = [word for word in _words(text) if word in self._known]

        def worth(wish: Wish) -> float:
            counts = self._counts[wish]
            total = counts.total() + len(self._known)
            return sum(math.log((counts[word] + 1) / total) for word in found)

        return max(WORDINGS, key=worth)


@lru_cache(maxsize=1)
def keyword_reader() -> KeywordReader:
    """The reader, trained once."""
    return KeywordReader()
