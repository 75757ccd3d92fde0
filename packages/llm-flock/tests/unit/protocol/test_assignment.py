"""Assignment rules, and why the paper's rule gives one place to several robots."""

import pytest

from llm_flock.message import Message, Provenance
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import (
    AssignmentInput,
    AssignmentRule,
    Claim,
    IndexAssignment,
    NearestAssignment,
    NearestFreeAssignment,
)
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.testing import check_assignment_rule

PLAN = Plan.of([[0, 0], [10, 0], [20, 0]])
ORIGIN = Provenance(mission=0, mission_digest="0" * 16, epoch=0, degree=0, proposer=0, sequence=0)


def at(
    robot: int, x: float, *, chosen: int | None = None, adopted: bool = True, heard: tuple[Message, ...] = ()
) -> AssignmentInput:
    return AssignmentInput(
        robot=robot,
        position=(x, 0.0),
        plan=PLAN,
        spacing=10.0,
        chosen=chosen,
        adopted=adopted,
        heard=heard,
        sensed={},
    )


def says(sender: int, slot: int | None) -> Message:
    return Message(sender=sender, sequence=0, degree=0, plan=PLAN, provenance=ORIGIN, slot=slot)


@pytest.mark.parametrize("rule", [IndexAssignment(), NearestAssignment(), NearestFreeAssignment(), AuctionAssignment()])
def test_rules_keep_the_contract(rule: AssignmentRule) -> None:
    check_assignment_rule(rule)


def test_index_is_the_models_own_choice_also_in_an_adopted_plan() -> None:
    assert IndexAssignment().take(at(0, 0.0, chosen=2, adopted=False)).slot == 2
    assert IndexAssignment().take(at(0, 0.0, chosen=2)).slot == 2
    assert IndexAssignment().take(at(1, 0.0)).slot == 1


def test_nearest_takes_the_same_goal_twice() -> None:
    """The literal rule: two robots adopt the same plan, each with a fresh set of goals, and both take goal 1."""
    rule = NearestAssignment()
    assert rule.take(at(0, 9.0)).slot == rule.take(at(1, 11.0)).slot == 1
    assert rule.take(at(0, 9.0, chosen=2, adopted=False)).slot == 2
    claim = Claim(slot=1)
    assert rule.update(claim, at(0, 9.0, heard=(says(1, 1),))) is claim


def test_nearest_free_respects_claims_that_were_heard() -> None:
    rule = NearestFreeAssignment()
    assert rule.take(at(0, 9.0, heard=(says(1, 1),))).slot == 0
    assert rule.take(at(0, 9.0, chosen=2, adopted=False, heard=(says(1, 2),))).slot == 2
    assert rule.update(Claim(slot=1), at(3, 9.0, heard=(says(1, 1),))).slot == 0
    assert rule.update(Claim(slot=1), at(0, 9.0, heard=(says(1, 1),))).slot == 1
    assert rule.update(Claim(slot=1), at(3, 9.0, heard=(says(1, None),))).slot == 1
