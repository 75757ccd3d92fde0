"""Shows the expected calls, tokens and cost of a run, before any model is asked."""

from __future__ import annotations

import json
from dataclasses import asdict

from rich.markup import escape
from rich.table import Table

from llm_flock.cli._display import live_line
from llm_flock.cli._terminal import Screen, say
from llm_flock.llm._models import parse_models
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._forecast import OUTPUT_TOKENS, PROFILE, expect_run, stand_in


def show_expected_run(config: RunConfig, *, as_json: bool, quiet: bool) -> None:
    """Rehearse a run with stand-ins, and print the calls, tokens and money to expect. Nothing is written."""
    bar, on_round = live_line("rehearsal", enabled=not quiet and not as_json)
    with bar:
        expected = expect_run(config, on_round)
    rehearsed = stand_in(config).model.model != config.model.model
    models = list(dict.fromkeys(parse_models(config.model.model, config.mission.n_robots)))
    if as_json:
        say(json.dumps({"models": models, "expected": asdict(expected), "rehearsed": rehearsed}, allow_nan=False))
        return
    table = Table(title=escape(", ".join(models)), title_justify="left", show_header=False)
    for name, value in (
        ("calls", f"{short(expected.calls)} (at most {short(expected.at_most)})"),
        ("tokens", f"{short(expected.tokens_input)} in, {short(expected.tokens_output)} out"),
        ("cost", cost_text(expected.cost_usd, " USD")),
    ):
        table.add_row(name, value)
    console = Screen()
    console.show(table)
    if rehearsed:
        console.print(
            f"Assumed: {OUTPUT_TOKENS} tokens an answer, thoughts included, and answers as useful as those of "
            f"simulated:{PROFILE}, which flew this run as a rehearsal. Prices are list prices. Nothing was asked of "
            "any model.",
            highlight=False,
        )
    limits = config.limits
    console.print(budget_text(limits.max_calls, limits.max_tokens, limits.max_cost), highlight=False)


def cost_text(cost_usd: float | None, unit: str = "") -> str:
    """An expected cost, or `not known`."""
    return "not known" if cost_usd is None else f"{cost_usd:,.2f}{unit}"


def budget_text(calls: int | None, tokens: int | None, cost_usd: float | None) -> str:
    """The limits that are set, in a sentence."""
    limits = {"calls": calls, "tokens": tokens, "US dollars": cost_usd}
    return f"Budget: {', '.join(f'{value:,} {unit}' for unit, value in limits.items() if value is not None) or 'none'}."


def short(number: float) -> str:
    """A count that fits into a column: 12,345 or 1.23 M."""
    return f"{round(number):,}" if number < 1e6 else f"{number / 1e6:,.2f} M"
