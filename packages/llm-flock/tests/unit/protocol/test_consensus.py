"""Plan consensus rules, and where the paper's fails."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import llm_flock
from llm_flock.message import Message, Provenance
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.consensus import (
    ConsensusRule,
    InfluenceConsensus,
    NoConsensus,
    ProvenanceConsensus,
    Standing,
)
from llm_flock.testing import check_consensus_rule

A = Plan.of([[0, 0], [10, 0], [5, 8]])
B = Plan.of([[1, 1], [11, 1], [6, 9]])


def origin(proposer: int, degree: int) -> Provenance:
    return Provenance(mission=0, mission_digest="0" * 16, epoch=0, degree=degree, proposer=proposer, sequence=0)


def says(sender: int, degree: int, plan: Plan | None, provenance: Provenance | None = None) -> Message:
    if plan is not None and provenance is None:
        provenance = origin(sender, degree)
    return Message(sender=sender, sequence=0, degree=degree, plan=plan, provenance=provenance)


def holds(plan: Plan | None, degree: int, proposer: int = 0) -> Standing:
    return Standing(robot=0, plan=plan, provenance=None if plan is None else origin(proposer, degree), degree=degree)


@pytest.mark.parametrize(
    "rule",
    [
        NoConsensus(),
        InfluenceConsensus(),
        InfluenceConsensus(tie="highest"),
        InfluenceConsensus(ties="lowest-id"),
        ProvenanceConsensus(),
    ],
)
def test_rules_keep_the_contract(rule: ConsensusRule) -> None:
    check_consensus_rule(rule)


def test_none_keeps_its_plan() -> None:
    assert NoConsensus().choose(holds(A, 0), [says(1, 2, B)]) is None


def test_influence_adopts_from_the_strictly_more_influential() -> None:
    rule = InfluenceConsensus()
    assert rule.choose(holds(A, 1), [says(1, 2, B)]) == says(1, 2, B)
    assert rule.choose(holds(A, 2), [says(1, 2, B)]) is None
    assert rule.choose(holds(A, 1), [says(1, 2, A)]) is None
    assert rule.choose(holds(A, 0), []) is None


def test_influence_looks_only_at_the_most_influential_neighbour() -> None:
    """k is the arg max over all neighbours; if k follows the same plan, a lesser neighbour's plan is not taken."""
    assert InfluenceConsensus().choose(holds(A, 1), [says(1, 2, B), says(2, 3, A)]) is None
    assert InfluenceConsensus().choose(holds(A, 1), [says(1, 2, B), says(2, 3, None)]) is None


def test_influence_tie_between_neighbours_goes_as_configured() -> None:
    heard = [says(1, 2, B), says(2, 2, A)]
    assert InfluenceConsensus().choose(holds(None, 0), heard) == heard[0]
    assert InfluenceConsensus(tie="highest").choose(holds(None, 0), heard) == heard[1]


def test_a_tie_of_influence_may_go_to_the_lower_id() -> None:
    rule = InfluenceConsensus(ties="lowest-id")
    own = Standing(robot=2, plan=A, provenance=origin(2, 2), degree=2)
    assert rule.choose(own, [says(1, 2, B)]) == says(1, 2, B)
    assert rule.choose(own, [says(3, 2, B)]) is None


def test_influence_never_resolves_a_tie_of_all() -> None:
    """Three robots in range of each other all have I = 2/3: none ever outranks another."""
    plans = [A, B, Plan.of([[2, 2], [12, 2], [7, 10]])]
    for i in range(3):
        heard = [says(j, 2, plans[j]) for j in range(3) if j != i]
        assert InfluenceConsensus().choose(holds(plans[i], 2), heard) is None


def test_provenance_resolves_the_tie_of_all() -> None:
    plans = [A, B, Plan.of([[2, 2], [12, 2], [7, 10]])]
    ends: list[Plan] = []
    for i in range(3):
        heard = [says(j, 2, plans[j]) for j in range(3) if j != i]
        choice = ProvenanceConsensus().choose(holds(plans[i], 2, proposer=i), heard)
        ends.append(plans[i] if choice is None or choice.plan is None else choice.plan)
    assert ends == [plans[2]] * 3


def test_among_equals_the_proposer_decides_and_then_the_digest() -> None:
    """Both ways round, so that the outcome is no accident of the digests."""
    low, high = sorted([A, B], key=lambda plan: plan.digest)
    rule = ProvenanceConsensus()
    for mine, theirs in ((low, high), (high, low)):
        assert rule.choose(holds(mine, 2, proposer=0), [says(1, 2, theirs)]) == says(1, 2, theirs)
        assert rule.choose(holds(mine, 2, proposer=2), [says(1, 2, theirs)]) is None
    assert rule.choose(holds(low, 2, proposer=1), [says(1, 2, high)]) == says(1, 2, high)
    assert rule.choose(holds(high, 2, proposer=1), [says(1, 2, low)]) is None


def test_provenance_is_decided_by_the_proposer_not_the_carrier() -> None:
    """A hub that carries a weak robot's plan does not lend it its own influence."""
    weak_plan_on_hub = says(2, 9, A, origin(proposer=1, degree=1))
    strong_plan_on_loner = says(3, 1, B, origin(proposer=0, degree=5))
    choice = ProvenanceConsensus().choose(holds(None, 0), [weak_plan_on_hub, strong_plan_on_loner])
    assert choice == strong_plan_on_loner


def test_provenance_converges_within_the_diameter_on_a_path() -> None:
    n = 9
    rng = np.random.default_rng(3)
    plans = [Plan.of(rng.uniform(0, 50, (n, 2)).tolist()) for _ in range(n)]
    standing = [Standing(robot=i, plan=plans[i], provenance=origin(i, 1), degree=1) for i in range(n)]
    for _ in range(n - 1):
        spoken = [says(i, s.degree, s.plan, s.provenance) for i, s in enumerate(standing)]
        for i in range(n):
            choice = ProvenanceConsensus().choose(standing[i], [spoken[j] for j in (i - 1, i + 1) if 0 <= j < n])
            if choice is not None:
                standing[i] = Standing(robot=i, plan=choice.plan, provenance=choice.provenance, degree=1)
    assert {s.plan for s in standing} == {plans[n - 1]}


class LowestSpeaker:
    """Follows the robot with the lowest id: its own is among those."""

    name = "lowest-speaker"

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        said = [m for m in heard if m.plan is not None and m.sender < own.robot]
        lowest = min(said, key=lambda m: m.sender, default=None)
        return None if lowest is None or lowest.plan == own.plan else lowest


class AnyLower(LowestSpeaker):
    """Goes to and fro between lower robots."""

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        return next((m for m in heard if m.plan is not None and m.sender < own.robot), None)


def test_a_rule_knows_its_own_robot() -> None:
    check_consensus_rule(LowestSpeaker())
    with pytest.raises(AssertionError, match="adopts again"):
        check_consensus_rule(AnyLower())
    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    result = llm_flock.run(mission, model="geometry", consensus=LowestSpeaker(), start="connected", comm_range=200.0)
    assert result.formed and result.summary.plans_in_use == 1


def test_rule_without_a_name_is_rejected() -> None:
    for nameless in (object(), SimpleNamespace(name=""), SimpleNamespace(name=3)):
        with pytest.raises(AssertionError, match="a rule has a name"):
            check_consensus_rule(cast("Any", nameless))
