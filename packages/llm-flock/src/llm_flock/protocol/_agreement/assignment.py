"""Assignment rules choose the slot of the plan to claim, from the own claim and the messages just heard."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import msgspec

from llm_flock.algorithm1 import nearest_available
from llm_flock.arrays import Point
from llm_flock.bounds import MAX_ROBOTS
from llm_flock.message import NO_MISSION, BidEntry, BidTable, Message, MissionStamp, Offer, Provenance, TeamPositions
from llm_flock.mission import Mission
from llm_flock.plan import Plan

if TYPE_CHECKING:
    from llm_flock.roadmap import Roadmap  # only missions with obstacles need it


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's slot in its present plan."""

    slot: int | None  #: Index of the place, None while the robot has none.
    table: BidTable | None = None  #: Bid table, all claims as far as known (auction only).
    #: The robot's bid for every slot, fixed when it adopted the plan (auction only).
    bids: tuple[float, ...] | None = None
    offer: Offer | None = None  #: The exchange of slots that this robot has offered and is bound to (auction only).
    bound: int = 0  #: Communication rounds for which it stays bound to its offer.


NONE = frozenset[int]()
NO_WEIGHTS: Mapping[int, float] = {}


class Occupancy(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's knowledge of the slots of a plan, from sensors and heartbeats."""

    silent: frozenset[int] = NONE  #: Robots whose heartbeats have stopped; their slots are free.
    blocked: frozenset[int] = NONE  #: Slots that no robot can take, because a body that does not move stands there.
    clear: frozenset[int] = NONE  #: Slots that certainly have no such body.
    alive: int = MAX_ROBOTS  #: Number of robots that were heard of and are not silent, with this one.


class AssignmentInput(msgspec.Struct, frozen=True, kw_only=True):
    """All knowledge on which a robot claims a slot of its plan."""

    robot: int
    position: Point  #: Own believed position [units; frame of the mission].
    plan: Plan
    spacing: float  #: Wanted distance between neighbouring robots [units].
    chosen: int | None  #: The slot that the robot's own model named; None if it gave no plan.
    adopted: bool  #: Whether the plan is another robot's.
    heard: Sequence[Message]  #: The newest message of each robot on the same plan, in ascending order of ids.
    #: Believed positions of the robots within sensing range, by id [units; frame of the mission].
    sensed: Mapping[int, Point]
    mission: MissionStamp = NO_MISSION
    origin: Provenance | None = None  #: Where the plan comes from; None without provenance.
    roadmap: Roadmap | None = None  #: The ways round obstacles, for lengths; None if straight lines count.
    occupancy: Occupancy | None = None  #: What is known of the slots; given once a round, else None.
    #: Positions of the robots to assign jointly; None if they are unknown or not new.
    positions: TeamPositions | None = None
    granted: BidTable | None = None  #: Entries that enough robots have signed; None in a team without keys.
    #: Precedence of a slot: of several own slots the robot keeps the highest; None without keys.
    precedence: Callable[[int, BidEntry], tuple[int, int]] | None = None
    #: The robot's bid for a slot of a version above 0; None without keys, where it is that of version 0.
    draw: Callable[[int, int], float] | None = None
    #: Whether this version of a slot was freed by witnesses that the robot can name; None without keys.
    freed: Callable[[int, int], bool] | None = None
    exchanges: bool = True  #: Whether the robot may exchange slots.
    weights: Mapping[int, float] = NO_WEIGHTS  #: Of robots whose squared ways count for more in exchanges.
    retired: bool = False  #: Whether the robot has given its slot to another for good, and claims none.
    straight: bool = False  #: Whether exchanges weigh straight distances, not ways along the formation.
    preferences: Mission | None = None  #: The mission, if it has preferences.


class AssignmentRule(Protocol):
    """Chooses a robot's own slot.

    A rule is a pure function of its arguments.
    `llm_flock.testing.check_assignment_rule` tests a new rule.
    """

    @property
    def name(self) -> str:
        """Name on the command line and in records."""
        ...

    def take(self, now: AssignmentInput) -> Claim:
        """First claim on a plan that was just proposed or adopted."""
        ...

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """The claim after a communication round on the same plan."""
        ...


def _nearest_unclaimed(now: AssignmentInput) -> Claim:
    """The nearest place that no neighbour on the same plan claims."""
    taken = {m.slot for m in now.heard if m.slot is not None}
    return Claim(slot=nearest_available(now.position, now.plan.points, taken))


def _own_choice(now: AssignmentInput) -> int:
    """The model's own index; the robot's id if the model named none."""
    return now.robot if now.chosen is None else now.chosen


@dataclass(frozen=True, slots=True)
class IndexAssignment:
    """The model's own choice (paper, line 119), even if others claim the same; the baseline's rule."""

    name: str = "index"

    def take(self, now: AssignmentInput) -> Claim:
        """The index that this robot's model named with its own plan, also in a plan adopted from another."""
        return Claim(slot=_own_choice(now))

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """Unchanged."""
        return claim


@dataclass(frozen=True, slots=True)
class NearestAssignment:
    """The paper's pseudocode, literally (lines 154-156).

    On adoption the set of available goals is reset to the whole plan, the nearest is taken, and the set is not used
    again. No other robot learns of it, so two robots may take the same goal. A robot's own plan keeps the index that
    its model named.
    """

    name: str = "nearest"

    def take(self, now: AssignmentInput) -> Claim:
        """The model's index on its own plan; the nearest of all points on an adopted one."""
        return Claim(slot=nearest_available(now.position, now.plan.points) if now.adopted else _own_choice(now))

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """Unchanged: equal plans never trigger a new assignment."""
        return claim


@dataclass(frozen=True, slots=True)
class NearestFreeAssignment:
    """The paper's text (line 135): claims are broadcast, and a goal claimed by a neighbour on the same plan is taken.

    Two robots may still claim one goal in the same communication round, or meet later; then the higher id yields to the
    lower and takes the nearest goal that no neighbour claims. A robot knows its neighbours' claims only, so distinct
    goals in the whole team are not assured.
    """

    name: str = "nearest-free"

    def take(self, now: AssignmentInput) -> Claim:
        """The model's index on its own plan; the nearest unclaimed point on an adopted one."""
        if not now.adopted:
            return Claim(slot=_own_choice(now))
        return _nearest_unclaimed(now)

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """Yield to a neighbour of lower id on the same goal."""
        if not any(m.slot == claim.slot and m.sender < now.robot for m in now.heard):
            return claim
        return _nearest_unclaimed(now)
