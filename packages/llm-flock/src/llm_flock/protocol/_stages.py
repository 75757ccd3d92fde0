"""When a team goes on to the next stage of its mission: each robot decides by its own view, and the first one leads.

A robot that has stood at its place writes the highest bid of all into its slot of the bid table, which merging carries
to the others. A robot whose table shows that for all robots that are not silent sees a formed team. It goes on as if an
operator had ordered the next stage, with the time that follows that of the last order; the others hear of it from
there. Robots that go on at the same moment give the same order, and any of them may die.
"""

from __future__ import annotations

import math

from msgspec.structs import replace

from llm_flock.errors import InputError
from llm_flock.message import BLOCKED, MAX_BID, NO_OWNER
from llm_flock.metrics import AT_GOAL, HELD_ROUNDS
from llm_flock.mission import Mission
from llm_flock.protocol._agreement.agreement import Agreement
from llm_flock.protocol._agreement.auction import changed
from llm_flock.protocol._parts import Membership


class Stages:
    """One robot's view of whether its team has formed. Call `next` once a round, after it has sensed."""

    def __init__(self, agreement: Agreement, membership: Membership, noise_bound: float) -> None:
        self._agreement, self._membership, self._noise = agreement, membership, noise_bound
        self._there = self._formed = 0  # rounds at the own place; rounds for which the team has stood formed

    def next(self, round_: int) -> Mission | None:
        """The stage to go on to at the start of a round, if the mission has one; None to stay."""
        mission = self._agreement.mission
        self._look()
        when = mission.then[0].when
        due = round_ >= when if isinstance(when, int) else when == "formed" and self._formed > mission.hold
        if not due:
            return None
        self._there = self._formed = 0
        try:
            return mission.following(round_ - 1)
        except InputError:  # where a formation has travelled to, there may be no room for the next one
            return None

    def _look(self) -> None:
        """Tell the others that this robot stands at its place, and look for who else does."""
        now = self._agreement
        slot, table = now.claim.slot, now.claim.table
        if now.plan is None or table is None:
            self._there = self._formed = 0
            return
        if slot is not None:
            off = math.dist(now.position, now.plan.points[slot]) - self._noise
            self._there = self._there + 1 if off <= AT_GOAL * now.mission.spacing else 0
            if self._there >= HELD_ROUNDS and table[slot][1] < MAX_BID:
                table = changed(table, {slot: (table[slot][0], MAX_BID, table[slot][2])})
                now.claim = replace(now.claim, table=table)
        owners = [bid for _, bid, owner in table if owner not in (NO_OWNER, BLOCKED)]
        usable = sum(owner != BLOCKED for _, _, owner in table)
        team = now.mission.n_robots - self._membership.missing
        whole = len(owners) == min(usable, team) and not self._membership.replans
        formed = whole and all(bid >= MAX_BID for bid in owners)
        self._formed = self._formed + 1 if formed else 0
