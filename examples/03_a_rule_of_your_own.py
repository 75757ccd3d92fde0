"""Your own consensus rule: the plan with the smallest bounding box wins."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import llm_flock
from llm_flock.message import Message
from llm_flock.plan import Plan
from llm_flock.protocol import Standing
from llm_flock.testing import check_consensus_rule


def rank(plan: Plan) -> tuple[float, str]:
    """Smaller is better; the digest breaks ties, the same for all robots."""
    return float(np.ptp(plan.array, axis=0).prod()), plan.digest


@dataclass(frozen=True)
class SmallestBox:
    """Smaller plans win."""

    name: str = "smallest-box"

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        """Adopt the smallest plan heard, if it is smaller than this robot's own."""
        best: Message | None = None
        for message in heard:
            if message.plan is None:
                continue
            rival = best.plan if best is not None else own.plan
            if rival is None or rank(message.plan) < rank(rival):
                best = message
        return best


def main() -> None:
    check_consensus_rule(SmallestBox())
    mission = llm_flock.Mission(shape="square", n_robots=8)
    result = llm_flock.run(mission, consensus=SmallestBox(), model="simulated:ideal", seed=3)
    print(f"{result.summary.consensus}: formed {result.formed}, plans in use {result.summary.plans_in_use}")


if __name__ == "__main__":
    main()
