"""A robot's knowledge of its whole team: which robots are alive, their positions, and where to look for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from llm_flock.arrays import Point
from llm_flock.bounds import TIME_OUT
from llm_flock.events import Note
from llm_flock.message import BLOCKED, MAX_LOOKS, NO_OWNER, Message, PositionReport, TeamPositions
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import Claim, Occupancy
from llm_flock.protocol._agreement.auction import changed
from llm_flock.protocol._membership.connectivity import ConnectivityRecovery
from llm_flock.protocol._membership.joint import JointAssignment, given_jointly
from llm_flock.protocol._membership.liveness import CANNOT_FLY, NO_PLAN, Liveness
from llm_flock.protocol._membership.occupancy import observe, still_bodies, waiting_place
from llm_flock.protocol._membership.search import Seeking
from llm_flock.protocol._parts import Gaps, Membership, Situation
from llm_flock.protocol._verification.validator import resized

REPLAN_PATIENCE = 2
"""Rounds of a misfit between plan and team after which a robot plans again. It waits one more round for each living
lower id, up to MAX_WAIT, so that one robot proposes and the others hear of it in time."""

MAX_WAIT = 6


class TeamMembership(Membership):
    """Heartbeats, joint assignments, the search for missing robots, and plans for those that are left."""

    def __init__(
        self,
        robot: int,
        mission: Mission,
        *,
        time_out: int = TIME_OUT,  # rounds without a heartbeat after which a robot counts as dead
        gaps: Gaps = "report",  # report slots that no living robot can take, or plan again
        joint: bool = True,  # whether robots report positions and are assigned together
        liars: int = 0,  # number of robots that may lie together
        searches: bool = True,  # whether robots look for others that are missing
    ) -> None:
        n_robots = mission.n_robots
        self.gaps: Gaps = gaps
        self._made_of = robot, mission, time_out, searches
        self.liveness = Liveness(robot, n_robots, time_out)
        self._robot, self._misfit = robot, 0  # rounds for which the plan has not fitted the team
        self._joint = JointAssignment(robot, n_robots, enabled=joint)
        self._seeking = Seeking(robot, liars)
        self._connectivity = ConnectivityRecovery(self.liveness, self._joint, liars, searches)
        self._unplaced: set[int] = set()

    def with_keys(self, liars: int) -> Self:
        """The same for a team with keys, before its first round. Positions are not reported: reports are unsigned."""
        robot, mission, wait, searches = self._made_of
        return type(self)(robot, mission, time_out=wait, gaps=self.gaps, joint=False, liars=liars, searches=searches)

    @property
    def beats(self) -> tuple[int, ...]:
        return self.liveness.beats

    @property
    def lost(self) -> bool:
        return self._seeking.lost

    @property
    def deserted(self) -> bool:
        return self._seeking.sets_out

    @property
    def replans(self) -> bool:
        return self._misfit > 0

    @property
    def missing(self) -> int:
        return len(self.liveness.silent)

    @property
    def known(self) -> object:
        return self._joint.known

    def deliberate(self, *, open_: bool) -> None:
        """Search for no missing robots while the choice what to do about a death is `open_`."""
        self._connectivity.waits = open_

    def begin_mission(self) -> None:
        self._misfit = 0
        self._joint.begin()
        self._seeking.start_again()

    def begin_plan(self) -> None:
        self._misfit = 0

    def begin_round(self, period: int, near: frozenset[int], now: Situation, *, cannot_fly: bool) -> None:
        """Count a heartbeat, find silent robots, and compare the plan with the size of the living team."""
        live, mission = self.liveness, now.mission
        live.begin_round(period, near, (CANNOT_FLY if cannot_fly else 0) | (NO_PLAN if now.plan is None else 0))
        self._joint.begin_round()
        self._unplaced.clear()
        self._seeking.count(near - live.silent, live.silent, live.strangers, mission.n_robots)
        self._seeking.wait_for_neighbours(now, met=bool(near - live.silent) and not self._is_messenger(now, near))
        owners, wanted = {owner for _, _, owner in now.claim.table or ()}, self._wanted(mission)
        replans = self.gaps == "replan" and now.plan is not None and now.claim.table is not None
        blocked = BLOCKED in owners and mission.turn is None  # no other plan avoids a body if it may not turn
        fits = not replans or (len(now.plan or ()) == wanted and not blocked)
        # Robots that were never heard of may be given up once the search for them has ended.
        waits = NO_OWNER in owners and bool(live.strangers) and not self._connectivity.given_up
        legal = fits or resized(mission, wanted) is not None
        self._misfit = 0 if fits or waits or not legal else self._misfit + 1

    def _is_messenger(self, now: Situation, near: frozenset[int]) -> bool:
        """Whether it is to look for the others, as the lowest id of those that miss half of the team for good."""
        live = self.liveness
        few = len(live.silent) + len(live.strangers) >= len(live.present)
        vacant = NO_OWNER in {owner for _, _, owner in now.claim.table or ()}
        first = self._robot == min(live.present) and near <= live.present
        return few and first and (not vacant or self._connectivity.given_up)

    def _wanted(self, mission: Mission) -> int:
        return min(mission.n_places, self.liveness.alive)

    def hear_beats(self, beats: Sequence[NDArray[np.int64]]) -> None:
        self.liveness.hear(beats)

    def hear_positions(self, reports: Mapping[int, PositionReport]) -> None:
        self._joint.hear(reports)

    def hear_claims(self, heard: Sequence[Message], plan: Plan | None) -> None:
        """While robots wait for each other, note which neighbours no joint assignment has placed on this plan."""
        if self._joint.waiting:
            self._unplaced -= {m.sender for m in heard}
            self._unplaced |= {m.sender for m in heard if m.plan != plan or not given_jointly(m.table, m.slot)}

    def report(self, now: Situation, *, greeting: bool) -> dict[int, PositionReport] | None:
        if now.claim.table is None and now.claim.slot is not None:
            return None  # a rule without tables assigns no robots jointly
        return self._joint.report(now.mission, now.plan, now.claim.table, now.position, greeting=greeting)

    def places(self, now: Situation) -> int | None:
        """Number of places to propose now. A robot that sees a body without a heartbeat proposes first."""
        live, wanted = self.liveness, self._wanted(now.mission)
        if now.plan is not None:
            if self._misfit <= REPLAN_PATIENCE:
                return None
            # Living robots propose by ascending id, from 1.
            turn = 0 if self.still(now) else 1 + sum(j < self._robot for j in live.present)
            return wanted if self._misfit > REPLAN_PATIENCE + min(turn, MAX_WAIT) else None
        all_known = self.gaps == "replan" and not live.strangers
        return wanted if all_known and resized(now.mission, wanted) is not None else now.mission.n_places

    def still(self, now: Situation) -> tuple[Point, ...]:
        return still_bodies(now, self.liveness.silent)

    def occupancy(self, now: Situation, *, hears_others: bool, knows_blocked: bool) -> Occupancy:
        return observe(now, self.liveness, hears_others=hears_others, knows_blocked=knows_blocked)

    def positions(self, now: Situation) -> TeamPositions | None:
        assert now.plan is not None, "a robot without a plan claims no slot"
        return self._joint.positions(now.mission, now.plan, now.claim.table, self.liveness.silent)

    def route(self, now: Situation) -> tuple[Point | None, Claim, list[Note]]:
        """The next intermediate target. The claim counts visits to vacant slots at which no robot was met."""
        placed = given_jointly(now.claim.table, now.claim.slot) and not self._unplaced
        target, visited, notes = self._connectivity.route(now, placed=placed)
        return target, with_visits(now.claim, visited), notes

    def seek(self, now: Situation) -> Point | None:
        return self._seeking.target(now.mission, now.position)

    def wait(self, now: Situation) -> Point:
        """A point near the robot that is out of the way of the others, in sight of a blocked slot if there is one."""
        blocked = [a for a, (_, _, owner) in enumerate(now.claim.table or ()) if owner == BLOCKED]
        assert now.plan is not None, "without a plan there are no places to wait for"
        return waiting_place(now.mission, now.position, now.plan, [*now.sensed.values()], blocked)


def with_visits(claim: Claim, slots: Sequence[int]) -> Claim:
    """The claim, with one more visit to these vacant slots in its table."""
    table = claim.table
    if table is None or not slots:
        return claim
    vacant = [a for a in slots if table[a][2] == NO_OWNER]
    visited = {a: (table[a][0], min(table[a][1] + 1.0, MAX_LOOKS), NO_OWNER) for a in vacant}
    return replace(claim, table=changed(table, visited))
