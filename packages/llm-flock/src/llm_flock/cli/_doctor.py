"""`llm-flock doctor`, `shapes` and `models`: lists the installation, the formations and the model providers."""

from __future__ import annotations

import asyncio
import json
import os
import platform
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from llm_flock import plugins
from llm_flock.cli._extensions import Extension, Finding, extended
from llm_flock.cli._options import EXIT_FAILED
from llm_flock.cli._terminal import Screen, say
from llm_flock.errors import InputError
from llm_flock.extras import EXTRAS
from llm_flock.printable import one_line

WAIT_S = 60.0  # longest wait for the answer of a model [s]; a run waits longer


@extended("doctor")
def doctor(
    json_output: Annotated[bool, typer.Option("--json", help="Print a JSON list instead of a table")] = False,
    model: Annotated[
        str | None, typer.Option(help="Ask this model for one plan, as a run would", show_default=False)
    ] = None,
    base_url: Annotated[
        str | None, typer.Option(help="Address of an OpenAI-compatible server", show_default=False)
    ] = None,
    *,
    extensions: list[Extension],
) -> None:
    """Show what is installed, which extras and keys are there, and whether drones, a router and a browser are in reach.

    Only the model that you name is asked, and no key is shown. What is missing is no error: a simulated run needs none
    of it. A model that does not answer is one.
    """
    from llm_flock.llm._providers import PROVIDERS
    from llm_flock.runtime import versions

    python = f"{platform.python_version()}, {sys.prefix}"
    users: defaultdict[str, list[str]] = defaultdict(list)
    for info in PROVIDERS.values():
        users[info.key_env].append(info.name)
    findings = [
        Finding("base", "llm-flock", True, versions()["llm-flock"]),
        Finding("base", "Python", sys.version_info >= (3, 11), python),
        Finding("base", "system", True, f"{platform.system()} {platform.release()}, {platform.machine()}"),
        *(Finding("extra", extra.name, not extra.missing, extra.purpose) for extra in EXTRAS.values()),
        *(Finding("key", name, is_set(name), ", ".join(providers)) for name, providers in users.items()),
    ]
    for extension in extensions:
        findings += extension()
    if model is not None:
        findings.append(asyncio.run(_reach_model(model, base_url)))
    elif base_url is not None:
        raise InputError("base_url", base_url, says="has no effect without --model")
    if json_output:
        say(json.dumps([asdict(finding) for finding in findings]))
        raise typer.Exit(_code(findings))
    for part, rows in groupby(findings, key=lambda finding: finding.part):
        table = Table("name", "there", "what", title=part, title_justify="left")
        for row in rows:
            table.add_row(escape(row.name), "[green]yes[/]" if row.ok else "[dim]no[/]", escape(row.detail))
        Screen().show(table, copied=("name",))
    if any(extra.missing for extra in EXTRAS.values()):
        say("to add extras: pip install 'llm-flock[NAME,...]'")
    raise typer.Exit(_code(findings))


def _code(findings: Sequence[Finding]) -> int:
    return EXIT_FAILED if any(finding.part == "model" and not finding.ok for finding in findings) else 0


async def _reach_model(text: str, base_url: str | None) -> Finding:
    """Ask a model for the plan of a circle of ten, as a run would; an unknown name or address is an InputError."""
    from llm_flock.llm._port import Attempt
    from llm_flock.planner import PlanQuestion
    from llm_flock.runtime import RunConfig, TeamPlanners

    once = {"max_tries": 1, "max_retries": 0, "timeout_s": WAIT_S}
    config = RunConfig.build({}, shape="circle", n_robots=10, model=text, base_url=base_url, **once)
    planners, asked = TeamPlanners(config), list[Attempt]()
    planners.listen(asked.append)
    mission = config.mission
    try:
        await planners[0].plan(PlanQuestion(mission=mission, robot=0, round=1, position=mission.center, neighbors=()))
    finally:
        await planners.close()
    if not asked:
        return Finding("model", text, True, "geometry makes its plans, no model is asked for them")
    (attempt,) = asked
    if attempt.error is not None:
        return Finding("model", text, False, ": ".join(attempt.error))
    reply = attempt.reply
    without = f", asked without {', '.join(reply.settings['without'])}" if "without" in reply.settings else ""
    unfit = "" if attempt.rejected is None else f", which is no plan to fly: {one_line(attempt.rejected, 120)}"
    said = f"{reply.model} says {one_line(reply.text, 60)!r} after {reply.latency_s:.1f} s{without}{unfit}"
    return Finding("model", text, bool(reply.text.strip()), said)


def is_set(variable: str) -> bool:
    """Whether an environment variable holds more than spaces."""
    return bool(os.environ.get(variable, "").strip())


def shapes() -> None:
    """List the formations and their possible team sizes."""
    from llm_flock import shapes as formations

    table = Table("shape", "robots", "description")
    for shape in (*formations.shapes(), *formations.drawn_shapes()):
        table.add_row(shape.name, shape.legal, shape.description)
    Screen().show(table, copied=("shape",))


def models() -> None:
    """List the model providers, their environment variables, whether these are set, and examples."""
    from llm_flock.llm._providers import PROVIDERS

    table = Table("provider", "key in", "set", "default address", "example")
    for provider in PROVIDERS.values():
        known = "yes" if is_set(provider.key_env) else "no"
        table.add_row(provider.name, provider.key_env, known, provider.base_url or "-", provider.example)
    here = {name: source.example for name, source in plugins.load_all("models")}
    here |= {"simulated": "simulated:ideal", "geometry": "geometry", "replay": "replay:FILE"}
    for name, example in here.items():
        table.add_row(name, "-", "-", "this process", example)
    Screen().show(table, copied=("key in", "default address", "example"))
