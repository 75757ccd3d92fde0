"""Wordings of a mission's wishes: taught ones and held-out ones."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Literal, TypeAlias, get_args

Split: TypeAlias = Literal["train", "held-out"]
Wish: TypeAlias = Literal["far", "slow", "left", "right", "clear", "yield"]

SPLITS: tuple[Split, ...] = get_args(Split)
SIDES: Mapping[Wish, tuple[str, str, str]] = {
    "left": ("left", "right", "port"),
    "right": ("right", "left", "starboard"),
}
"""The words for {side}, {other} and {port} in the wordings of both sides."""

_TEXTS: dict[str, dict[Split, list[str]]] = tomllib.loads(
    files("llm_flock_onboard._distill").joinpath("wishes.toml").read_text(encoding="utf-8")
)


def _wordings(wish: Wish, split: Split) -> tuple[str, ...]:
    if wish not in SIDES:
        return tuple(_TEXTS[wish][split])
    side, other, port = SIDES[wish]
    texts = (wording.format(side=side, other=other, port=port) for wording in _TEXTS["sides"][split])
    return tuple(text[0].upper() + text[1:] for text in texts)


WORDINGS: Mapping[Wish, Mapping[Split, Sequence[str]]] = {
    wish: {split: _wordings(wish, split) for split in SPLITS} for wish in get_args(Wish)
}
"""Wordings of a mission's wishes. No held-out wording is taught."""

BESIDE: Mapping[Split, Sequence[str]] = {split: tuple(_TEXTS["beside"][split]) for split in SPLITS}
"""Sentences that ask for nothing, though some hold a word of a wish."""

BESIDE_SHARE = 0.25
"""Share of wishes with such a sentence, before or after."""
