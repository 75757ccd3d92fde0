"""What `--dry-run` says of large teams: calls forecast from smaller teams, beside those of the teams themselves.

    python -m benchmarks forecasts [SHAPE/N/SEED ...]

Instant simulated models, which plan well; arenas that fit. No constant of the forecast was fitted to these teams.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from unittest.mock import patch

import numpy as np

from llm_flock import formations, run
from llm_flock.experiments import sweep_forecast
from llm_flock.experiments.sweep_file import ExpectTable
from llm_flock.runtime.config import RunConfig, build_config

TEAMS = "circle/64/1 grid/81/1 line/96/1 star/100/2 square/120/1 circle/128/1 grid/144/1 circle/160/2 grid/256/1"
MODEL = "ideal"


def team(shape: str, n: int, seed: int) -> RunConfig:
    """A run of this team in an arena with room for its starts and its formation."""
    places = formations.ideal_points(shape, n, (0.0, 0.0), 10.0)
    assert places is not None
    reach = formations.circumradius(np.array(places), (0.0, 0.0))
    side = max(round(20 * math.sqrt(n) + 100), math.ceil(2 * reach + 20))
    fields = {"shape": shape, "n_robots": n, "seed": seed, "center": (side / 2, side / 2), "rounds": 600}
    return build_config({}, model=f"simulated:{MODEL}", arena=((0, 0), (side, side)), **fields)


def main(arguments: Sequence[str] = ()) -> None:
    """Print a line for each team."""
    print(f"{'team':16} {'forecast':>9} {'real':>6}  calls a robot")
    for name in arguments or TEAMS.split():
        shape, n, seed = name.split("/")
        config = team(shape, int(n), int(seed))
        began = time.process_time()
        with patch.object(sweep_forecast, "REHEARSAL_S", 0.0):  # the team does not rehearse itself
            expected = sweep_forecast.expect_run(config, ExpectTable(profile=MODEL))[0].calls / int(n)
        took = time.process_time() - began
        real = run(config=config, progress=False, trace=False).summary.model_calls / int(n)
        share = expected / real
        print(f"{name:16} {expected:9.1f} {real:6.1f}  {share:4.2f} of it, forecast in {took:.1f} s", flush=True)
