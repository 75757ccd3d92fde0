"""Goal assignment rules, and why the paper's gives several robots one goal."""

import pytest

from llm_flock.protocol.assignment import (
    AssignmentRule,
    AuctionAssignment,
    Claim,
    IndexAssignment,
    NearestAssignment,
    NearestFreeAssignment,
    Start,
    merge,
    nearest,
)
from llm_flock.protocol.messages import Message, Pedigree, Table
from llm_flock.protocol.plan import Plan
from llm_flock.testing import check_assignment_rule

PLAN = Plan.of([[0, 0], [10, 0], [20, 0]])
ORIGIN = Pedigree(mission=0, mission_digest="0" * 16, epoch=0, neighbors=0, proposer=0, sequence=0)


def start(robot: int, x: float, *, chosen: int | None = None, adopted: bool = True, heard: tuple[Message, ...] = ()):
    return Start(robot=robot, position=(x, 0.0), plan=PLAN, chosen=chosen, adopted=adopted, heard=heard)


def says(sender: int, slot: int | None, table: Table | None = None) -> Message:
    return Message(sender=sender, sequence=0, neighbors=0, plan=PLAN, pedigree=ORIGIN, slot=slot, table=table)


@pytest.mark.parametrize("rule", [IndexAssignment(), NearestAssignment(), NearestFreeAssignment(), AuctionAssignment()])
def test_rules_keep_the_contract(rule: AssignmentRule) -> None:
    check_assignment_rule(rule)


def test_index_is_the_models_own_choice_also_in_an_adopted_plan() -> None:
    assert IndexAssignment().take(start(0, 0.0, chosen=2, adopted=False)).slot == 2
    assert IndexAssignment().take(start(0, 0.0, chosen=2)).slot == 2
    assert IndexAssignment().take(start(1, 0.0)).slot == 1


def test_nearest_takes_the_same_goal_twice() -> None:
    """The literal rule: two robots adopt the same plan, each with a fresh set of goals, and both take goal 1."""
    rule = NearestAssignment()
    assert rule.take(start(0, 9.0)).slot == rule.take(start(1, 11.0)).slot == 1
    assert rule.take(start(0, 9.0, chosen=2, adopted=False)).slot == 2
    claim = Claim(slot=1)
    assert rule.update(0, (9.0, 0.0), PLAN, claim, [says(1, 1)]) is claim


def test_nearest_free_respects_claims_that_were_heard() -> None:
    rule = NearestFreeAssignment()
    assert rule.take(start(0, 9.0, heard=(says(1, 1),))).slot == 0
    assert rule.take(start(0, 9.0, chosen=2, adopted=False, heard=(says(1, 2),))).slot == 2
    assert rule.update(3, (9.0, 0.0), PLAN, Claim(slot=1), [says(1, 1)]).slot == 0
    assert rule.update(0, (9.0, 0.0), PLAN, Claim(slot=1), [says(1, 1)]).slot == 1
    assert rule.update(3, (9.0, 0.0), PLAN, Claim(slot=1), [says(1, None)]).slot == 1


def test_nearest_falls_back_to_the_closest_when_all_are_taken() -> None:
    assert nearest((9.0, 0.0), PLAN, frozenset({0, 1, 2})) == 1
    assert nearest((5.0, 0.0), PLAN) == 0


def test_merge_is_a_join() -> None:
    a: Table = ((0, -1.0, 0), (0, 0.0, -1), (2, -9.0, 1))
    b: Table = ((0, -1.0, 1), (0, -5.0, 2), (1, -1.0, 0))
    c: Table = ((1, 0.0, -1), (0, -4.0, 3), (2, -9.0, 0))
    assert merge(a, b) == merge(b, a) == ((0, -1.0, 0), (0, -5.0, 2), (2, -9.0, 1))
    assert merge(merge(a, b), c) == merge(a, merge(b, c))
    assert merge(a, a) is a


def test_auction_outbid_robot_takes_the_best_slot_still_winnable() -> None:
    rule = AuctionAssignment()
    near, far = rule.take(start(0, 10.5)), rule.take(start(1, 12.0))
    assert near.slot == far.slot == 1
    far = rule.update(1, (12.0, 0.0), PLAN, far, [says(0, near.slot, near.table)])
    near = rule.update(0, (10.5, 0.0), PLAN, near, [says(1, far.slot, far.table)])
    assert (near.slot, far.slot) == (1, 2)


def test_auction_ignores_messages_without_a_table() -> None:
    rule = AuctionAssignment()
    claim = rule.take(start(0, 10.0))
    assert rule.update(0, (10.0, 0.0), PLAN, claim, [says(1, 1)]) is claim


def test_auction_releases_all_but_one_slot_with_a_raised_version() -> None:
    """A robot that finds itself on two slots, from an earlier life on this plan, keeps the better one."""
    rule = AuctionAssignment()
    claim = rule.take(start(0, 0.0))
    old: Table = ((0, -50.0, 2), (0, -0.5, 0), (0, 0.0, -1))
    after = rule.update(0, (0.0, 0.0), PLAN, claim, [says(1, None, old)])
    assert after.slot == 0
    assert after.table == ((0, 0.0, 0), (1, 0.0, -1), (0, 0.0, -1))


def test_auction_without_a_winnable_slot_has_no_goal() -> None:
    rule = AuctionAssignment()
    won: Table = ((0, 0.0, 1), (0, 0.0, 2), (0, 0.0, 3))
    claim = rule.take(start(5, 100.0, heard=(says(1, 0, won),)))
    assert claim.slot is None
    freed: Table = ((0, 0.0, 1), (0, 0.0, 2), (1, 0.0, -1))
    assert rule.update(5, (100.0, 0.0), PLAN, claim, [says(1, 0, freed)]).slot == 2
