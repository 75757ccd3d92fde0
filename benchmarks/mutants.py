"""Do the tests notice when an invariant is broken? Each mutant breaks one, on purpose, in a copy of the sources.

python -m benchmarks.mutants            # all of them
python -m benchmarks.mutants NAME ...   # only these
python -m benchmarks.mutants --table    # the rows of the table in docs/explanation/testing.md

The named tests have to pass on the sources as they are, and to fail on the mutant. Exit code 1 where one survives.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmarks.mutations import MUTANTS, Mutant

ROOT = Path(__file__).parents[1]
COPIED = ("src", "tests", "pyproject.toml")
TIMEOUT_S = 300


def mutated(text: str, mutant: Mutant) -> str:
    """The source with the fault in it.

    Raises:
        LookupError: the snippet does not stand there exactly once.
    """
    found = text.count(mutant.snippet)
    if found != 1:
        raise LookupError(f"{mutant.name}: the snippet stands {found} times in {mutant.file}, not once")
    return text.replace(mutant.snippet, mutant.instead)


def source(root: Path, mutant: Mutant) -> Path:
    """The file that is changed."""
    return root / "src" / "llm_flock" / mutant.file


def tests_pass(root: Path, tests: Iterable[str]) -> bool:
    """Whether these tests pass on the sources under `root`; they must exist, and finish in time."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
    command += [f"tests/{test}" for test in dict.fromkeys(tests)]
    # A file of byte code would outlive a change of the same size in the same second.
    environment = os.environ | {"PYTHONPATH": str(root / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"pytest could not run:\n{done.stdout}{done.stderr}")
    return done.returncode == 0


def main(arguments: Sequence[str]) -> int:
    """Try all mutants, or those named; returns the exit code."""
    if "--table" in arguments:
        print("\n".join(mutant.row for mutant in MUTANTS))
        return 0
    chosen = [mutant for mutant in MUTANTS if not arguments or mutant.name in arguments]
    survivors: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in COPIED:
            origin = ROOT / name
            copy = shutil.copytree if origin.is_dir() else shutil.copy
            copy(origin, root / name)
        changes = [(mutant, source(root, mutant).read_text(encoding="utf-8")) for mutant in chosen]
        faults = [mutated(text, mutant) for mutant, text in changes]
        if not tests_pass(root, [mutant.test for mutant in chosen]):
            print("the tests fail on the sources as they are")
            return 1
        for (mutant, text), fault in zip(changes, faults, strict=True):
            source(root, mutant).write_text(fault, encoding="utf-8")
            killed = not tests_pass(root, [mutant.test])
            source(root, mutant).write_text(text, encoding="utf-8")
            print(f"{'killed  ' if killed else 'SURVIVES'}  {mutant.name}: {mutant.change}", flush=True)
            if not killed:
                survivors.append(mutant.name)
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} killed")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
