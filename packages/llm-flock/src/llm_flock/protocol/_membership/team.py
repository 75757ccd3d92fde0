"""A robot's knowledge of its whole team: who lives, where the others are, and where to look for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from llm_flock.arrays import Point
from llm_flock.bounds import TIME_OUT
from llm_flock.events import Note
from llm_flock.message import BLOCKED, MOST_LOOKS, NO_OWNER, Message, PositionReport, TeamPositions
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import Claim, Occupancy
from llm_flock.protocol._agreement.auction import changed
from llm_flock.protocol._membership.connectivity import ConnectivityRecovery
from llm_flock.protocol._membership.joint import JointAssignment, given_jointly
from llm_flock.protocol._membership.liveness import CANNOT_FLY, NO_PLAN, Liveness
from llm_flock.protocol._membership.occupancy import observe, still_bodies
from llm_flock.protocol._membership.replanning import Replanning
from llm_flock.protocol._membership.seeking import Seeking
from llm_flock.protocol._membership.waiting import waiting_place
from llm_flock.protocol._parts import Gaps, Membership


class TeamMembership(Membership):
    """Heartbeats, joint assignments, the search for missing robots, and plans for those that are left.

    Args:
        robot: own id.
        mission: its limits; no message changes the number of robots.
        time_out: rounds without a heartbeat after which a robot counts as dead.
        gaps: report slots that no living robot can take, or plan again.
        joint: whether robots report positions and are assigned together.
        liars: number of robots that may lie together.
    """

    def __init__(
        self,
        robot: int,
        mission: Mission,
        *,
        time_out: int = TIME_OUT,
        gaps: Gaps = "report",
        joint: bool = True,
        liars: int = 0,
    ) -> None:
        n_robots = mission.n_robots
        self.gaps: Gaps = gaps
        self._made_of = robot, mission, time_out
        self.liveness = Liveness(robot, n_robots, time_out)
        self._joint = JointAssignment(robot, n_robots, enabled=joint)
        self._replanning = Replanning(robot, self.liveness, gaps)
        self._seeking = Seeking(robot, liars)
        self._connectivity = ConnectivityRecovery(self.liveness, self._joint, liars)
        self._unplaced: set[int] = set()

    def with_keys(self, liars: int) -> Self:
        """The same for a team with keys, before its first round. Positions are not reported: reports are unsigned."""
        robot, mission, time_out = self._made_of
        return type(self)(robot, mission, time_out=time_out, gaps=self.gaps, joint=False, liars=liars)

    @property
    def beats(self) -> tuple[int, ...]:
        """The highest heartbeat known of each robot, by id."""
        return self.liveness.beats

    @property
    def lost(self) -> bool:
        """Whether a robot without a place has been out of touch for so long that it should look for the others."""
        return self._seeking.lost

    @property
    def known(self) -> object:
        """The positions known; another object whenever they have changed."""
        return self._joint.known

    def begin_mission(self) -> None:
        """Forget positions, and start to look for others again."""
        self._replanning.reset()
        self._joint.begin()
        self._seeking.start_again()

    def begin_plan(self) -> None:
        """Start to count again for how long the plan does not fit the team."""
        self._replanning.reset()

    def begin_round(
        self,
        period: int,
        near: frozenset[int],
        *,
        mission: Mission,
        plan: Plan | None,
        claim: Claim,
        cannot_fly: bool,
    ) -> None:
        """Count a heartbeat, find silent robots, and compare the plan with those that live."""
        state = (CANNOT_FLY if cannot_fly else 0) | (NO_PLAN if plan is None else 0)
        self.liveness.begin_round(period, near, state)
        self._joint.begin_round()
        self._unplaced.clear()
        silent = self.liveness.silent
        self._seeking.count(near - silent, silent, self.liveness.strangers, mission.n_robots)
        self._replanning.watch(mission, plan, claim.table, may_shrink=self._connectivity.given_up)

    def hear_beats(self, beats: Sequence[NDArray[np.int64]]) -> None:
        """Merge the heartbeats of a communication round's messages, each of shape (N,)."""
        self.liveness.hear(beats)

    def hear_positions(self, reports: Mapping[int, PositionReport]) -> None:
        """Merge the positions that a neighbour knows."""
        self._joint.hear(reports)

    def hear_claims(self, heard: Sequence[Message], plan: Plan | None) -> None:
        """While robots wait for each other, note which neighbours no joint assignment has placed on this plan."""
        if self._joint.waiting:
            self._unplaced -= {m.sender for m in heard}
            self._unplaced |= {m.sender for m in heard if m.plan != plan or not given_jointly(m.table, m.slot)}

    def report(
        self, mission: Mission, plan: Plan | None, claim: Claim, position: Point, *, greeting: bool
    ) -> dict[int, PositionReport] | None:
        """The positions to broadcast; `greeting` is the first broadcast of a round."""
        if claim.table is None and claim.slot is not None:
            return None  # a rule without tables places nobody together
        return self._joint.report(mission, plan, claim.table, position, greeting=greeting)

    def places(self, mission: Mission, plan: Plan | None, *, sees_bodies: bool) -> int | None:
        """Number of places of the plan that the robot is to propose now; None while it need not propose."""
        return self._replanning.places(mission, plan, sees_bodies=sees_bodies)

    def still(self, mission: Mission, sensed: Mapping[int, Point]) -> tuple[Point, ...]:
        """Bodies in sight whose heartbeats have stopped."""
        return still_bodies(mission, sensed, self.liveness.silent)

    def occupancy(
        self,
        mission: Mission,
        plan: Plan,
        position: Point,
        sensed: Mapping[int, Point],
        *,
        hears_others: bool,
        knows_blocked: bool,
    ) -> Occupancy:
        """What sensors and heartbeats say about the slots of a plan."""
        return observe(
            mission, plan, position, sensed, self.liveness, hears_others=hears_others, knows_blocked=knows_blocked
        )

    def positions(self, mission: Mission, plan: Plan, claim: Claim) -> TeamPositions | None:
        """Where the robots are that are to be assigned jointly; None where there is nothing new to assign."""
        return self._joint.positions(mission, plan, claim.table, self.liveness.silent)

    def route(
        self, mission: Mission, plan: Plan, claim: Claim, here: Point, bodies: Sequence[Point]
    ) -> tuple[Point | None, Claim, list[Note]]:
        """The next intermediate target; visits to vacant slots where no robot was met are written in the claim."""
        slot, table = claim.slot, claim.table
        assert slot is not None, "a robot without a place has no way to it"
        placed = given_jointly(table, slot) and not self._unplaced
        target, visited, notes = self._connectivity.route(
            mission, plan, slot, table, here, bodies=bodies, placed=placed
        )
        return target, with_visits(claim, visited), notes

    def seek(self, mission: Mission, here: Point) -> Point | None:
        """Where a robot looks for the others that is lost, or has no plan; None to wait."""
        return self._seeking.target(mission, here)

    def wait(self, mission: Mission, plan: Plan, claim: Claim, here: Point, others: Sequence[Point]) -> Point:
        """A point near the robot that is out of the way of the others, in sight of a blocked slot if there is one."""
        blocked = [a for a, (_, _, owner) in enumerate(claim.table or ()) if owner == BLOCKED]
        return waiting_place(mission, here, plan, others, blocked)


def with_visits(claim: Claim, slots: Sequence[int]) -> Claim:
    """The claim, with a note in its table that these slots were visited and no robot was met there."""
    table = claim.table
    if table is None or not slots:
        return claim
    vacant = [a for a in slots if table[a][2] == NO_OWNER]
    visited = {a: (table[a][0], min(table[a][1] + 1.0, MOST_LOOKS), NO_OWNER) for a in vacant}
    return replace(claim, table=changed(table, visited))
