"""What a mission may wish, in words: taught wordings, held-out ones, and a program that matches taught words."""

from __future__ import annotations

import math
import re
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Literal, TypeAlias, get_args

Split: TypeAlias = Literal["train", "held-out"]
Wish: TypeAlias = Literal["far", "slow", "left", "right", "clear", "yield"]

SPLITS: tuple[Split, ...] = get_args(Split)
SIDES: Mapping[Wish, tuple[str, str, str]] = {
    "left": ("left", "right", "port"),
    "right": ("right", "left", "starboard"),
}
"""What stands for {side}, {other} and {port} in the wordings of both sides."""

_TEXTS: dict[str, dict[Split, list[str]]] = tomllib.loads(
    files("llm_flock.distill").joinpath("wishes.toml").read_text(encoding="utf-8")
)


def _said(wish: Wish, split: Split) -> tuple[str, ...]:
    if wish not in SIDES:
        return tuple(_TEXTS[wish][split])
    side, other, port = SIDES[wish]
    said = (wording.format(side=side, other=other, port=port) for wording in _TEXTS["sides"][split])
    return tuple(text[0].upper() + text[1:] for text in said)


WORDINGS: Mapping[Wish, Mapping[Split, Sequence[str]]] = {
    wish: {split: _said(wish, split) for split in SPLITS} for wish in get_args(Wish)
}
"""What a mission may wish, in words. No held-out wording is taught."""

BESIDE: Mapping[Split, Sequence[str]] = {split: tuple(_TEXTS["beside"][split]) for split in SPLITS}
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
