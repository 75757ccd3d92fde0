"""What a page may ask for: a run's fields by name, checked as the command line checks them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from llm_flock.errors import InputError
from llm_flock.llm.local.weights import is_packaged
from llm_flock.robots.simulated import draw_start
from llm_flock.runtime.config import RunConfig, build_config
from llm_flock.runtime.planners import TeamPlanners
from llm_flock.runtime.seeds import Stream, stream

FIELDS: tuple[str, ...] = (
    "shape",
    "n_robots",
    "center",
    "spacing",
    "model",
    "protocol",
    "seed",
    "rounds",
    "loss",
    "start",
    "fallback",
    "gaps",
    "decide",
    "stop_when_formed",
)
"""Fields that a page may set. Those that name files, modules, addresses or folders are the command line's alone."""

CHANGES: tuple[str, ...] = ("shape", "places", "center", "spacing", "velocity")
"""Fields of a mission that may change in flight."""

FREE = ("simulated", "geometry")


def config_of(fields: Mapping[str, Any], models: Collection[str] = ()) -> RunConfig:
    """The configuration of a run that a page asks for; None and "" mean: not given.

    Args:
        fields: values by field name.
        models: models that cost money or reach out, and that the operator allowed on the command line.

    Raises:
        InputError: what the command line would say, or what a page may not ask for.
    """
    given = {name: value for name, value in fields.items() if value not in (None, "")}
    for name in given:
        if name not in FIELDS:
            raise InputError(name, given[name], f"one of the fields of this page: {', '.join(FIELDS)}")
    check_shape(given.get("shape"))
    model = given.get("model")
    # Per-robot lists ("0=...,1=...") are taken apart nowhere else: each part has to be free, or allowed as a whole.
    if model is not None and model not in models and not _free(str(model)):
        allowed = "simulated:PROFILE, geometry or local:smollm2, or a model that `llm-flock view --model` named"
        raise InputError("model", model, allowed)
    config = build_config({}, **given)
    if _free(config.model.model):
        # What else the command line would only say when the run begins.
        TeamPlanners(config)
        draw_start(config.mission, config.trial.start, stream(config.trial.seed, Stream.START))
    return config


def check_shape(shape: object) -> None:
    """Refuse shapes that are read from files.

    Raises:
        InputError: it is one.
    """
    if isinstance(shape, str) and shape.strip().startswith("points:"):
        raise InputError("shape", shape, "a shape with a name; pages read no files")


def _free(model: str) -> bool:
    provider, _, name = model.partition(":")
    # Of models on board only what is packaged: pages read no files.
    packaged = provider == "local" and is_packaged(name)
    return "=" not in model and (model == "geometry" or provider == "simulated" or packaged)
