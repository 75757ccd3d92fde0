"""A plan that no longer fits the team that is alive: whether to plan again, when, and which robot proposes first."""

from __future__ import annotations

from llm_flock.message import BLOCKED, NO_OWNER, BidTable
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._membership.liveness import Liveness
from llm_flock.protocol._parts import Gaps
from llm_flock.protocol._verification.validator import resized

REPLAN_PATIENCE = 2
"""Rounds for which a plan must not fit the team before a robot plans again. Robots with higher ids wait one more round
for each lower id that is alive, up to MOST_WAIT, so that one robot proposes and the others hear of it in time."""

MOST_WAIT = 6


class Replanning:
    """Counts the rounds for which the plan has not fitted the team."""

    def __init__(self, robot: int, liveness: Liveness, gaps: Gaps) -> None:
        self._robot, self._liveness, self._gaps = robot, liveness, gaps
        self._misfit = 0

    def reset(self) -> None:
        """Start counting again. Call with every new plan or mission."""
        self._misfit = 0

    def watch(self, mission: Mission, plan: Plan | None, table: BidTable | None, *, may_shrink: bool) -> None:
        """Compare the plan with the living team. Call once a round.

        `may_shrink` says whether robots that were never heard of may be given up.
        """
        owners = {owner for _, _, owner in table or ()}
        replans = self._gaps == "replan" and plan is not None and table is not None
        wanted = self._wanted(mission)
        fits = not replans or (len(plan or ()) == wanted and BLOCKED not in owners)
        waits = NO_OWNER in owners and bool(self._liveness.strangers) and not may_shrink
        legal = fits or resized(mission, wanted) is not None
        self._misfit = 0 if fits or waits or not legal else self._misfit + 1

    def places(self, mission: Mission, plan: Plan | None, *, sees_bodies: bool) -> int | None:
        """Number of places of the plan that this robot is to propose now; None while it need not propose.

        A robot that sees a body without a heartbeat proposes first.
        """
        if plan is not None:
            # Living robots propose by ascending id, from 1.
            gone = self._liveness.silent | self._liveness.strangers
            turn = 0 if sees_bodies else 1 + self._robot - sum(j < self._robot for j in gone)
            return self._wanted(mission) if self._misfit > REPLAN_PATIENCE + min(turn, MOST_WAIT) else None
        known = self._gaps == "replan" and not self._liveness.strangers
        wanted = self._wanted(mission)
        return wanted if known and resized(mission, wanted) is not None else mission.n_places

    def _wanted(self, mission: Mission) -> int:
        return min(mission.n_places, self._liveness.alive)
