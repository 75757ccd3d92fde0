"""Do agents agree on a number? Our consensus rule beside free discussion among language models.

    python -m benchmarks agreement [MODEL ...] [--games 100] [--agents 4,8] [--liars 0,1,2] [--rounds 50] [--seed 0]

plays the consensus game of arXiv 2603.01213 (see llm_flock/exam/consensus_game.py) and prints a table. Rules ask no
model. A MODEL is named as in `run --model`, or is one of four stand-ins, which are the default and always simulated:
simulated:majority, :average, :stubborn and :chance. `--only-models` leaves out the rules. `--max-calls` and
`--max-cost` limit what a model may use in all its games; a game that was cut off by this is not counted.
"""

from __future__ import annotations

import argparse
import asyncio
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from llm_flock.errors import InputError
from llm_flock.exam.consensus_game import ROUNDS, Deal, GameResult, Player, deal, play
from llm_flock.exam.consensus_players import GAMES_APART, STAND_INS, GameStandIn, Liar, RulePlayer, Talker
from llm_flock.exam.examinee import Examinee, Setup
from llm_flock.experiments.statistics import wilson
from llm_flock.llm.port import LanguageModel
from llm_flock.protocol.agreement.consensus import InfluenceConsensus, ProvenanceConsensus

HEAD = (
    "| Who decides | Agents | Liars | Games | Valid [95 %] | Invalid | Split | Time-out | Rounds | Calls a game |"
    " Unreadable |\n|---|---|---|---|---|---|---|---|---|---|---|"
)

RULES: dict[str, Callable[[], RulePlayer]] = {
    "our rule, `provenance`": lambda: RulePlayer(ProvenanceConsensus()),
    "the paper's rule, `influence`": lambda: RulePlayer(InfluenceConsensus()),
}
"""Consensus rules by what the table calls them."""


@dataclass(slots=True, kw_only=True)
class Tally:
    """Games of one row: results, and calls of all agents."""

    results: list[GameResult] = field(default_factory=list[GameResult])
    calls: int = 0

    def row(self, who: str, agents: int, liars: str) -> str:
        """A line of the table."""
        games = len(self.results)
        if not games:
            return f"| {who} | {agents} | {liars} | 0 | - | - | - | - | - | - | - |"
        ends = Counter(result.outcome for result in self.results)
        share = wilson(ends["valid"], games)
        low, high = round(100 * (share.low or 0.0)), round(100 * (share.high or 0.0))
        rounds = [result.rounds for result in self.results if result.outcome == "valid"]
        answers = self.calls or 1
        cells = [
            who,
            str(agents),
            liars,
            str(games),
            f"{ends['valid']} of {games} [{low}, {high}]",
            *(str(ends[name]) for name in ("invalid", "split", "timeout")),
            f"{median(rounds):g}" if rounds else "-",
            f"{self.calls / games:.0f}",
            f"{100 * sum(result.unread for result in self.results) / answers:.0f} %" if self.calls else "-",
        ]
        return f"| {' | '.join(cells)} |"


def seated(dealt: Deal, honest: Callable[[int], Player], *, seed: int, game: int, boasts: bool = False) -> list[Player]:
    """A player for each agent: liars where the deal has them, each with chance of its own."""
    return [
        Liar(np.random.default_rng([seed, game, k, 1]), boasts) if k in dealt.liars else honest(k)
        for k in range(len(dealt.values))
    ]


def by_rule(
    rule: Callable[[], RulePlayer], options: argparse.Namespace, agents: int, liars: int, boasts: bool
) -> Tally:
    """Games that a consensus rule decides."""

    async def all_games() -> Tally:
        tally = Tally()
        for game in range(options.games):
            dealt = deal(agents, liars, seed=options.seed, game=game)
            players = seated(dealt, lambda _: rule(), seed=options.seed, game=game, boasts=boasts)
            tally.results.append(await play(players, dealt, options.rounds))
        return tally

    return asyncio.run(all_games())


async def by_talk(name: str, options: argparse.Namespace, tables: Sequence[tuple[int, int]]) -> None:
    """Games in which honest agents ask a model, for each number of agents and liars; prints a line for each."""
    kind, _, profile = name.partition(":")
    if kind in ("geometry", "replay"):
        raise InputError("model", name, "a language model, or one of the stand-ins")
    simulated = kind == "simulated"
    label = f"discussion, `{name}`" + (" *simulated*" if simulated else "")
    setup = Setup(
        model="simulated:ideal" if simulated else name,
        prompts="full",
        seed=options.seed,
        max_calls=options.max_calls,
        max_cost=options.max_cost,
    )
    async with Examinee(setup) as examinee:
        examinee.check()

        def model(agent: int, at: int) -> LanguageModel:
            return GameStandIn(profile, _chance(options, agent, at)) if simulated else examinee.model(agent, at)

        for agents, liars in tables:
            tally = await _talks(model, options, agents, liars)
            print(tally.row(label, agents, str(liars)), flush=True)


def _chance(options: argparse.Namespace, agent: int, at: int) -> np.random.Generator:
    return np.random.default_rng([options.seed, agent, at, 2])


async def _talks(
    model: Callable[[int, int], LanguageModel], options: argparse.Namespace, agents: int, liars: int
) -> Tally:
    tally = Tally()
    for game in range(options.games):
        dealt = deal(agents, liars, seed=options.seed, game=game)
        talkers = {k: Talker(model(k, game * GAMES_APART), game) for k in range(agents) if k not in dealt.liars}
        result = await play(seated(dealt, talkers.__getitem__, seed=options.seed, game=game), dealt, options.rounds)
        if any(talker.failed for talker in talkers.values()):
            break
        tally.results.append(result)
        tally.calls += result.rounds * len(talkers)
    return tally


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks agreement", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("models", nargs="*", metavar="MODEL", default=[f"simulated:{name}" for name in STAND_INS])
    parser.add_argument("--games", type=int, default=100, help="games of each row")
    parser.add_argument("--agents", default="4,8", help="numbers of agents with commas between them")
    parser.add_argument("--liars", default="0,1,2", help="numbers of liars with commas between them")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="rounds after which a game is lost")
    parser.add_argument("--seed", type=int, default=0, help="seed of values, seats and chance")
    parser.add_argument("--only-models", action="store_true", help="leave out the rules")
    parser.add_argument("--max-calls", type=int, help="most calls of each model")
    parser.add_argument("--max-cost", type=float, help="most money for each model [US dollars]")
    options = parser.parse_args(arguments)
    tables = [
        (n, f) for n in numbers(parser, options, "agents") for f in numbers(parser, options, "liars") if 3 * f <= n
    ]
    for name in ("games", "rounds"):
        if getattr(options, name) < 1:
            parser.error(f"argument --{name}: {getattr(options, name)}: at least 1")
    print(HEAD, flush=True)
    try:
        _print_rows(options, tables)
    except InputError as error:
        parser.error(str(error))


def numbers(parser: argparse.ArgumentParser, options: argparse.Namespace, name: str) -> list[int]:
    """The whole numbers of an option, with commas between them; ends the program where it holds others."""
    parts = getattr(options, name).split(",")
    if not all(part.strip().isdecimal() for part in parts):
        parser.error(f"argument --{name}: {getattr(options, name)!r}: whole numbers with commas between them")
    return [int(part) for part in parts]


def _print_rows(options: argparse.Namespace, tables: Sequence[tuple[int, int]]) -> None:
    if not options.only_models:
        for who, rule in RULES.items():
            for agents, liars in tables:
                print(by_rule(rule, options, agents, liars, boasts=False).row(who, agents, str(liars)), flush=True)
                if liars:
                    boasting = by_rule(rule, options, agents, liars, boasts=True)
                    print(boasting.row(who, agents, f"{liars}, boasting"), flush=True)
    for name in options.models:
        asyncio.run(by_talk(name, options, tables))
