"""Figures in the docs, and whether the code that they depend on has changed since they were measured.

    python -m benchmarks.figures                     each file of docs/data with its state
    python -m benchmarks.figures --stale             only those that are older than the code
    python -m benchmarks.figures stamp FILE...       say that files were measured with the code of now

Commands that write such a file stamp it themselves (`stamp`); one that a person fills from what a command prints is
stamped by hand, right after. docs/data/commands.csv holds for each row its command, seeds, what it depends on (folders
and files; the command line and docstrings do not count), version of the code and digest.
"""

from __future__ import annotations

import ast
import csv
import hashlib
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs" / "data" / "commands.csv"
PARTS = {path.name.removeprefix("llm-flock-"): path / "src" for path in (ROOT / "packages").iterdir()}
"""Source folders by the short names of their packages; the core is `llm-flock`."""


@cache
def _digest_of(path: Path) -> bytes:
    """Digest of what a file does: Python without comments and docstrings, of other files all bytes."""
    data = path.read_bytes()
    if path.suffix == ".py":
        tree = ast.parse(data)
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):  # a text that stands alone does nothing
                body[:] = [x for x in body if not (isinstance(x, ast.Expr) and isinstance(x.value, ast.Constant))]
        data = ast.dump(tree).encode()
    return hashlib.sha256(data).digest()


def _files(part: str) -> Iterator[Path]:
    folder = PARTS.get(part, ROOT / part)
    if folder.is_file():
        yield folder
        return
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".py", ".j2", ".toml") and not {"cli", "_cli"} & set(path.parts):
            yield path


def digest(parts: str) -> str:
    """Digest of sources, given as the short names of packages and as paths, separated by spaces."""
    summed = hashlib.sha256()
    for part in parts.split():
        files = list(_files(part))
        if not files:
            raise FileNotFoundError(f"{TABLE.name}: {part}: expected one of {', '.join(sorted(PARTS))}, or a path")
        for path in files:
            summed.update(path.relative_to(ROOT).as_posix().encode() + _digest_of(path))
    return summed.hexdigest()[:12]


def rows() -> list[dict[str, str]]:
    with TABLE.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def state(row: dict[str, str]) -> str:
    """`current`, `stale` (older than the code), `undated`, or `by hand` where no code can tell."""
    if not row["Depends on"]:
        return "by hand"
    if not row["Digest"]:
        return "undated"
    return "current" if row["Digest"] == digest(row["Depends on"]) else "stale"


def stale() -> list[str]:
    """Files of docs/data that are older than the code, or whose code was not kept."""
    return sorted({row["File"] for row in rows() if state(row) in ("stale", "undated")})


def stamp(*names: str) -> None:
    """Say that these files were measured with the code of now. Call it right after they are written."""
    table = rows()
    unknown = set(names) - {row["File"] for row in table}
    if unknown:
        raise ValueError(f"{', '.join(sorted(unknown))}: no row in {TABLE.name}")
    for row in table:
        if row["File"] in names:
            row |= {"Version": version("llm-flock"), "Digest": digest(row["Depends on"])}
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, table[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


def write(name: str, table: Sequence[Sequence[object]]) -> None:
    """Write rows, the first with the titles, to a file of docs/data and stamp it."""
    with (TABLE.parent / name).open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(table)
    stamp(name)


def main(arguments: Sequence[str]) -> int:
    """Do as told; returns the exit code."""
    match list(arguments):
        case ["stamp", first, *others]:
            stamp(first, *others)
        case [] | ["--stale"]:
            for row in rows():
                if not arguments or state(row) in ("stale", "undated"):
                    print(f"{state(row):8} {row['File']:24} {row['Version']:8} {row['Command']}")
        case _:
            print(__doc__, file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
