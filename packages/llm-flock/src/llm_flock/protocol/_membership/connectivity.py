"""Connectivity recovery: intermediate targets that keep a robot in touch with its team, or find missing robots."""

from __future__ import annotations

import math
import operator

from llm_flock.arrays import Point
from llm_flock.events import Note
from llm_flock.message import NO_OWNER, BidTable
from llm_flock.metrics import AT_GOAL
from llm_flock.plan import Plan
from llm_flock.protocol._membership.joint import JointAssignment, given_jointly
from llm_flock.protocol._membership.liveness import Liveness
from llm_flock.protocol._membership.rendezvous import NEAR, Gathering, meeting_places, meeting_point
from llm_flock.protocol._membership.search import MANY, Search, advance
from llm_flock.protocol._parts import Situation
from llm_flock.protocol._path_length import ACROSS, next_stop

REMEMBERED = 30  # rounds for which a body out of sight is assumed to stand at its place
APART = 3  # rounds beyond the time-out after which living robots count as missing if they own none of the vacant places


class ConnectivityRecovery:
    """Keeps a robot in touch with its team. Up to `liars` living robots may want no place."""

    def __init__(self, liveness: Liveness, joint: JointAssignment, liars: int = 0, searches: bool = True) -> None:
        self._liveness, self._joint, self._search = liveness, joint, Search()
        self._liars, self._apart_for, self._searches = liars, 0, searches
        self._gathering = Gathering()
        self.waits = False  # until the team has chosen what to do about a death, it does not search
        self._standing: tuple[str, dict[int, int]] = "", {}

    @property
    def given_up(self) -> bool:
        """Whether the search for missing robots has ended without success."""
        return self._search.given_up

    def route(self, now: Situation, *, placed: bool) -> tuple[Point | None, tuple[int, ...], list[Note]]:
        """The next target (None: fly straight), slots just visited in vain, and notes. Call once a round.

        `placed` says whether a joint assignment gave slots to this robot and all others heard in this round.
        """
        mission, plan, slot, table, here = now.mission, now.plan, now.claim.slot, now.claim.table, now.position
        assert plan is not None and slot is not None, "a robot without a place has no way to it"
        live, waiting = self._liveness, self._joint.waiting and not placed
        point = meeting_point(mission, plan, here, self._joint.others) if waiting else None
        if point is not None:
            self._joint.wait(there=math.dist(here, point) <= NEAR * mission.spacing)
            searched, self._search = self._search, Search()
            return point, (), [_search_note(searched, begun=False)] if searched.way else []
        places = plan
        if table is not None and not self.given_up and len(live.strangers) + len(live.silent) > MANY:
            places = meeting_places(mission, plan, table)
        if table is not None and places is plan and not self.given_up:
            strangers, alone = len(live.strangers), not now.sensed
            point = self._gathering.target(mission, plan, slot, here, strangers=strangers, alone=alone)
            if point is not None:
                return point, (), []
        notes = (
            [] if table is None or self.waits or not self._searches else self._look_for_others(now, places, slot, table)
        )
        target = self._search.target
        lonely = math.dist(here, places.points[slot]) > ACROSS * mission.spacing
        if target is None and not given_jointly(table, slot) and (live.strangers or live.silent or lonely):
            target = next_stop(here, places, slot, mission.center, mission.spacing, now.ways)
        if target is None and places is not plan:
            target = places.points[slot]
        return target, self._search.looked, notes

    def _standing_at(self, now: Situation, places: Plan, table: BidTable) -> set[int]:
        """Slots without owner on which a body stands, or stood when last in sight: no search begins for these."""
        near, owners = AT_GOAL * now.mission.spacing, {owner for _, _, owner in table}
        bodies = [x for j, x in now.sensed.items() if j not in owners]  # others that search are no news
        free = [a for a, entry in enumerate(table) if entry[2] == NO_OWNER]
        known = self._standing[1] if self._standing[0] == places.digest else {}
        reach = near + max((math.dist(now.position, x) for x in bodies), default=0.0) + 1e-6
        close = [a for a in free if math.dist(places.points[a], now.position) <= reach]
        seen = {a: 0 for a in close if any(math.dist(places.points[a], x) <= near for x in bodies)}
        hidden = {
            a: since + 1
            for a, since in known.items()
            if since < REMEMBERED and math.dist(places.points[a], now.position) > now.mission.sensing
        }
        self._standing = places.digest, {a: since for a, since in (hidden | seen).items() if a in free}
        return {*self._standing[1]}

    def _apart(self, slot: int, table: BidTable) -> frozenset[int]:
        """Robots known by heartbeats only, that own no place although some are vacant. Call once a round."""
        owners = set(map(operator.itemgetter(2), table))
        without = self._liveness.present - owners - {table[slot][2]}
        missed = NO_OWNER in owners and len(without) > self._liars
        self._apart_for = self._apart_for + 1 if missed else 0
        return without if self._apart_for > self._liveness.time_out + APART else frozenset()

    def _look_for_others(self, now: Situation, places: Plan, slot: int, table: BidTable) -> list[Note]:
        """Begin, continue or end the search for robots in vacant slots."""
        live, before, apart = self._liveness, self._search, self._apart(slot, table)
        missed = live.strangers or live.silent or apart
        self._search = search = advance(
            before,
            now,
            places,
            strangers=len(live.strangers),
            silent=len(live.silent - live.without_plan),
            without_plan=len(live.silent & live.without_plan) + len(apart),
            standing=self._standing_at(now, places, table) if missed else (),
        )
        notes = list[Note]()
        if bool(before.way) != bool(search.way):
            notes.append(_search_note(search, begun=bool(search.way)))
        if self.given_up and search.gaps != before.gaps:
            missing = sorted(live.silent | live.strangers | apart)
            notes.append(Note("gap", {"slots": list(search.gaps), "missing": missing}))
        return notes


def _search_note(search: Search, *, begun: bool) -> Note:
    return Note("search", {"begun": begun, "vacant": list(search.known[1])})
