"""What the terminal shows of a comparison: a line for each finished row, and the table in the end."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from llm_flock.experiments.compare import Cell, compare
from llm_flock.experiments.comparison_table import TrialFile, markdown
from llm_flock.experiments.trials import Outcome


def show_comparison(
    cells: Sequence[Cell], *, trials: int, first_seed: int, jobs: int, out: Path | None, as_json: bool, quiet: bool
) -> bool:
    """Fly a comparison and print it; returns whether no trial broke off.

    Raises:
        InputError: a value is not allowed; nothing has been flown then.
        FlockError: a worker was killed.
        KeyboardInterrupt: after all workers were stopped; the file holds the trials that were ready.
    """
    seen = formed = 0
    with ExitStack() as stack:
        file = None if out is None else stack.enter_context(TrialFile(out))

        def note(cell: Cell, outcome: Outcome) -> None:
            nonlocal seen, formed
            if file is not None:
                file.add(cell, outcome)
            seen, formed = seen + 1, formed + outcome.formed
            if seen == trials:
                if not quiet:
                    print(f"{cell.protocol} {cell.shape} {cell.n_robots}: {formed} of {trials} formed", file=sys.stderr)
                seen = formed = 0

        rows = compare(cells, trials=trials, first_seed=first_seed, jobs=jobs, on_outcome=note)
    print(json.dumps([row.to_dict() for row in rows], allow_nan=False) if as_json else markdown(rows))
    return not any(row.broken for row in rows)
