"""A stand-in behind the task of Inspect, in a process of its own: its libraries leave things open that warn."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np

from llm_flock.llm.simulated.model import Responder
from llm_flock.llm.simulated.profiles import parse_profile

PROFILE = parse_profile("malformed@0.3,overshoot@0.3,distorted@0.3")


def answer(conversation: Sequence[tuple[str, str]]) -> str:
    """A stand-in whose chance is the conversation itself, so that it answers alike wherever it is asked."""
    seed = hashlib.blake2b(json.dumps(list(conversation)).encode(), digest_size=8).digest()
    rng = np.random.default_rng(int.from_bytes(seed))
    if conversation[0][1].startswith("You turn a request"):
        return json.dumps({"shape": "circle", "n_robots": int(rng.integers(3, 13))})
    return Responder(PROFILE, rng).answer(conversation)


def main(log_dir: str, limit: int) -> None:
    """Evaluate, and print each question's outcome and the metrics."""
    inspect_ai: Any = import_module("inspect_ai")
    models: Any = import_module("inspect_ai.model")

    from llm_flock.exam.inspect_task import exam

    @models.modelapi(name="hashed")
    def hashed() -> Any:
        class Api(models.ModelAPI):
            async def generate(self, input: Any, tools: Any, tool_choice: Any, config: Any) -> Any:
                return models.ModelOutput.from_content(
                    "hashed", answer([(message.role, message.text) for message in input])
                )

        return Api

    (log,) = inspect_ai.eval(exam(limit=limit), model="hashed/any", log_dir=log_dir, display="none")
    scores = {sample.id: sample.scores["by_our_checks"].metadata for sample in log.samples}
    found = {name: metric.value for score in log.results.scores for name, metric in score.metrics.items()}
    print(json.dumps({"status": log.status, "outcomes": scores, "metrics": found}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
