"""Takes several exams, and evaluates a stand-in by Inspect, in one process.

Importing Inspect takes seconds, and its libraries leave things open that warn.
"""

from __future__ import annotations

import json
import shlex
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from command_line import flock
from exam_models import hashed


def taken(kinds: dict[str, list[str]]) -> dict[str, list[tuple[int, str]]]:
    """Exit code and stderr of each line of `llm-flock exam`; each kind of lines runs in a folder of its own."""
    said: dict[str, list[tuple[int, str]]] = {}
    for kind, lines in kinds.items():
        folder = Path(kind).absolute()
        folder.mkdir()
        done = [flock("exam", *shlex.split(line), "--quiet", cwd=folder, check=False) for line in lines]
        said[kind] = [(one.returncode, one.stderr) for one in done]
    return said


def evaluated(limit: int) -> dict[str, Any]:
    """Each question's outcome and the metrics of an evaluation by Inspect itself."""
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

    (log,) = inspect_ai.eval(exam(limit=limit), model="hashed/any", log_dir="by_inspect", display="none")
    scores = {sample.id: sample.scores["by_our_checks"].metadata for sample in log.samples}
    found = {name: metric.value for score in log.results.scores for name, metric in score.metrics.items()}
    return {"status": log.status, "outcomes": scores, "metrics": found}


if __name__ == "__main__":
    # First, as a task that is made later finds the model of the last exam.
    by_inspect = evaluated(int(sys.argv[2]))
    print(json.dumps([taken(json.loads(sys.argv[1])), by_inspect]))
