"""Statements of witnesses that the next versions of a plan's slots are free, or blocked."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import TypeAlias, TypeVar

from llm_flock.message import NO_OWNER, BidTable
from llm_flock_swarm._signed.certificates import LEFT, ReleaseGrant, WitnessStatement

Stated: TypeAlias = tuple[int, int, int]
"""Slot, version, and the `owner` of a witness's statement: NO_OWNER, BLOCKED, or `left_by` a robot."""

MAX_PASSED_ON = 32  # most statements of others of one kind in one message; they take turns

T = TypeVar("T")


class Words:
    """The statements that one robot holds, its own among them; `enough` that are the same raise a version."""

    def __init__(self, robot: int, enough: int) -> None:
        self._robot = robot
        self._enough = enough
        self._said: dict[Stated, dict[int, bytes]] = {}
        self._own: Sequence[Stated] = ()

    def knows(self, word: WitnessStatement) -> bool:
        return word.witness in self._said.get((word.slot, word.version, word.owner), {})

    def keep(self, word: WitnessStatement) -> None:
        self._said.setdefault((word.slot, word.version, word.owner), {})[word.witness] = word.signature

    def state(self, own: Iterable[Stated], sign: Callable[[Stated], bytes]) -> None:
        """State this, and nothing else any more."""
        self._own = sorted(own)
        for stated in self._own:
            words = self._said.setdefault(stated, {})
            if self._robot not in words:
                words[self._robot] = sign(stated)

    def grants(self, table: BidTable) -> Iterable[tuple[int, int, int, ReleaseGrant]]:
        """Slot, version, owner and words of what enough robots state; what the table is past is forgotten."""
        for (slot, version, stated), words in list(self._said.items()):
            if version <= table[slot][0]:
                del self._said[slot, version, stated]
            elif len(words) >= self._enough:
                owner, by = (stated, NO_OWNER) if stated > LEFT else (NO_OWNER, LEFT - stated)
                yield slot, version, owner, ReleaseGrant(tuple(sorted(words.items())[: self._enough]), by)

    def own(self) -> tuple[WitnessStatement, ...]:
        return tuple(
            WitnessStatement(self._robot, *stated, self._said[stated][self._robot])
            for stated in self._own
            if stated in self._said
        )

    def of_others(self) -> Sequence[WitnessStatement]:
        return [
            WitnessStatement(robot, *stated, signature)
            for stated, words in self._said.items()
            for robot, signature in words.items()
            if robot != self._robot
        ]


def in_turn(statements: Sequence[T], turn: int) -> tuple[T, ...]:
    """A few of the statements, others in each turn, so that all are passed on in the end."""
    if len(statements) <= MAX_PASSED_ON:
        return tuple(statements)
    first = turn * MAX_PASSED_ON % len(statements)
    return tuple(itertools.islice(itertools.cycle(statements), first, first + MAX_PASSED_ON))
