"""Rules by name, and presets of rules; `package.module:Class` names a user's rule."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

from llm_flock.errors import InputError
from llm_flock.protocol.agreement.assignment import (
    AssignmentRule,
    IndexAssignment,
    NearestAssignment,
    NearestFreeAssignment,
)
from llm_flock.protocol.agreement.auction import AuctionAssignment
from llm_flock.protocol.agreement.consensus import ConsensusRule, InfluenceConsensus, NoConsensus, ProvenanceConsensus

Rules: TypeAlias = tuple[ConsensusRule, AssignmentRule]
"""The two rules of an agent."""

CONSENSUS: Mapping[str, Callable[[], ConsensusRule]] = MappingProxyType(
    {"none": NoConsensus, "influence": InfluenceConsensus, "provenance": ProvenanceConsensus}
)
ASSIGNMENT: Mapping[str, Callable[[], AssignmentRule]] = MappingProxyType(
    {
        "index": IndexAssignment,
        "nearest": NearestAssignment,
        "nearest-free": NearestFreeAssignment,
        "auction": AuctionAssignment,
    }
)
PRESETS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "flock": {
            "consensus": "provenance",
            "assignment": "auction",
            "shield": True,
            "verify": True,
            "comm_rounds": 5,
            "fallback": "breaker",
        },
        "paper": {
            "consensus": "influence",
            "assignment": "nearest",
            "shield": False,
            "verify": False,
            "comm_rounds": 1,
            "fallback": "hold",
        },
        "baseline": {
            "consensus": "none",
            "assignment": "index",
            "shield": False,
            "verify": False,
            "comm_rounds": 1,
            "fallback": "hold",
        },
    }
)


def consensus_rule(name: str) -> ConsensusRule:
    """The consensus rule of this name; `InputError` for an unknown one."""
    return _rule("consensus", name, CONSENSUS, ("choose",))


def assignment_rule(name: str) -> AssignmentRule:
    """The assignment rule of this name; `InputError` for an unknown one."""
    return _rule("assignment", name, ASSIGNMENT, ("take", "update"))


def _rule(field: str, name: str, known: Mapping[str, Callable[[], Any]], methods: tuple[str, ...]) -> Any:
    if name in known:
        return known[name]()
    allowed = f"one of {', '.join(known)}, or package.module:Class"
    module, colon, attribute = name.partition(":")
    if not colon:
        raise InputError(field, name, allowed)
    try:
        rule = getattr(importlib.import_module(module), attribute)()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InputError(field, name, f"{allowed} ({error})") from None
    if not isinstance(getattr(rule, "name", None), str) or not all(callable(getattr(rule, m, None)) for m in methods):
        raise InputError(field, name, f"a class with a name and {' and '.join(methods)}; see llm_flock.testing")
    return rule
