"""LLM-Flock: robots that agree on a formation, each with its own language model, without a central controller.

Everything that a program needs for a run is here:

import llm_flock

mission = llm_flock.Mission(shape="circle", n_robots=10)
result = llm_flock.run(mission, model="simulated:ideal", seed=7)
print(result.formed, result.summary.rounds_to_formed)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from llm_flock.errors import FlockError, InputError

if TYPE_CHECKING:
    from llm_flock.mission import Mission, build_mission
    from llm_flock.record._reader import read_record
    from llm_flock.runtime._api import run, run_async
    from llm_flock.runtime._result import RunResult, Summary

__all__ = [
    "FlockError",
    "InputError",
    "Mission",
    "RunResult",
    "Summary",
    "build_mission",
    "read_record",
    "run",
    "run_async",
]

_MODULES = {
    "Mission": "llm_flock.mission",
    "build_mission": "llm_flock.mission",
    "read_record": "llm_flock.record._reader",
    "run": "llm_flock.runtime._api",
    "run_async": "llm_flock.runtime._api",
    "RunResult": "llm_flock.runtime._result",
    "Summary": "llm_flock.runtime._result",
}


def __getattr__(name: str) -> Any:
    """Load a public name on first use: importing the model layer takes about a second."""
    if name not in _MODULES:
        raise AttributeError(f"module 'llm_flock' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_MODULES[name]), name)
