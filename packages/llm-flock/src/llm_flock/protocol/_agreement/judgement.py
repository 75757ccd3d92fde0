"""One robot's part in the team's judgements: it notices incidents, asks its model once about each, and acts.

Without a choice the team does what it is configured to do. No choice touches the shield.
"""

from __future__ import annotations

import math
import re
from typing import Literal

from llm_flock.arrays import Point
from llm_flock.events import AskJudgement, Note
from llm_flock.message import NO_OWNER, BidEntry, Incident, Vote
from llm_flock.metrics import AT_GOAL
from llm_flock.obstacles import Obstacle
from llm_flock.planner import JudgementAnswer, JudgementQuestion, NoAnswer
from llm_flock.printable import one_line
from llm_flock.protocol._agreement.agreement import Agreement
from llm_flock.protocol._agreement.assignment import Claim
from llm_flock.protocol._agreement.auction import changed
from llm_flock.protocol._agreement.options import (
    battery_options,
    blocked_options,
    closing,
    death_options,
    order_options,
    resting_at,
    way_past,
)
from llm_flock.protocol._agreement.votes import Key, Votes, key_of
from llm_flock.protocol._breaker import fallback_notes
from llm_flock.protocol._membership.team import TeamMembership

PATIENCE = 4  # rounds from when a robot knows of an incident, for which it waits for the votes of all that are alive
STUCK = 3  # rounds for which a robot comes no nearer to its place, before it looks for an obstacle in its way
WEIGHT = 100.0  # of a weak robot's squared way in exchanges, where it is to give its place to a neighbour


class Judgement:
    """Call `begin_round` in each round, after heartbeats are counted, and `take` with the answer to its question."""

    def __init__(self, robot: int, agreement: Agreement, membership: TeamMembership) -> None:
        self._robot, self._agreement, self._membership = robot, agreement, membership
        self._usual = membership.gaps
        self._left: float | None = None  # how far the own weak battery lasts [units]
        self._here: Point = ()
        self._resting: tuple[Obstacle, ...] = ()
        self._nearest: tuple[Point, float, int] = (), 0.0, 0  # the own place, the least distance from it, since when
        self.begin_mission()

    def begin_mission(self) -> None:
        """Forget what was judged: another mission, another situation. A battery that is weak stays so."""
        self.votes = Votes()
        self._asking: Incident | None = None
        self._orders = list[Incident]()  # that have come to this robot
        self._obeyed: str | None = None  # what the team does about the last order
        self._known: dict[Key, tuple[Incident, int]] = {}  # and the round since when
        self._asked, self._closed, self._holders = set[Key](), set[Key](), set[int]()

    def weaken(self, left: float) -> None:
        """The own body can fly only this far from now on [units]: ways before this moment do not count."""
        self._left, self._here = left, ()

    def order(self, words: str, number: int) -> None:
        """The operator has given an order about the first robot that it names by number, or else about this one."""
        n = self._agreement.mission.n_robots
        about = next((int(x) for x in re.findall("[0-9]+", words) if int(x) < n), self._robot)
        self._orders.append(Incident(kind="order", robot=about, left=number, words=words))

    @property
    def waits(self) -> Literal["battery", "blocked", "order"] | None:
        """What this robot holds its place for: a choice about its weak battery, an obstacle or an order, as chosen."""
        if ("battery", self._robot) in self._known.keys() - self._closed:
            return "battery"
        if self._obeyed == "wait":
            return "order"
        if (key := ("blocked", self._robot)) not in self._closed:
            return None
        incident, _ = self._known[key]
        there = any(math.dist(one.center or (), incident.at) < incident.left for one in self._resting)
        return "blocked" if there and self.votes.choice(incident) == "wait" else None

    def begin_round(
        self, number: int, position: Point, resting: tuple[Obstacle, ...] = ()
    ) -> list[AskJudgement | Note]:
        """Notes, and last the question of this round, if there is one; `position` is the own one [world frame].

        Obstacles in sight that are `resting` may be in its way.
        """
        if self._left is not None and self._here:
            self._left = max(0.0, self._left - math.dist(position, self._here))
        self._here = position
        self._resting = resting
        seen = (*self._noticed(), *self._blocked(number), *self._orders)
        for incident in (*self.votes.incidents.values(), *seen):
            self._known.setdefault(key_of(incident), (incident, number))
        notes = list[AskJudgement | Note]()
        for key, (incident, since) in self._known.items():
            complete = key in self._asked and self._membership.liveness.present <= self.votes.voters(incident)
            if key not in self._closed and (complete or number - since >= PATIENCE):
                self._closed.add(key)
                notes += self._close(incident)
        self._follow()
        due = [one for key, (one, _) in self._known.items() if key not in self._asked and self._can_judge(one)]
        return notes + (self._ask(due[0], number) if due else [])

    def take(self, answer: JudgementAnswer | NoAnswer) -> list[Note]:
        """Cast the own vote: the model's answer, or none where that cannot be used."""
        incident, self._asking = self._asking, None
        if incident is None:
            return [Note("stale_answer", {"about": "judgement"})]
        choice = answer.choice if isinstance(answer, JudgementAnswer) else None
        self.votes.take(Vote(incident=incident, voter=self._robot, degree=self._agreement.degree, choice=choice))
        if not isinstance(answer, JudgementAnswer):
            return fallback_notes("judgement", "rule", answer)
        return [_note("judged", incident, choice=choice, reason=answer.reason)]

    def _noticed(self) -> list[Incident]:
        """The deaths that have left a place empty, and the own weak battery."""
        agreement, table = self._agreement, self._agreement.claim.table
        if agreement.plan is None or table is None:
            return []
        owners = {owner for _, _, owner in table}
        dead = self._membership.liveness.silent & self._holders - owners if min(owners) < 0 else ()
        self._holders |= owners
        found = [Incident(kind="death", robot=robot) for robot in sorted(dead)]
        if self._left is not None and agreement.claim.slot is not None:
            found.append(Incident(kind="battery", robot=self._robot, left=self._left, at=agreement.position))
        return found

    def _blocked(self, number: int) -> list[Incident]:
        """An obstacle on the way to the own place, if the robot has come no nearer to it for some rounds."""
        agreement, mission = self._agreement, self._agreement.mission
        if agreement.plan is None or agreement.claim.slot is None or mission.velocity is not None:
            return []
        here, place = agreement.position, agreement.plan.points[agreement.claim.slot]
        (before, least, since), left, near = self._nearest, math.dist(here, place), AT_GOAL * mission.spacing
        if place != before or left < least - near:
            self._nearest = place, left, number
        elif left > near and number - since >= STUCK:
            known = way_past((), here, place, agreement)
            for one in self._resting:
                if one not in agreement.resting and way_past((one,), here, place, agreement) > known + near:
                    return [Incident(kind="blocked", robot=self._robot, left=one.radius or 0.0, at=one.center or ())]
        return []

    def _can_judge(self, incident: Incident) -> bool:
        """Whether this robot has a plan, and in case of a death has noticed it itself."""
        noticed = incident.kind != "death" or incident.robot in self._membership.liveness.silent
        return noticed and self._agreement.plan is not None and self._agreement.claim.table is not None

    def _ask(self, incident: Incident, number: int) -> list[AskJudgement | Note]:
        """Ask the model about an incident. Where code sees no choice, there is an empty vote."""
        agreement = self._agreement
        self._asked.add(key_of(incident))
        if incident.kind == "battery":
            event = f"The battery of robot {incident.robot} is weak: it can fly {incident.left:.1f} units at most."
            options = battery_options(incident, agreement, self._robot, self._membership.liveness.present)
        elif incident.kind == "blocked":
            event = f"An obstacle has come to rest in the way of robot {incident.robot} to its place."
            options = blocked_options(incident, agreement, self._robot, self._membership.liveness.present)
        elif incident.kind == "order":
            event = "The operator has given the team an order in words. It says what counts."
            options = order_options(incident, agreement, self._robot, self._membership.liveness.present)
        else:
            event = f"Robot {incident.robot} has failed, and nobody fills its place."
            options = death_options(agreement, first="replan" if self._usual == "replan" else "leave")
        noticed = _note("incident", incident, options=[option.choice for option in options])
        if len(options) < 2:
            self.votes.take(Vote(incident=incident, voter=self._robot, degree=agreement.degree, choice=None))
            return [noticed]
        self._asking, mission = incident, agreement.mission.at(number)
        who, words = self._robot, one_line(incident.words)
        asked = JudgementQuestion(mission=mission, robot=who, round=number, event=event, options=options, words=words)
        return [noticed, AskJudgement(asked)]

    def _close(self, incident: Incident) -> list[Note]:
        """The votes are in: say what the team does, and do what has to be done once."""
        choice, agreement = self.votes.choice(incident), self._agreement
        notes = [_note("agreed", incident, choice=choice, votes=dict(self.votes.count(incident)))]
        plan, claim = agreement.plan, agreement.claim
        if plan is None or claim.table is None or claim.slot is None:
            return notes
        move = closing(agreement.mission, plan, claim.table) if choice == "close" else None
        if move is not None and move[0] == claim.slot:
            notes += self._move(claim.slot, move[1])
        if choice == "spare" and incident.robot == self._robot:
            agreement.retired = True
            notes += self._move(claim.slot, None)
        return notes

    def _move(self, before: int, slot: int | None) -> list[Note]:
        """Give the own slot up for a free one, or for none."""
        claim, table = self._agreement.claim, self._agreement.claim.table or ()
        entries: dict[int, BidEntry] = {before: (table[before][0] + 1, 0.0, NO_OWNER)}
        if slot is not None:
            entries[slot] = (table[slot][0] + 1, 0.0, self._robot)
        self._agreement.claim = Claim(slot=slot, table=changed(table, entries), bids=claim.bids)
        return [Note("claimed", {"slot": slot, "before": before})]

    def _follow(self) -> None:
        """Do what lasts, by the votes known now: plan again or not, and whose ways count for more."""
        chosen = [(one, key in self._closed, self.votes.choice(one)) for key, (one, _) in self._known.items()]
        deaths = [(choice or self._usual) if closed else None for one, closed, choice in chosen if one.kind == "death"]
        blocked = [(one, choice) for one, closed, choice in chosen if closed and one.kind == "blocked"]
        orders = [
            (one.left, one.robot, one.words, choice) for one, done, choice in chosen if done and one.words and choice
        ]
        self._obeyed = max(orders)[-1] if orders else None
        plans = "replan" in (*(deaths or [self._usual]), *(choice for _, choice in blocked), self._obeyed)
        self._membership.gaps = "replan" if plans else "report"
        self._membership.deliberate(open_=None in deaths)
        weights = {one.robot: WEIGHT for one, closed, choice in chosen if closed and choice == "swap"}
        if weights != self._agreement.weights:
            self._agreement.weights = weights
        resting = tuple(dict.fromkeys(resting_at(one) for one, choice in blocked if choice not in (None, "wait")))
        if resting != self._agreement.resting:
            self._agreement.resting = resting


def _note(kind: str, incident: Incident, **detail: object) -> Note:
    return Note(kind, {"about": incident.kind, "robot": incident.robot, **detail})
