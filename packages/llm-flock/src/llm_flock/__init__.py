"""LLM-Flock: robots that agree on a formation, each with its own language model, without a central controller.

Everything that a program needs for a run is here:

import llm_flock

mission = llm_flock.Mission(shape="circle", n_robots=10)
result = llm_flock.run(mission, model="simulated:ideal", seed=7)
print(result.formed, result.summary.rounds_to_formed)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
