"""The optional parts of an installation, their purposes, and the error that names a missing one."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec

from llm_flock.errors import FieldError


@dataclass(frozen=True, slots=True)
class Extra:
    """Libraries that one activity needs: `modules` have to be importable, `commands` come with it."""

    name: str
    purpose: str
    modules: tuple[str, ...]
    commands: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        """Modules that are not installed. Imports none of them."""
        return tuple(module for module in self.modules if find_spec(module) is None)

    @property
    def install(self) -> str:
        """The command that installs it."""
        return f"pip install 'llm-flock[{self.name}]'"


_TABLE = (
    Extra("openai", "models of OpenAI, and of servers that speak its protocol", ("openai",)),
    Extra("anthropic", "models of Anthropic", ("anthropic",)),
    Extra("figures", "figure, animate", ("llm_flock_view", "matplotlib", "PIL"), ("figure", "animate")),
    Extra(
        "sweep",
        "sweep, report, export",
        ("llm_flock_lab", "polars", "matplotlib", "PIL"),
        ("compare", "sweep", "report"),
    ),
    Extra("view", "view", ("llm_flock_view", "starlette", "uvicorn"), ("view",)),
    Extra("notebook", "notebooks: frames of pandas, pictures and animations", ("ipykernel", "pandas", "polars", "PIL")),
    Extra("env", "an environment of PettingZoo", ("llm_flock_lab", "gymnasium", "pettingzoo")),
    Extra("mcp", "tools for agents, by the Model Context Protocol", ("llm_flock_lab", "mcp"), ("mcp",)),
    Extra(
        "network",
        "swarm, robot, world, watch, mission, keys",
        ("llm_flock_swarm", "zenoh", "cryptography"),
        ("swarm", "robot", "world", "watch", "mission", "keys"),
    ),
    Extra(
        "foxglove", "--foxglove of run, swarm, watch, fly and view; export --foxglove", ("llm_flock_view", "foxglove")
    ),
    Extra(
        "ros2",
        "--ros2 of swarm, watch and fly; ros2; export --ros2bag",
        ("llm_flock_swarm", "zenoh", "rosbags"),
        ("ros2",),
    ),
    Extra("rerun", "export --rerun", ("llm_flock_view", "rerun")),
    Extra("flight", "fly simulated drones, and the base of real ones", ("llm_flock_flight",), ("fly", "stand-ins")),
    Extra("crazyflie", "fly", ("llm_flock_flight", "cflib", "yaml")),
    Extra("mocap", "positions by a motion capture (pose_source = 'mocap')", ("llm_flock_flight", "motioncapture")),
    Extra("mavlink", "fly copters with PX4 or ArduPilot", ("llm_flock_flight", "pymavlink", "serial")),
    Extra("local", "models on board (--model local:smollm2)", ("llm_flock_onboard", "xllamacpp")),
    Extra("cluster", "sweep --cluster", ("llm_flock_lab", "ray")),
    Extra("physics", "rehearse flights in simulated physics", ("llm_flock_flight", "crazyflow")),
    Extra("exam", "exam", ("llm_flock_lab", "inspect_ai"), ("exam",)),
    Extra("distill", "distill", ("llm_flock_onboard", "torch", "transformers", "gguf"), ("distill",)),
)
EXTRAS: Mapping[str, Extra] = {extra.name: extra for extra in _TABLE}
"""The extras of this package by name, as pyproject.toml lists them."""


class ExtraMissing(FieldError):
    """Something was asked for whose libraries are not installed.

    Attributes:
        what: what was asked for.
        extra: name of the extra that it needs.
    """

    def __init__(self, what: str, extra: str) -> None:
        self.what = what
        self.extra = extra
        super().__init__("extra", extra, says=f"{what} needs the extra {extra}: {EXTRAS[extra].install}")

    def __reduce__(self) -> tuple[type[ExtraMissing], tuple[str, str]]:
        return type(self), (self.what, self.extra)


def require(extra: str, what: str) -> None:
    """Raise ExtraMissing if an extra is not installed that `what`, the operator's request, needs."""
    if EXTRAS[extra].missing:
        raise ExtraMissing(what, extra)


def require_posix(what: str) -> None:
    """Check that the system has processes and signals as Linux and macOS do.

    Raises:
        InputError: it is Windows.
    """
    if os.name == "nt":
        says = f"{what} needs Linux or macOS; on Windows, the Windows Subsystem for Linux"
        raise FieldError("system", "Windows", says=says)
