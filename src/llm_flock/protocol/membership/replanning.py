"""When a plan no longer fits the team that is alive: whether it is remade, when, and by whom first."""

from __future__ import annotations

from typing import Literal, TypeAlias

from llm_flock.protocol.membership.liveness import Liveness
from llm_flock.protocol.messages.message import BLOCKED, NO_OWNER, BidTable
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.verification.validator import Validator

Gaps: TypeAlias = Literal["report", "replan"]

REMAKE_PATIENCE = 2
"""Rounds for which a plan must not fit the team before it is remade; as many more for each lower id that is alive, up
to MOST_WAIT, so that one robot proposes and the others hear of it in time."""

MOST_WAIT = 6


class Replanning:
    """One robot's count of the rounds for which the plan has not fitted the team, and what follows from it.

    Args:
        robot: own id, 0 .. N-1.
        validator: knows the mission in force, and for which team sizes its shape exists.
        liveness: who is alive.
        gaps: what to do about places that nobody is alive to take: report them, or have the plan remade.
    """

    def __init__(self, robot: int, validator: Validator, liveness: Liveness, gaps: Gaps) -> None:
        self._robot = robot
        self._validator = validator
        self._liveness = liveness
        self._gaps = gaps
        self._misfit = 0

    def reset(self) -> None:
        """Another plan or mission: the count begins anew."""
        self._misfit = 0

    def watch(self, plan: Plan | None, table: BidTable | None, *, may_shrink: bool) -> None:
        """Once a round: does the plan fit the team that is alive?

        Args:
            plan: the plan that is followed.
            table: the claims on its places.
            may_shrink: whether robots that were never heard of may be given up.
        """
        owners = {owner for _, _, owner in table or ()}
        replans = self._gaps == "replan" and plan is not None and table is not None
        fits = not replans or (len(plan or ()) == self._wanted and BLOCKED not in owners)
        waits = NO_OWNER in owners and bool(self._liveness.strangers) and not may_shrink
        legal = fits or self._validator.fitting(self._wanted) is not None
        self._misfit = 0 if fits or waits or not legal else self._misfit + 1

    def places(self, plan: Plan | None, *, sees_bodies: bool) -> int | None:
        """How many places the plan should have that this robot is to propose now; None while it need not.

        Args:
            plan: the plan that is followed.
            sees_bodies: whether a body without a mind is in sight.
        """
        if plan is not None:
            turn = 0 if sees_bodies else self._rank
            return self._wanted if self._misfit > REMAKE_PATIENCE + min(turn, MOST_WAIT) else None
        known = self._gaps == "replan" and not self._liveness.strangers
        return self._wanted if known and self._validator.fitting(self._wanted) is not None else self._n_places

    @property
    def _n_places(self) -> int:
        return self._validator.mission.n_places

    @property
    def _wanted(self) -> int:
        return min(self._n_places, self._liveness.alive)

    @property
    def _rank(self) -> int:
        """Whose turn it is to propose, after who sees a body in the way: who is alive and has the lowest id."""
        gone = self._liveness.silent | self._liveness.strangers
        return 1 + self._robot - sum(j < self._robot for j in gone)
