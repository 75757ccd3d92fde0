"""Choices of the form that starts runs: shapes with their pictures, protocols, and models."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from llm_flock_view._viewer.launcher import NEEDS_A_MODEL
from llm_flock_view._viewer.recording import in_unit_square

if TYPE_CHECKING:
    from llm_flock_view._viewer.launcher import Launcher

PROTOCOLS = {
    "flock": "this project's: agrees on one plan, auctions its places, keeps robots apart",
    "paper": "the paper's, to the letter: the most influential robot's plan, the nearest place",
    "baseline": "the paper's baseline: every robot follows its own plan",
}
GAPS = {"report": "stay empty: the others hold theirs", "replan": "the others make a smaller formation"}
STARTS = ("separated", "uniform", "connected")
MODELS = {
    "simulated:ideal": "always right",
    "simulated:distorted@0.3,overshoot@0.3": "plans off the shape, steps too long",
    "simulated:malformed@0.3,flaky@0.1": "answers that cannot be read, failed calls",
    "simulated:collapse@0.3": "plans that stack robots",
    "local:smollm2": "a small real model, on this machine",
    "geometry": "no model at all",
}


def options(launcher: Launcher) -> dict[str, Any]:
    allowed = [[name, "allowed by --model"] for name in launcher.models]
    return {
        "shapes": shape_pictures(),
        "reads": launcher.reader is not None,
        "needs": NEEDS_A_MODEL,
        "protocols": [[name, about] for name, about in PROTOCOLS.items()],
        "models": [*allowed, *([name, about] for name, about in MODELS.items() if name not in launcher.models)],
        "gaps": list(GAPS.items()),
        "starts": STARTS,
    }


EXAMPLES = {"polygon:K": "polygon:5", "text:DESCRIPTION": "text:a smiling face", "letters:TEXT": "letters:HI"}
"""Shapes that need an argument are offered with one."""


@cache
def shape_pictures() -> list[dict[str, Any]]:
    """Every shape by name, with its places between 0 and 1; none for a described shape, whose places a model finds."""
    from llm_flock import shapes as formations

    found: list[dict[str, Any]] = []
    for shape in (*formations.shapes(), *formations.drawn_shapes()):
        if shape.name == "points" or shape.in_space or shape.name.endswith(":FILE"):
            continue
        name = EXAMPLES.get(shape.name, shape.name)
        n = max(shape.examples)
        about = {"name": name, "takes": shape.legal, "about": shape.description}
        found.append({**about, "robots": n, "places": _places(name, n)})
    return found


def _places(name: str, n: int) -> list[list[float]]:
    from llm_flock import shapes as formations

    points = formations.ideal_points(name, n, (0.0, 0.0), 10.0)
    if points is None:
        return []
    return in_unit_square(points.tolist())
