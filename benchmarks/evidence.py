"""The tables of the page on benchmarks from a sweep of experiments/evidence.toml, finished or not.

    llm-flock sweep experiments/evidence.toml
    python -m benchmarks.evidence [runs/evidence]

Writes docs/data/evidence.csv with all figures, evidence-parts.csv and evidence-conditions.csv with those that the page
shows. Only seeds that all cells have flown count, so that every cell has the same trials.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import polars as pl
from benchmarks import figures

from llm_flock_lab._experiments.statistics import holm, interval
from llm_flock_lab._report.findings import ERROR, CellLine, PairLine, cell_lines, pair_lines
from llm_flock_lab._report.results import Results
from llm_flock_lab._report.sheets import p_text

OUT = Path(__file__).parents[1] / "docs" / "data" / "evidence.csv"
REFERENCE = "factor=default"
ROUNDS = "rounds to the formation"
PARTS = ("default", "out: ", "in: ", "errors: ")
"""How the names of the factors begin that stand in the table of parts."""

Row = dict[str, str | int]


def flown_by_all(results: Results) -> Results:
    """The results without seeds that a cell lacks."""
    frame = results.frame
    cells = frame["cell"].n_unique()
    whole = frame.group_by("seed").len().filter(pl.col("len") == cells)["seed"]
    return Results(results.folder, frame.filter(pl.col("seed").is_in(whole.implode())), results.rounds, results.name)


def factor_of(line: CellLine | PairLine) -> str:
    return line.cell.condition.removeprefix("factor ")


def rows(results: Results) -> list[Row]:
    """One row for each factor and team: its figures, and the paired differences from `default`.

    The p-values of one column are one family, over both teams.
    """
    pairs = {line.cell: line for line in pair_lines(results, REFERENCE)}
    formed_p = dict(zip(pairs, holm([line.formed.p_value for line in pairs.values()]), strict=True))
    means = {cell: mean for cell, line in pairs.items() if (mean := line.means[ROUNDS]) is not None}
    rounds_p = dict(zip(means, holm([mean.p_value for mean in means.values()]), strict=True))
    order = {f"factor {name}": k for k, name in enumerate(results.axes["factor"])}
    found: list[Row] = []
    for line in sorted(cell_lines(results), key=lambda line: (order[line.cell.condition], line.cell.team.shape)):
        pair, mean = pairs.get(line.cell), means.get(line.cell)
        error = None if pair is None else pair.means[ERROR]
        until, _ = results.horizons[line.cell.team]
        found.append(
            {
                "factor": factor_of(line),
                "shape": line.cell.team.shape,
                "robots": line.cell.team.n_robots,
                "trials": line.trials,
                "formed %": interval(line.formed, 0, 100.0),
                "at half the tolerance %": interval(line.half and line.half.alone, 0, 100.0),
                "at twice %": interval(line.twice and line.twice.alone, 0, 100.0),
                "by the models alone %": interval(line.by_models and line.by_models.alone, 0, 100.0),
                "difference of formed": "" if pair is None else interval(pair.formed.difference, 0, 100.0, signed=True),
                "p of formed": "" if pair is None else p_text(formed_p[line.cell]),
                "rounds": interval(line.rounds, 1),
                "counted up to": f"{until:g}",
                "difference of rounds": "" if mean is None else interval(mean.difference, 1, signed=True),
                "effect on rounds (g)": "" if mean is None else interval(mean.effect, 2, signed=True),
                "p of rounds": "" if mean is None else p_text(rounds_p[line.cell]),
                "flight (s)": interval(line.flight_s and line.flight_s.alone, 0),
                "rounds over the bound": interval(line.ratio, 2),
                "distance over the least": interval(line.detour, 2),
                "error at the end (units)": interval(line.error, 2),
                "difference of error": "" if error is None else interval(error.difference, 2, signed=True),
                "smallest separation (units)": "" if line.min_separation is None else f"{line.min_separation:.3f}",
                "trials too near": line.too_near,
                "calls a robot": interval(line.calls, 1),
                "tokens a robot": interval(line.tokens, 0),
                "airtime of a mission (s)": interval(line.airtime_s, 2),
            }
        )
    return found


def beside_each_other(table: Sequence[Row], *, parts: bool) -> list[Row]:
    """The table of the page: a row for each factor, with the main figures of both teams; * marks p < 0.05."""
    found: dict[str, Row] = {}
    for row in table:
        name = str(row["factor"])
        if name != "default" and name.startswith(PARTS) is not parts:
            continue
        team = str(row["shape"])
        line = found.setdefault(name, {"factor": name})
        for column, short, p in (("formed %", "formed %", "p of formed"), ("rounds", "rounds", "p of rounds")):
            surely = row[p] == "< 0.001" or (row[p] != "" and float(row[p]) < 0.05)
            line[f"{team}: {short}"] = f"{row[column]}{' *' if surely else ''}"
        line[f"{team}: too near"] = row["trials too near"]
    return list(found.values())


def write(path: Path, table: Sequence[Row]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, table[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


def main(folder: Path, out: Path = OUT) -> None:
    table = rows(flown_by_all(Results.read(folder)))
    tables = {
        out: table,
        out.with_stem(f"{out.stem}-parts"): beside_each_other(table, parts=True),
        out.with_stem(f"{out.stem}-conditions"): beside_each_other(table, parts=False),
    }
    for path, one in tables.items():
        write(path, one)
        print(f"{path.name}: {len(one)} rows, {table[0]['trials']} trials each")
    if out == OUT:
        figures.stamp(*(path.name for path in tables))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "runs/evidence"))
