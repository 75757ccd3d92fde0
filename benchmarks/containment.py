"""One bad mind harms nobody: teams with models that are always bad, and what they cost.

    python -m benchmarks containment [--trials N] [--jobs N]     1,000 trials of each case and team
    python -m benchmarks containment-http                        twenty missions of each of 4 cases over HTTP

All models are simulated. Calls are compared with those of the same team with ideal models on the same seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

import llm_flock
from llm_flock_lab._experiments.compare import build_cells, compare

TEAMS = (("triangle", 3), ("square", 8), ("cross", 5), ("circle", 10))
IDEAL = "simulated:ideal"

CASES: dict[str, Callable[[int], str]] = {
    "ideal": lambda n: IDEAL,
    "one malformed": lambda n: _some(n, 1, "malformed"),
    "one collapse": lambda n: _some(n, 1, "collapse"),
    "half distorted": lambda n: _some(n, (n + 1) // 2, "distorted"),
    "all but one distorted": lambda n: _some(n, n - 1, "distorted"),
    "all overshoot": lambda n: "simulated:overshoot",
    "all overlong": lambda n: "simulated:overlong",
}
"""Models of a team of n, by the name of the case."""

HOPELESS = ("distorted", "malformed", "malformed,distorted,collapse")


def _some(n: int, bad: int, profile: str) -> str:
    """The first `bad` of n robots have a model that always fails like this."""
    return f"0-{bad - 1}=simulated:{profile},{bad}-{n - 1}={IDEAL}"


def cases(trials: int, jobs: int) -> None:
    """Every case on every team."""
    print(
        f"{trials} trials each, simulated language models; bars: formed >= 99.9 %, "
        "separation never below the safe distance, calls as each line says"
    )
    for shape, n in TEAMS:
        ideal_calls = 0.0
        for name, models in CASES.items():
            (row,) = compare(build_cells([(shape, n)], ["flock"], model=models(n)), trials=trials, jobs=jobs)
            calls = 0.0 if row.calls is None else row.calls.value
            ideal_calls = calls if name == "ideal" else ideal_calls
            bar = 1.2 if name == "all overlong" else 2.0
            good = row.formed.value >= 0.999 and not row.violations and calls <= bar * ideal_calls
            print(
                f"{shape:>8} {n:2}  {name:22} formed {row.formed.value:7.2%}  by models {row.by_models.value:7.2%}  "
                f"ratio {row.ratio.value if row.ratio else 0:.2f}  "
                f"separation {row.min_separation or 0:.6f} ({row.violations} violations)  "
                f"calls/robot {calls:5.2f} = {calls / ideal_calls:.2f} x ideal (bar {bar:g})  "
                f"{'ok' if good else f'MISSED, seeds {row.failed_seeds[:5]}'}",
                flush=True,
            )


def hopeless(trials: int) -> None:
    """Teams of which no model ever gives an acceptable plan."""
    print("no model proposes an acceptable plan; bars: no_plan in at most 10 rounds and 6 calls a robot")
    for shape, n in TEAMS:
        for profile in HOPELESS:
            mission = llm_flock.Mission(shape=shape, n_robots=n)
            found = [llm_flock.run(mission, model=f"simulated:{profile}", seed=s).summary for s in range(trials)]
            stopped = {summary.stopped for summary in found}
            rounds, calls = max(s.rounds for s in found), max(s.model_calls for s in found) / n
            good = stopped == {"no_plan"} and rounds <= 10 and calls <= 6
            ends = ", ".join(sorted(stopped))
            print(
                f"{shape:>8} {n:2}  all {profile:30} ended {ends}, at most {rounds} rounds, {calls:.2f} calls/robot  "
                f"{'ok' if good else 'MISSED'}",
                flush=True,
            )


def over_http(missions: int = 20) -> None:
    """Robots whose model always distorts its plan and always overshoots, on a server of the tests' own."""
    from integration.fault_server import running

    with running(bad_profile="distorted,overshoot") as server:
        for shape, n in (("circle", 10), ("square", 8)):
            for one_in in (5, 2):
                kinds = ["bad" if robot % one_in == 0 else "test" for robot in range(n)]
                models = ",".join(f"{robot}=openai-compatible:{kind}" for robot, kind in enumerate(kinds))
                mission = llm_flock.Mission(shape=shape, n_robots=n)
                found = [
                    llm_flock.run(mission, model=models, base_url=server.base_url, seed=seed).summary
                    for seed in range(missions)
                ]
                formed = sum(summary.formed for summary in found)
                closest = min(summary.min_separation or 0.0 for summary in found)
                calls = sum(summary.model_calls for summary in found) / missions / n
                share = "fifth" if one_in == 5 else "second"
                print(
                    f"{shape} {n}, every {share} robot bad: formed {formed} of {missions}, "
                    f"separation {closest:.6f}, {calls:.2f} calls/robot",
                    flush=True,
                )


def main(arguments: Sequence[str] = ()) -> None:
    """All cases without HTTP."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks containment")
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(arguments)
    cases(options.trials, options.jobs)
    hopeless(max(1, options.trials // 20))
