"""Plug-ins installed beside the core. Parts announce them as entry points, which only this file reads.

An entry point of the group `llm_flock.KIND` is one thing of that kind, under its name:

| Kind | Name | Object |
|---|---|---|
| `commands` | the command | a function with Typer's parameters, or a Typer with commands of its own |
| `models` | prefix of a model string | a `llm_flock.llm.ModelSource` |
| `consensus`, `assignment` | the rule | a class without parameters that is a `ConsensusRule` or an `AssignmentRule` |
| `collision_checks` | the check | a `llm_flock.runtime._trial.CollisionCheck` |
| `robots` | the driver | makes the robots of a flight (`llm_flock_flight._flight.fleet.Driver`) |
| `sinks` | the flag | a function that shows runs while they fly (`llm_flock.cli._extensions`) |
| `exports` | the flag | a function that writes a record for another program (`llm_flock.cli._export`) |
| `inspections` | the subject | a function that shows more of a record in `llm-flock inspect` |
| `watches` | what is watched | makes a `llm_flock_view._viewer.swarm.WatchedTeam` |
| `flights` | what shows them | shows flights, and provides poses (`llm_flock_flight._flight.shown`) |
| `doctor` | the subject | a function that returns the findings of `llm-flock doctor` |
| `views` | `html` or `animation` | how a notebook shows a record |
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from llm_flock.errors import FieldError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Kind: TypeAlias = Literal[
    "commands",
    "models",
    "consensus",
    "assignment",
    "collision_checks",
    "robots",
    "sinks",
    "exports",
    "inspections",
    "watches",
    "flights",
    "doctor",
    "views",
]


@cache
def entries(kind: Kind) -> Mapping[str, EntryPoint]:
    """The plug-ins of a kind by name, in the order of their names. Imports none of them."""
    from importlib.metadata import entry_points  # takes longer to import than many commands take

    installed = entry_points(group=f"llm_flock.{kind}")
    return {entry.name: entry for entry in sorted(installed, key=lambda entry: entry.name)}


def load(kind: Kind, name: str) -> Any:
    """The plug-in of this name.

    Raises:
        KeyError: there is none.
        FieldError: for field `plugin`: it cannot be imported.
    """
    entry = entries(kind)[name]
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        source = "an unknown distribution" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
        says = f"{entry.value} of {source}, which is installed, cannot be imported ({error})"
        raise FieldError("plugin", name, says=says) from error


def load_all(kind: Kind) -> Iterator[tuple[str, Any]]:
    """Every plug-in of a kind with its name; raises as `load`."""
    for name in entries(kind):
        yield name, load(kind, name)
