"""What keeping the conversation and telling of all robots costs in tokens, and what it brings.

    python benchmarks/conversation.py [--trials 20] [--model simulated:ideal]

The circle of ten, default protocol. With a simulated model the tokens are real (its own count of the characters it
was given and gave), but the result is not evidence: a stand-in reads only the last question.
"""

from __future__ import annotations

import argparse
import itertools
import statistics

import llm_flock


def main() -> None:
    """Run all combinations and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--model", default="simulated:ideal")
    given = parser.parse_args()
    print(f"{given.model}, {given.trials} seeds a row, mean over trials\n")
    print("| history | observe | formed | rounds | tokens in per call | tokens in per run |")
    print("|---|---|---|---|---|---|")
    for history, observe in itertools.product(("none", "last:3", "full"), ("in-range", "all")):
        runs = [
            llm_flock.run(
                llm_flock.Mission(shape="circle", n_robots=10),
                model=given.model,
                history=history,
                observe=observe,
                seed=seed,
            ).summary
            for seed in range(given.trials)
        ]
        formed = sum(run.formed for run in runs)
        rounds = statistics.mean(run.rounds for run in runs)
        tokens = statistics.mean(run.tokens_input for run in runs)
        per_call = statistics.mean(run.tokens_input / run.model_calls for run in runs)
        print(
            f"| {history} | {observe} | {formed} of {given.trials} | {rounds:.1f} | {per_call:,.0f} | {tokens:,.0f} |"
        )


if __name__ == "__main__":
    main()
