"""Connectivity recovery: intermediate targets that keep a robot in touch with its team, or find missing robots."""

from __future__ import annotations

import math

from llm_flock.arrays import Point
from llm_flock.metrics import AT_GOAL
from llm_flock.protocol.agreement.agreement import Agreement
from llm_flock.protocol.agreement.path_length import ACROSS, next_stop
from llm_flock.protocol.events import Note
from llm_flock.protocol.membership.all_to_all import AllToAll, given_all_to_all
from llm_flock.protocol.membership.liveness import Liveness
from llm_flock.protocol.membership.rendezvous import NEAR, meeting_places, meeting_point
from llm_flock.protocol.membership.search import MANY, Search, advance
from llm_flock.protocol.plan import Plan


class ConnectivityRecovery:
    """Where one robot flies to stay in touch with its team, or to find robots that it misses.

    Args:
        agreement: the plan, and the claims on its slots.
        liveness: which robots are missing.
        all_to_all: whether a large team waits for its missing robots.
    """

    def __init__(self, agreement: Agreement, liveness: Liveness, all_to_all: AllToAll) -> None:
        self._agreement = agreement
        self._liveness = liveness
        self._all_to_all = all_to_all
        self._search = Search()

    @property
    def given_up(self) -> bool:
        """Whether the search for missing robots has ended without success."""
        return self._search.given_up

    def where_to(self, here: Point, plan: Plan, slot: int) -> tuple[Point | None, list[Note]]:
        """The intermediate target, None if the robot flies straight to its place. Call once a round.

        Args:
            here: own believed position [units; frame of the mission].
            plan: the plan that is followed.
            slot: own place in it.
        """
        live, table, mission = self._liveness, self._agreement.claim.table, self._agreement.mission
        waits, ended = self._wait_for_others(here, plan, slot)
        if waits is not None:
            return waits, ended
        places = self._places_for_now(plan)
        notes = self._look_for_others(here, places, slot)
        target = self._search.target
        lonely = math.dist(here, places.points[slot]) > ACROSS * mission.spacing
        if target is None and not given_all_to_all(table, slot) and (live.strangers or live.silent or lonely):
            target = next_stop(here, places, slot, mission.center, mission.spacing)
        if target is None and places is not plan:
            target = places.points[slot]
        return target, notes

    def _wait_for_others(self, here: Point, plan: Plan, slot: int) -> tuple[Point | None, list[Note]]:
        """The point where a robot of a large team in pieces waits for the others; None if it does not wait."""
        agreement, mission = self._agreement, self._agreement.mission
        if not self._all_to_all.waiting or agreement.placed:
            return None, []
        point = meeting_point(mission, plan, here, self._all_to_all.others)
        if point is None:
            return None, []
        self._all_to_all.wait(there=math.dist(here, point) <= NEAR * mission.spacing)
        searched, self._search = self._search, Search()
        ended = [Note("search", {"begun": False, "vacant": list(searched.known[1])})] if searched.way else []
        return point, ended

    def _places_for_now(self, plan: Plan) -> Plan:
        """The places of the plan, or those on the rendezvous circle of a large team in pieces."""
        live, table = self._liveness, self._agreement.claim.table
        if table is None or self.given_up or len(live.strangers) + len(live.silent) <= MANY:
            return plan
        return meeting_places(self._agreement.mission, plan, table)

    def _look_for_others(self, here: Point, plan: Plan, slot: int) -> list[Note]:
        """Begin, continue or end the search for robots in vacant slots; note the slots that stay empty."""
        agreement = self._agreement
        table, live, mission = agreement.claim.table, self._liveness, agreement.mission
        if table is None:
            return []
        before = self._search
        self._search = advance(
            before,
            position=here,
            plan=plan,
            slot=slot,
            table=table,
            center=mission.center,
            spacing=mission.spacing,
            at_goal=math.dist(here, plan.points[slot]) <= AT_GOAL * mission.spacing,
            strangers=len(live.strangers),
            silent=len(live.silent),
        )
        agreement.count_search(self._search.looked)
        notes = list[Note]()
        if bool(before.way) != bool(self._search.way):
            vacant = list(self._search.known[1])
            notes.append(Note("search", {"begun": bool(self._search.way), "vacant": vacant}))
        if self.given_up and self._search.gaps != before.gaps:
            gone = sorted(live.silent | live.strangers)
            notes.append(Note("gap", {"slots": list(self._search.gaps), "missing": gone}))
        return notes
