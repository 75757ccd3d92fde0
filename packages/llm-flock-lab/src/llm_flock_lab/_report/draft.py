"""The values of the draft of an experimental section: everything follows from the configurations and the trials.

The words are in `templates/draft.j2`, for Markdown and for LaTeX.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, cast

from llm_flock_lab._experiments.statistics import interval
from llm_flock_lab._experiments.store import TRIALS, read_trial
from llm_flock_lab._report.drawings import ReportDrawing
from llm_flock_lab._report.findings import ERROR, INTERVAL, CellLine, PairLine, caveats
from llm_flock_lab._report.results import ResultCell, Results, Team
from llm_flock_lab._report.sheets import Sheet

SHOWN = ("success", "error-by-model", "error-by-protocol", "paired-error")
"""Figures in the draft of a sweep without the paper's teams."""

RULES = {"consensus": "plan", "assignment": "place", "ties": "ties", "shield": "shield", "comm_rounds": "exchanges"}
"""Fields of a protocol, and their columns in the table of protocols."""

ONCE = "baseline, flights"


def draft_values(
    results: Results,
    lines: Sequence[CellLine],
    pairs: Sequence[PairLine],
    drawings: Sequence[ReportDrawing],
    claims: Sheet | None,
) -> dict[str, Any]:
    """What the template needs besides figures, failures and names of the page."""
    paths = {cell: results.folder / TRIALS / f"{trials[0].id}.json" for cell, trials in results.cells.items()}
    configs = {cell: read_trial(path).config for cell, path in paths.items() if path.exists()}
    share = {line.cell: interval(line.formed, 0, 100) for line in lines}
    error = {line.cell: interval(line.error, 2) for line in lines}
    return {
        "teams": ", ".join(f"{team.shape} of {team.n_robots}" for team in results.teams),
        "protocols": results.protocols,
        "models": list(results.models),
        "simulated": list(dict.fromkeys(t.cell.model for t in results.trials if t.figures["simulated"])),
        "seeds": len({trial.seed for trial in results.trials}),
        "trials": f"{len(results.trials):,}",
        "missing": max(0, (results.planned or 0) - len(results.trials)),
        "value": partial(_value, configs),
        "rules": _rules(results, configs),
        "lines": lines,
        "lower": [line for line in pairs if (means := line.means[ERROR]) and (means.difference.high or 0.0) < 0],
        "pairs": pairs,
        "tables": [
            _pivot("Trials that formed [%]", "Share of all trials, with Wilson's 95 % interval.", share),
            _pivot("Error at the end [units]", f"Mean of trials that have one, formed or not, {INTERVAL}.", error),
        ],
        "drawings": [one for one in drawings if one.section == "paper"]
        or [one for one in drawings if one.name in SHOWN],
        "claims": None if claims is None else _verdicts(claims),
        "caveats": caveats(results),
        "label": " Simulated language models." if results.simulated else "",
        "codes": ", ".join(dict.fromkeys(str(trial.figures["code"]) for trial in results.trials)),
    }


def _value(configs: Mapping[ResultCell, Mapping[str, Any]], section: str, field: str) -> str:
    """A field of the configurations: all its values, with their protocols where these decide it."""
    found: dict[str, dict[str, None]] = {}
    for cell, config in configs.items():
        values = config.get(section)
        found.setdefault(_plain(dict(values or {}).get(field)), {})[cell.protocol] = None
    by_protocol = len(found) > 1 and sum(map(len, found.values())) == len({cell.protocol for cell in configs})
    return "; ".join(f"{text} ({', '.join(names)})" if by_protocol else text for text, names in found.items())


def _plain(value: object) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_plain, cast('Sequence[object]', value)))}]"
    words = {"True": "on", "False": "off", "None": "none"}
    return f"{value:g}" if isinstance(value, float) else words.get(str(value), str(value))


def _rules(results: Results, configs: Mapping[ResultCell, Mapping[str, Any]]) -> Sheet:
    fields = {cell.protocol: config["protocol"] for cell, config in configs.items()}
    rows = tuple((name, *(_plain(fields.get(name, {}).get(field)) for field in RULES)) for name in results.protocols)
    note = "Rules for plans and places, what decides ties, a shield that keeps robots apart, exchanges in a round."
    return Sheet(title="Protocols", header=("protocol", *RULES.values()), rows=rows, words=len(RULES), note=note)


def _pivot(title: str, note: str, cells: Mapping[ResultCell, str]) -> Sheet:
    """A row for each model, condition and protocol; a column for each team."""
    rows: dict[tuple[str, str, str], dict[Team, str]] = {}
    for cell, text in cells.items():
        rows.setdefault((cell.model, cell.condition, cell.protocol), {})[cell.team] = text
    teams = list(dict.fromkeys(cell.team for cell in cells))
    kept = [k for k in range(3) if k == 2 or len({key[k] for key in rows}) > 1]  # what tells rows apart
    table = tuple((*(key[k] for k in kept), *(row.get(team, "-") for team in teams)) for key, row in rows.items())
    header = (*(("model", "condition", "protocol")[k] for k in kept), *(f"{one.shape} {one.n_robots}" for one in teams))
    return Sheet(title=title, header=header, rows=table, words=len(kept), note=note)


def _verdicts(claims: Sheet) -> Sheet:
    """A row for each claim, a column for each protocol, and one for claims that are about none of them."""
    every = [row[2] for row in claims.rows if row[0] == claims.rows[0][0]]
    table: dict[tuple[str, str], dict[str, str]] = {}
    for text, source, protocol, verdict, _ in claims.rows:
        table.setdefault((text, source), {})[protocol if protocol in every else ONCE] = verdict
    rows = tuple((*key, *(row.get(name, "") for name in (*every, ONCE))) for key, row in table.items())
    header = ("claim", "lines", *every, ONCE)
    return Sheet(title=claims.title, header=header, rows=rows, words=len(header), note=claims.note)
