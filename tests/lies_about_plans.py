"""Lies about plans: what members with valid keys may propose, alone or together. Part of the library in `lies`."""

from __future__ import annotations

from collections.abc import Sequence

from driven_team import turned
from gang import Gang, Said

from llm_flock.message import UNSAID, Provenance
from llm_flock.plan import Plan

PLANS_EACH = 35
"""Communication rounds from one plan to the next."""


def _origin(gang: Gang, member: int, epoch: int = 0, sequence: int = 0) -> Provenance:
    """An origin of a member's own, with the most influence."""
    assert gang.known is not None
    return Provenance(
        mission=gang.known.mission.counter,
        mission_digest=gang.known.mission.digest,
        epoch=epoch,
        degree=gang.mission.n_robots - 1,
        proposer=member,
        sequence=sequence,
    )


def plans_of_its_own(gang: Gang, member: int) -> list[Said]:
    """Faultless plans with the most influence and ever later counts."""
    epoch = gang.rounds // 3
    origin = _origin(gang, member, epoch, min(epoch, 2**20))
    plan = turned(gang.mission, 7 + epoch % 5)[-1]
    return [gang.message(member, plan=plan, provenance=origin, table=(UNSAID,) * len(plan))]


def _plan(gang: Gang, member: int, number: int, epoch: int, hears: Sequence[int] | None = None) -> Said:
    """A faultless plan of a member's own, with all proofs that the honest have."""
    plan, origin = turned(gang.mission, 7 + number % 9)[-1], _origin(gang, member, epoch)
    return gang.message(member, hears=hears, plan=plan, provenance=origin, table=(UNSAID,) * len(plan))


def plan_after_plan(gang: Gang, member: int) -> list[Said]:
    """As many plans as may count: each member shows one, the lowest first, and withdraws it, the highest first."""
    turn, last = gang.rounds // PLANS_EACH, len(gang.members) - 1
    index = min(turn, 2 * last + 1 - turn)
    if index < 0 or member != gang.members[index]:
        return []
    return [_plan(gang, member, 2 * index + (turn > last), 0)]


def plans_for_ever(gang: Gang, member: int) -> list[Said]:
    """Another plan of the first epoch every few rounds."""
    return [_plan(gang, member, gang.rounds // PLANS_EACH, 0)]


def another_plan_to_each_half(gang: Gang, member: int) -> list[Said]:
    half = len(gang.honest) // 2
    return [_plan(gang, member, k, 0, hears) for k, hears in enumerate((gang.honest[:half], gang.honest[half:]))]


def a_plan_in_one_place(gang: Gang, member: int) -> list[Said]:
    assert gang.known is not None
    plan = Plan.of([gang.mission.center] * gang.known.places)
    return [gang.message(member, plan=plan, provenance=_origin(gang, member), table=(UNSAID,) * len(plan))]
