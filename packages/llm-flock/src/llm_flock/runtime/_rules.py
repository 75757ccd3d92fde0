"""Rules by name, and presets of rules; a plug-in adds names, and `package.module:Class` names a user's rule."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

from llm_flock.errors import InputError, unknown
from llm_flock.protocol._agreement import PRESET_RULES
from llm_flock.protocol._agreement.assignment import (
    AssignmentRule,
    IndexAssignment,
    NearestAssignment,
    NearestFreeAssignment,
)
from llm_flock.protocol._agreement.consensus import (
    ConsensusRule,
    InfluenceConsensus,
    NoConsensus,
    ProvenanceConsensus,
    Ties,
)

Rules: TypeAlias = tuple[ConsensusRule, AssignmentRule]  # the two rules of an agent


LeftOut: TypeAlias = Literal["exchanges", "path-cost", "joint-assignment", "search", "right-of-way"]
"""A part that a team with the auction and the shield can do without."""


def _auction(without: LeftOut | None = None) -> AssignmentRule:
    from llm_flock.protocol._agreement.auction import AuctionAssignment

    return AuctionAssignment(swaps=without != "exchanges", straight=without == "path-cost")


def _medoid() -> ConsensusRule:
    from llm_flock.protocol._agreement.medoid import MedoidConsensus

    return MedoidConsensus()


CONSENSUS: Mapping[str, Callable[[], ConsensusRule]] = MappingProxyType(
    {"none": NoConsensus, "influence": InfluenceConsensus, "provenance": ProvenanceConsensus, "medoid": _medoid}
)
ASSIGNMENT: Mapping[str, Callable[[], AssignmentRule]] = MappingProxyType(
    {"index": IndexAssignment, "nearest": NearestAssignment, "nearest-free": NearestFreeAssignment, "auction": _auction}
)


_CHECKED = {"verify": True, "comm_rounds": 5, "fallback": "breaker"}
_BARE = {"verify": False, "comm_rounds": 1, "fallback": "hold"}
_RELEASED = {"relay": True, "collision_check": "central"}

PRESETS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        name: {"ties": "keep", "relay": False, "collision_check": "none"}
        | dict(zip(("consensus", "assignment", "shield"), rules, strict=True))
        | (_CHECKED if name == "flock" else _BARE)
        | (_RELEASED if name == "released" else {})
        for name, rules in PRESET_RULES.items()
    }
)


def consensus_rule(name: str | ConsensusRule, ties: Ties = "keep") -> ConsensusRule:
    """The consensus rule of this name, or this object itself. InputError if it is no such rule."""
    if name == "influence":
        return InfluenceConsensus(ties=ties)
    if ties != "keep":
        raise InputError("ties", ties, f"'keep' with consensus = {name!r}")
    return _rule("consensus", name, CONSENSUS, ("choose",))


def assignment_rule(name: str | AssignmentRule, without: LeftOut | None = None) -> AssignmentRule:
    """The assignment rule of this name, or this object itself. InputError if it is no such rule."""
    return _auction(without) if name == "auction" else _rule("assignment", name, ASSIGNMENT, ("take", "update"))


def know_no_team(rules: Rules) -> bool:
    """Whether these rules are those of the paper or its baseline, in any reading, or others that know of no team."""
    consensus, assignment = rules
    papers = IndexAssignment | NearestAssignment | NearestFreeAssignment
    alone = isinstance(assignment, papers) or not getattr(assignment, "team", True)
    return isinstance(consensus, NoConsensus | InfluenceConsensus) and alone


def own_rules(rules: Rules) -> list[str]:
    """Sentences on rules that a record cannot repeat, because they are user code."""
    ours = "llm_flock.protocol._agreement."
    return [
        f"The rule {type(rule).__module__}:{type(rule).__qualname__} is code of the user's own, of which only the name "
        "is recorded."
        for rule in rules
        if not type(rule).__module__.startswith(ours)
    ]


def _rule(
    field: Literal["consensus", "assignment"],
    name: Any,
    known: Mapping[str, Callable[[], Any]],
    methods: tuple[str, ...],
) -> Any:
    rule = name
    if isinstance(name, str):
        if name in known:
            return known[name]()
        from llm_flock import plugins

        installed = plugins.entries(field)
        if name in installed:
            rule = plugins.load(field, name)()
        elif ":" not in name:
            raise InputError(field, name, says=unknown("rule", name, (*known, *installed, "package.module:Class")))
        else:
            from llm_flock.user_code import load_own

            allowed = "package.module:Class that can be imported"
            rule_class = load_own(field, name, allowed)
            try:
                rule = rule_class()
            except (AttributeError, TypeError, ValueError) as error:
                raise InputError(field, name, f"{allowed} ({error})") from error
    complete = isinstance(getattr(rule, "name", None), str) and all(callable(getattr(rule, m, None)) for m in methods)
    if isinstance(rule, type) or not complete:
        allowed = f"a name, or an object with a name and {' and '.join(methods)}; see llm_flock.testing"
        raise InputError(field, rule, allowed)
    return rule
