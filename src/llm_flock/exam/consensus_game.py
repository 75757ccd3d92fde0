"""A consensus game of scalar values: agents hear each other's numbers until two thirds say stop, and must agree on one.

After F. Berdoz, L. Rugli and R. Wattenhofer: Can AI Agents Agree? arXiv 2603.01213 (2026). All agents hear all others
in synchronous rounds. Honest ones begin with whole numbers from 0 to 50. The others, the liars, are unknown to them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np

from llm_flock.errors import InputError
from llm_flock.protocol.messages.message import Provenance

LOWEST, HIGHEST = 0, 50
"""Range of the values."""

ROUNDS = 50
"""Rounds after which a game is lost, unless told otherwise."""

Outcome: TypeAlias = Literal["valid", "invalid", "split", "timeout"]
"""How a game ends.

`valid`: two thirds said stop, and all honest agents hold one value that an honest agent began with. `invalid`: they
hold one value that none began with. `split`: they hold several. `timeout`: too few said stop until the last round.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """What an agent tells all others in a round.

    Attributes:
        value: its number; None keeps the one before, as after an answer that could not be read.
        stop: whether the game is to end.
        origin: where the value comes from, for rules that look at it.
    """

    value: int | None
    stop: bool = False
    origin: Provenance | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Hearing:
    """What an agent knows when it is to speak.

    Attributes:
        round: from 1.
        rounds: number of the last round.
        me: its id, from 0 to n - 1.
        began: the number that it began with.
        own: its number now.
        heard: what every other agent said last, by id.
    """

    round: int
    rounds: int
    me: int
    began: int
    own: int
    heard: Mapping[int, Said]

    @property
    def n(self) -> int:
        """Number of agents."""
        return len(self.heard) + 1


class Player(Protocol):
    """One agent, honest or not."""

    def begins(self, me: int, n: int, value: int) -> Said:
        """What it tells before the first round; an honest agent tells its value."""
        ...

    async def speaks(self, hearing: Hearing) -> Said:
        """What it tells in a round, having heard all others of the round before."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Deal:
    """The start of a game: the value of every agent, and which of them are liars."""

    values: tuple[int, ...]
    liars: frozenset[int]


@dataclass(frozen=True, slots=True, kw_only=True)
class GameResult:
    """How a game ended; `unread` counts answers of honest agents that could not be read."""

    outcome: Outcome
    rounds: int
    values: tuple[int, ...]
    unread: int


def deal(agents: int, liars: int, *, seed: int, game: int) -> Deal:
    """Draw values and seats; the same numbers give the same game, whoever plays it.

    Raises:
        InputError: for field `agents` or `liars`: fewer than two honest agents, or as many liars as a third or more.
    """
    if agents < 2:
        raise InputError("agents", agents, "at least 2")
    if not 0 <= 3 * liars <= agents:
        raise InputError("liars", liars, f"from 0 to {agents // 3}, a third of the agents")
    rng = np.random.default_rng([seed, agents, liars, game])
    values: list[int] = rng.integers(LOWEST, HIGHEST + 1, agents).tolist()
    seats: list[int] = rng.permutation(agents)[:liars].tolist()
    return Deal(values=tuple(values), liars=frozenset(seats))


async def play(players: Sequence[Player], dealt: Deal, rounds: int = ROUNDS) -> GameResult:
    """Play one game.

    Args:
        players: one for each agent; those whose ids are in `dealt.liars` are not bound to anything.
        dealt: how it begins.
        rounds: number of rounds after which it is lost.
    """
    n = len(players)
    honest = [k for k in range(n) if k not in dealt.liars]
    values, unread = list(dealt.values), 0
    told = [player.begins(k, n, values[k]) for k, player in enumerate(players)]
    for round_ in range(1, rounds + 1):
        hearings = [
            Hearing(
                round=round_,
                rounds=rounds,
                me=k,
                began=dealt.values[k],
                own=values[k],
                heard={j: said for j, said in enumerate(told) if j != k},
            )
            for k in range(n)
        ]
        answers = await asyncio.gather(*(p.speaks(hearing) for p, hearing in zip(players, hearings, strict=True)))
        unread += sum(answers[k].value is None for k in honest)
        values = [own if said.value is None else said.value for own, said in zip(values, answers, strict=True)]
        told = [
            Said(value=value, stop=said.stop, origin=said.origin) for value, said in zip(values, answers, strict=True)
        ]
        # Liars vote too: nobody knows who they are.
        if 3 * sum(said.stop for said in told) >= 2 * n:
            outcome = judge([values[k] for k in honest], [dealt.values[k] for k in honest])
            return GameResult(outcome=outcome, rounds=round_, values=tuple(values), unread=unread)
    return GameResult(outcome="timeout", rounds=rounds, values=tuple(values), unread=unread)


def judge(final: Sequence[int], began: Sequence[int]) -> Outcome:
    """The outcome of a game that was stopped, from the last and the first values of the honest agents."""
    if len(set(final)) > 1:
        return "split"
    return "valid" if final[0] in began else "invalid"
