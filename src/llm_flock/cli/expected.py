"""Shows what a run will probably use, before anything is asked of a model."""

from __future__ import annotations

import json
from dataclasses import asdict

from rich.markup import escape
from rich.table import Table

from llm_flock.cli.sweep_display import short
from llm_flock.cli.terminal import Screen, say
from llm_flock.experiments.grid import models_of
from llm_flock.experiments.smaller_rehearsal import CROWDS, LARGE, smaller_team
from llm_flock.experiments.sweep_file import ExpectTable
from llm_flock.experiments.sweep_forecast import expect_run
from llm_flock.runtime.config import RunConfig


def show_expected_run(config: RunConfig, *, as_json: bool) -> None:
    """Rehearse a run with stand-ins, and print the calls, tokens and money to expect. Nothing is written."""
    expect = ExpectTable()
    found, rehearsed = expect_run(config, expect)
    models = models_of(config)
    if as_json:
        say(json.dumps({"models": models, "expected": asdict(found), "rehearsed": rehearsed}, allow_nan=False))
        return
    cost = "not known" if found.cost_usd is None else f"{found.cost_usd:,.2f} USD"
    table = Table(title=escape(", ".join(models)), title_justify="left", show_header=False)
    for name, value in (
        ("calls", f"{short(found.calls)} (at most {short(found.at_most)})"),
        ("tokens", f"{short(found.tokens_input)} in, {short(found.tokens_output)} out"),
        ("cost", cost),
    ):
        table.add_row(name, value)
    console = Screen()
    console.show(table)
    if rehearsed:
        scales = smaller_team(config) is not None
        flown, crowd = "this run", ""
        if scales and config.mission.n_robots > CROWDS[0]:
            large = config.mission.n_robots > LARGE
            flown = "a small team of the same shape" if large else f"{flown} (where that takes long, a small team)"
            crowd = "Teams of 64 to 256 robots made 0.8 to 1.2 times the calls of such forecasts. "
        text = (
            f"Assumed: {expect.output_tokens} tokens an answer, thoughts included, and answers as useful as those of "
            f"simulated:{expect.profile}, which flew {flown} as a rehearsal. {crowd}Prices are list prices. Nothing "
            "was asked of any model."
        )
        console.print(text, highlight=False)
    limits = config.limits
    shown = {"calls": limits.max_calls, "tokens": limits.max_tokens, "US dollars": limits.max_cost}
    budget = ", ".join(f"{value:,} {unit}" for unit, value in shown.items() if value is not None)
    console.print(f"Budget: {budget or 'none'}.", highlight=False)
