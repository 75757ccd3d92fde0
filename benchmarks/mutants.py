"""Check that the tests notice broken invariants: try each fault of mutations.toml in a copy of the sources.

python -m benchmarks.mutants            # all of them
python -m benchmarks.mutants NAME ...   # only these

The named tests must pass on the sources as they are and fail on the mutant. The exit code is 1 if a mutant survives.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

ROOT = Path(__file__).parents[1]
COPIED = ("packages", "conftest.py", "tests", "benchmarks", "pyproject.toml")
TIMEOUT_S = 300


class Mutant(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One deliberate fault; mutations.toml explains the fields."""

    name: str
    invariant: str
    fault: str
    file: str
    snippet: str
    instead: str
    test: str

    def path(self, root: Path) -> Path:
        """The file that is changed."""
        return root / self.file

    def applied(self, text: str) -> str:
        """The source with the fault in it.

        Raises:
            LookupError: the snippet does not occur exactly once.
        """
        found = text.count(self.snippet)
        if found != 1:
            raise LookupError(f"{self.name}: the snippet occurs {found} times in {self.file}, not once")
        return text.replace(self.snippet, self.instead)


def load() -> list[Mutant]:
    """All mutants."""
    text = (ROOT / "benchmarks" / "mutations.toml").read_text(encoding="utf-8")
    return msgspec.convert(tomllib.loads(text)["mutant"], list[Mutant])


def tests_pass(root: Path, tests: Iterable[str]) -> bool:
    """Whether these tests pass on the sources under `root`; they must exist, and finish in time."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
    command += dict.fromkeys(tests)
    # Byte code would outlive a change of the same size in the same second.
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(map(str, root.glob("packages/*/src"))),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"pytest could not run:\n{done.stdout}{done.stderr}")
    return done.returncode == 0


def survives(root: Path, mutant: Mutant) -> bool:
    """Whether the mutant's test still passes with the fault in place."""
    path = mutant.path(root)
    text = path.read_text(encoding="utf-8")
    path.write_text(mutant.applied(text), encoding="utf-8")
    try:
        return tests_pass(root, [mutant.test])
    finally:
        path.write_text(text, encoding="utf-8")


def main(names: Sequence[str]) -> int:
    """Try all mutants, or those named; returns the exit code."""
    chosen = [mutant for mutant in load() if not names or mutant.name in names]
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in COPIED:
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
            copy(ROOT / name, root / name)
        if not tests_pass(root, [mutant.test for mutant in chosen]):
            print("the tests fail on the sources as they are")
            return 1
        for mutant in chosen:
            alive = survives(root, mutant)
            survivors += alive
            print(f"{'SURVIVES' if alive else 'killed  '}  {mutant.name}: {mutant.fault}", flush=True)
    print(f"{len(chosen) - survivors} of {len(chosen)} killed")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
