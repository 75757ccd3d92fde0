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
    from llm_flock.agent import Agent
    from llm_flock.llm._port import LanguageModel
    from llm_flock.mission import Mission, build_mission
    from llm_flock.plan import Plan
    from llm_flock.protocol._agreement.assignment import AssignmentRule
    from llm_flock.protocol._agreement.consensus import ConsensusRule
    from llm_flock.protocol._parts import Parts
    from llm_flock.protocol._planning import Planner
    from llm_flock.record._reader import read_record
    from llm_flock.robots._base import Robot
    from llm_flock.runtime._api import run, run_async
    from llm_flock.runtime._result import RunResult, Summary

__all__ = [
    "Agent",
    "AssignmentRule",
    "ConsensusRule",
    "FlockError",
    "InputError",
    "LanguageModel",
    "Mission",
    "Parts",
    "Plan",
    "Planner",
    "Robot",
    "RunResult",
    "Summary",
    "build_mission",
    "read_record",
    "run",
    "run_async",
]

_MODULES = {
    "Agent": "llm_flock.agent",
    "AssignmentRule": "llm_flock.protocol._agreement.assignment",
    "ConsensusRule": "llm_flock.protocol._agreement.consensus",
    "LanguageModel": "llm_flock.llm._port",
    "Mission": "llm_flock.mission",
    "Parts": "llm_flock.protocol._parts",
    "Plan": "llm_flock.plan",
    "Planner": "llm_flock.protocol._planning",
    "Robot": "llm_flock.robots._base",
    "RunResult": "llm_flock.runtime._result",
    "Summary": "llm_flock.runtime._result",
    "build_mission": "llm_flock.mission",
    "read_record": "llm_flock.record._reader",
    "run": "llm_flock.runtime._api",
    "run_async": "llm_flock.runtime._api",
}


def __getattr__(name: str) -> Any:
    """Load a public name on first use: importing the model layer takes about a second."""
    if name not in _MODULES:
        raise AttributeError(f"module 'llm_flock' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_MODULES[name]), name)
