"""Consensus rules choose the plan to follow, from the own plan and the messages just heard."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import msgspec

from llm_flock.algorithm1 import adopt
from llm_flock.message import Message, Provenance
from llm_flock.plan import Plan

PlanKey: TypeAlias = tuple[int, str, int, int, int, int, int, int, str]
TieBreak: TypeAlias = Literal["lowest", "highest"]
Ties: TypeAlias = Literal["keep", "lowest-id"]


class Standing(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's own side of the comparison."""

    robot: int  #: Its id.
    plan: Plan | None  #: The plan that it follows, None before it has one.
    provenance: Provenance | None  #: Origin of that plan.
    degree: int  #: Number of robots within its radio range, that is N times its influence (paper, eq. 1).
    plan_class: int = 0  #: Class of that plan (`_verification.plans.PlanClass`); 0 where nothing is checked.


class ConsensusRule(Protocol):
    """Chooses the message whose plan is to be adopted.

    A rule is a pure function of its arguments: the same arguments give the same choice, in any order of `heard`
    (the newest message of each sender, in ascending order of ids).
    `llm_flock.testing.check_consensus_rule` tests a new rule.
    """

    @property
    def name(self) -> str:
        """Name on the command line and in records."""
        ...

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        """The message whose plan to adopt, or None to keep the own plan."""
        ...


@dataclass(frozen=True, slots=True)
class NoConsensus:
    """The paper's baseline: every robot keeps its own plan (line 207)."""

    name: str = "none"

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        """Never adopt."""
        return None


@dataclass(frozen=True, slots=True)
class InfluenceConsensus:
    """The paper's Algorithm 1, literally (lines 133 and 149-158).

    Of all neighbours heard, k has the highest influence; its plan is adopted if I_k > I_i strictly and P_k differs from
    P_i. The paper does not say which of several equally influential neighbours is k; `tie` does. With `ties` of
    `lowest-id`, which the paper does not have, a robot also adopts the plan of an equally influential k of lower id.
    """

    tie: TieBreak = "lowest"
    ties: Ties = "keep"
    name: str = "influence"

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        """Adopt the plan of the most influential neighbour if it outranks this robot."""
        yields_to = own.robot if self.ties == "lowest-id" else 0
        return adopt(own.degree, own.plan, heard, lowest=self.tie == "lowest", yields_to=yields_to)


def plan_key(plan: Plan, origin: Provenance, plan_class: int) -> PlanKey:
    """A plan's place in the total order: keys are compared element by element, and the higher one wins."""
    return (
        origin.mission,
        origin.mission_digest,
        origin.epoch,
        len(plan),
        plan_class,
        origin.degree,
        origin.proposer,
        origin.sequence,
        plan.digest,
    )


@dataclass(frozen=True, slots=True)
class ProvenanceConsensus:
    """Max-consensus over a total order of plans (max-consensus: Cortes 2008; Nejad et al. 2009).

    Plans of one class (`_verification.plans.PlanClass`, which every receiver determines itself) are ordered first by
    the influence that the proposer had when it proposed. This keeps the paper's idea, but influence belongs to the plan
    and travels with it, and the proposer's id breaks ties. On a connected graph without loss all robots agree within
    its diameter in communication rounds: the highest key spreads and never changes, as with any total `order`. In a
    team that replans, the plan of the later epoch comes first, and within an epoch the one for more robots.
    """

    name: str = "provenance"
    order: Callable[[Plan, Provenance, int], PlanKey] = plan_key

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        """Adopt the plan of highest key, if that is higher than the own key."""
        best: Message | None = None
        best_key = (
            None if own.plan is None or own.provenance is None else self.order(own.plan, own.provenance, own.plan_class)
        )
        for message in heard:
            if message.plan is None or message.provenance is None:
                continue
            key = self.order(message.plan, message.provenance, message.plan_class)
            if best_key is None or key > best_key:
                best, best_key = message, key
        return best
