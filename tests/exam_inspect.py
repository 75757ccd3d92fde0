"""Evaluates a stand-in by Inspect, in a process of its own: its libraries leave things open that warn."""

from __future__ import annotations

import json
import sys
from importlib import import_module
from typing import Any

from exam_models import hashed


def main(log_dir: str, limit: int) -> None:
    """Evaluate, and print each question's outcome and the metrics."""
    inspect_ai: Any = import_module("inspect_ai")
    models: Any = import_module("inspect_ai.model")

    from llm_flock_lab._exam.inspect_task import exam

    @models.modelapi(name="hashed")
    def provider() -> Any:
        class Api(models.ModelAPI):
            async def generate(self, input: Any, tools: Any, tool_choice: Any, config: Any) -> Any:
                conversation = [(message.role, message.text) for message in input]
                return models.ModelOutput.from_content("hashed", hashed(conversation))

        return Api

    (log,) = inspect_ai.eval(exam(limit=limit), model="hashed/any", log_dir=log_dir, display="none")
    scores = {sample.id: sample.scores["by_our_checks"].metadata for sample in log.samples}
    found = {name: metric.value for score in log.results.scores for name, metric in score.metrics.items()}
    print(json.dumps({"status": log.status, "outcomes": scores, "metrics": found}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
