"""Whether all that read a record say the same of its outcome: 40 runs of every kind, six readers.

    python -m benchmarks outcomes [--out FOLDER]

The runs are flown through the command line: in lockstep (deaths, joiners, orders, lost messages, budgets, bad models,
runs that are interrupted or killed), as swarms with and without keys, and as a flight of simulated drones. All models
are *simulated*. The readers are the command line (what it printed at the end of the run, and `inspect`), the viewer's
banner, its table of runs, reports, notebooks, and exports (the page and figures). A line for each run that not all
call formed, or not formed, and the number of those that all agree on.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from base64 import b64decode
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import polars as pl

from llm_flock.record import RunRecord, read_record
from llm_flock_lab._report.results import Results
from llm_flock_view._figures import figures
from llm_flock_view._figures.inline import end_figures
from llm_flock_view._viewer.data import news
from llm_flock_view._viewer.library import Library, load
from llm_flock_view._viewer.replay_page import write_page
from llm_flock_view._viewer.run_rows import run_row

ROOT = Path(__file__).parents[1]
BRISK = "--take-off-group 4 --take-off-s 0.5 --land-s 0.5 --round-s 0.8 --max-speed-m-s 5"
LONG = "--no-stop-when-formed --rounds"
ORDER = '[{"round":16,"robot":0,"set":{"shape":"line"}}]'
LEAVES = '[{"round":64,"robot":0,"set":{"center":[20,50]}}]'
DISCS = '[{"center":[30,30],"radius":5},{"center":[70,40],"radius":6}]'

LOCKSTEP = (
    "--robots 10 --seed 7",
    "--shape square --robots 8 --seed 3 --protocol paper",
    "--robots 6 --seed 5 --protocol baseline",
    "--shape square --robots 8 --seed 4 --loss 0.3 --delay 2",
    "--robots 8 --seed 6 --model simulated:malformed@0.3 --fallback geometry",
    "--robots 6 --seed 2 --model simulated:malformed --fallback hold --rounds 15",
    "--robots 5 --seed 1 --model simulated:malformed",
    "--robots 5 --seed 1 --model simulated:collapse",
    "--robots 10 --seed 9 --kill 3@6",
    f"--robots 10 --seed 4 --kill 3@6 --gaps replan {LONG} 46",
    f"--robots 10 --seed 4 --kill 3@20 {LONG} 40",
    f"--robots 10 --seed 4 --kill 3@20 --gaps replan {LONG} 22",
    f"--robots 10 --seed 2 --kill 3@5,5@6 --join 3@9,5@30 {LONG} 60",
    f"--robots 8 --seed 103 --gaps replan --kill 3@14,4@50,5@29,6@58,7@49 --changes {LEAVES} --rounds 79",
    f"--robots 8 --seed 103 --gaps replan --kill 3@14,4@50,5@29,6@58,7@49 --changes {LEAVES}",
    "--robots 10 --seed 10 --join 2@9 --rounds 60",
    f"--robots 8 --seed 3 --changes {ORDER}",
    f"--robots 8 --seed 3 --changes {ORDER} --rounds 18",
    "--robots 9 --places 7 --seed 14 --rounds 60",
    "--robots 4 --rounds 0",
    "--robots 4 --rounds 1",
    "--robots 10 --seed 1 --rounds 8",
    "--robots 10 --seed 1 --max-calls 40",
    "--robots 10 --seed 1 --max-tokens 4000",
    "--robots 6 --seed 13 --noise 0.2 --rounds 60",
    f"--robots 6 --seed 11 --obstacles {DISCS} --start uniform --rounds 60",
    "--robots 5 --seed 2 --model geometry",
    "--robots 2 --shape line --seed 3",
    "--robots 2 --shape line --seed 3 --kill 0@3 --rounds 9",
    f"--robots 6 --seed 4 {LONG} 40",
    "--robots 6 --seed 12 --decide on-event",
    "--robots 10 --seed 8 --model 0-4=simulated:distorted@0.5,5-9=simulated:overshoot@0.5",
    "--robots 12 --shape grid --seed 15 --start uniform",
)
"""Options of `llm-flock run`; each run ends by itself."""

STOPPED = (
    (signal.SIGINT, f"--robots 6 --seed 4 {LONG} 100000"),
    (signal.SIGKILL, f"--robots 6 --seed 4 {LONG} 100000"),
    (signal.SIGKILL, f"--robots 12 --seed 4 --protocol baseline {LONG} 100000"),
)
"""Runs that are ended from outside after some rounds."""

SWARMS = (
    "--robots 10 --seed 1",
    "--robots 4 --shape square --seed 2 --keys KEYS",
    "--robots 3 --shape line --model simulated:malformed --max-s 12",
)


def flock(*arguments: str, end: int | None = None, record: Path | None = None) -> str:
    """What a command prints; `end` is the signal that ends it once its record has grown."""
    command = [sys.executable, "-m", "llm_flock", *arguments]
    environment = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    ) as one:
        if end is not None:
            while record is None or not record.exists() or record.stat().st_size < 400_000:
                time.sleep(0.05)
            one.send_signal(end)
        return one.communicate()[0]


def fly(folder: Path) -> list[tuple[str, Path, str]]:
    """Fly all runs: what they are, the record, and what the command line printed at the end."""
    keys = folder / "keys"
    flock("keys", str(keys), "--robots", "4")
    commands = [("run " + one, None) for one in LOCKSTEP] + [("run " + one, end) for end, one in STOPPED]
    commands += [("swarm " + one.replace("KEYS", str(keys)), None) for one in SWARMS]
    commands += [(f"fly --config {ROOT / 'examples' / 'flight.toml'} --yes {BRISK}", None)]
    flown: list[tuple[str, Path, str]] = []
    for number, (command, end) in enumerate(commands):
        out = folder / f"{number:02}"
        record = out / "run.mcap"
        if record.exists():
            printed = (out / "printed.txt").read_text(encoding="utf-8")
        else:
            printed = flock(*command.split(), "--quiet", "--out", str(out), end=end, record=record)
            (out / "printed.txt").write_text(printed, encoding="utf-8")
        name = command if end is None else f"{command} (ended by {signal.Signals(end).name})"
        flown.append((name.replace(str(keys), "KEYS"), record, printed))
    return flown


def says(text: str) -> str:
    """Whether a text calls a run formed or not; empty where it says neither."""
    low = text.lower()
    if "yet" in low:
        return "flies on"
    if re.match(r"\W*(no\b|not formed|mission [^:]*\bnot formed)", low) or "broke off" in low or "not known" in low:
        return "not formed"
    return "formed" if re.match(r"\W*(yes\b|formed\b|mission [^:]*\bformed\b)", low) else ""


def read(path: Path, printed: str, command: Callable[..., str] = flock) -> dict[str, str]:
    """What each reader says of a run; `command` runs a line of the command line."""
    record, run = read_record(path), Library().add("test", path, live=False)
    load(run)
    page = path.with_name("page.html")
    write_page(path, page)
    found = re.search(r'id="flock-run">([^<]*)<', page.read_text(encoding="utf-8"))
    assert found is not None, "the page holds its run"
    held = json.loads(zlib.decompress(b64decode(found[1])))["news"]
    table = re.findall(r"formed\s+│\s+(.*?)\s+│", printed)
    lines = command("inspect", str(path)).splitlines()
    inspected = next((line for line in lines[:8] if says(line)), "")
    return {
        "command": table[0] if table else inspected,
        "inspect": inspected,
        "viewer": news(run, 0, 0, 0)["outcome"]["headline"],
        "table": str(run_row(run)["outcome"]),
        "report": reported(record),
        "notebook": dict(end_figures(record))["outcome"],
        "page": held["outcome"]["headline"],
        "figure": figures.outcome(record),
    }


def verdicts(told: Mapping[str, str]) -> set[str]:
    """What the readers of a run call it; one that agrees with itself has one element."""
    return {says(text) or ("formed" if text == "formed" else "not formed") for text in told.values() if text}


def reported(record: RunRecord) -> str:
    """What a report says of a trial with this result."""
    about = {"trial": "1", "n_robots": 1, "shape": "", "model": "", "seed": 0, "error": None}
    end = {name: (record.result or {}).get(name) for name in ("stopped", "formed")}
    return Results(Path(), pl.DataFrame([about | end]), pl.DataFrame()).trials[0].outcome


def main(arguments: Sequence[str] = ()) -> None:
    """Fly, read, and print what differs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks outcomes", description=__doc__)
    parser.add_argument("--out", type=Path, help="folder for the records; those that are there are read again")
    parser.add_argument("--all", action="store_true", help="print what every reader says of every run")
    chosen = parser.parse_args(arguments)
    folder = chosen.out or Path(tempfile.mkdtemp())
    agreed, flown = 0, fly(folder)
    for name, path, printed in flown:
        told = read(path, printed)
        differ = len(verdicts(told)) > 1
        agreed += not differ
        if differ or chosen.all:
            print(f"{'DIFFER' if differ else 'agree'}  {name}")
            for reader, text in told.items():
                print(f"    {reader:9} {text}")
    print(f"{agreed} of {len(flown)} records: all readers agree", flush=True)
    if chosen.out is None:
        shutil.rmtree(folder)
