"""One robot's part in the team's judgements: it notices events, asks its model once about each, and acts on the choice.

Without a choice the team does what it is configured to do. No choice touches the shield, so safety does not depend on
models here either.
"""

from __future__ import annotations

import math

from llm_flock.arrays import Point
from llm_flock.events import AskJudgement, Note
from llm_flock.message import NO_OWNER, BidEntry, Choice, Incident, Vote
from llm_flock.planner import JudgementAnswer, JudgementOption, JudgementQuestion, NoAnswer
from llm_flock.protocol._agreement.agreement import Agreement
from llm_flock.protocol._agreement.assignment import Claim
from llm_flock.protocol._agreement.auction import changed
from llm_flock.protocol._agreement.options import battery_options, closing, death_options
from llm_flock.protocol._agreement.votes import Votes
from llm_flock.protocol._breaker import fallback_notes
from llm_flock.protocol._parts import Gaps, Membership

PATIENCE = 4
"""Rounds for which a robot waits for the votes of others that count as alive, from when it knows of an incident."""

WEIGHT = 100.0
"""Weight of a weak robot's squared way in exchanges, where it is to give its place to a neighbour."""


class Judgement:
    """Call `begin_round` in each round, after heartbeats are counted, and `take` with the answer to its question."""

    def __init__(self, robot: int, agreement: Agreement, membership: Membership) -> None:
        self._robot, self._agreement, self._membership = robot, agreement, membership
        self._usual: Gaps = membership.gaps
        self._left: float | None = None
        self._here: Point = ()
        self.begin_mission()

    def begin_mission(self) -> None:
        """Forget what was judged: another mission, another situation. A battery that is weak stays so."""
        self.votes = Votes()
        self._asking: Incident | None = None
        self._since: dict[tuple[str, int], tuple[Incident, int]] = {}
        self._asked = set[tuple[str, int]]()
        self._closed = set[tuple[str, int]]()
        self._holders = set[int]()
        self._membership.gaps = self._usual

    def weaken(self, left: float) -> None:
        """The own body can fly only this far from now on [units]."""
        self._left = left

    @property
    def waits(self) -> bool:
        """Whether this robot's battery is weak, and the team has not yet chosen what to do about it."""
        key = ("battery", self._robot)
        return key in self._since and key not in self._closed

    def begin_round(self, number: int, position: Point) -> list[AskJudgement | Note]:
        """Notes, and last the question of this round, if there is one; `position` is the own one [world frame]."""
        if self._left is not None and self._here:
            self._left = max(0.0, self._left - math.dist(position, self._here))
        self._here = position
        for incident in (*self.votes.incidents.values(), *self._noticed()):
            self._since.setdefault((incident.kind, incident.robot), (incident, number))
        notes = list[AskJudgement | Note]()
        for key, (incident, since) in self._since.items():
            everybody = key in self._asked and self._membership.present <= self.votes.voters(incident)
            if key not in self._closed and (everybody or number - since >= PATIENCE):
                self._closed.add(key)
                notes += self._close(incident)
        due = [one for key, (one, _) in self._since.items() if key not in self._asked and self._can_judge(one)]
        self._follow()
        return notes + (self._ask(due[0], number) if due else [])

    def take(self, answer: JudgementAnswer | NoAnswer) -> list[Note]:
        """Cast the own vote: the model's answer, or none where that cannot be used."""
        incident, self._asking = self._asking, None
        if incident is None:
            return [Note("stale_answer", {"about": "judgement"})]
        usable = isinstance(answer, JudgementAnswer)
        self._vote(incident, answer.choice if usable else None)
        if not usable:
            return fallback_notes("judgement", "rule", answer)
        return [self._note("judged", incident, choice=answer.choice, reason=answer.reason)]

    def _noticed(self) -> list[Incident]:
        """The deaths that have left a place empty, and the own weak battery."""
        agreement = self._agreement
        table = agreement.claim.table
        if agreement.plan is None or table is None:
            return []
        owners = {owner for _, _, owner in table}
        dead = self._membership.silent & self._holders - owners if min(owners) < 0 else ()
        self._holders |= owners
        found = [Incident(kind="death", robot=robot) for robot in sorted(dead)]
        if self._left is not None and agreement.claim.slot is not None:
            found.append(Incident(kind="battery", robot=self._robot, left=self._left, at=agreement.position))
        return found

    def _can_judge(self, incident: Incident) -> bool:
        """Whether this robot has a plan, and in case of a death has noticed it itself."""
        table = self._agreement.claim.table
        known = incident.kind == "battery" or incident.robot in self._membership.silent
        return self._agreement.plan is not None and table is not None and known

    def _ask(self, incident: Incident, number: int) -> list[AskJudgement | Note]:
        """Ask the model about an incident. There is no vote where code sees one option at most."""
        self._asked.add((incident.kind, incident.robot))
        options = self._options(incident)
        noticed = self._note("incident", incident, options=[option.choice for option in options])
        if len(options) < 2:
            self._vote(incident, None)
            return [noticed]
        self._asking, mission = incident, self._agreement.mission.at(number)
        what = f"The battery of robot {incident.robot} is weak: it can fly {incident.left:.1f} units at most."
        if incident.kind == "death":
            what = f"Robot {incident.robot} has failed, and nobody fills its place."
        asked = JudgementQuestion(mission=mission, robot=self._robot, round=number, event=what, options=options)
        return [noticed, AskJudgement(asked)]

    def _options(self, incident: Incident) -> tuple[JudgementOption, ...]:
        if incident.kind == "battery":
            return battery_options(incident, self._agreement, self._robot, self._membership.present)
        options = death_options(self._agreement)
        usual = "replan" if self._usual == "replan" else "leave"
        return tuple(sorted(options, key=lambda option: option.choice != usual))

    def _vote(self, incident: Incident, choice: Choice | None) -> None:
        degree = self._agreement.degree
        self.votes.take(Vote(incident=incident, voter=self._robot, degree=degree, choice=choice))

    def _close(self, incident: Incident) -> list[Note]:
        """The votes are in: say what the team does, and do what has to be done once."""
        choice, count = self.votes.choice(incident), dict(self.votes.count(incident))
        notes, agreement = [self._note("agreed", incident, choice=choice, votes=count)], self._agreement
        plan, table, slot = agreement.plan, agreement.claim.table, agreement.claim.slot
        if plan is None or table is None or slot is None:
            return notes
        if choice == "close":
            move = closing(agreement.mission, plan, table)
            if move is not None and move[0] == slot:
                notes += self._move_to(move[1])
        if choice == "spare" and incident.robot == self._robot:
            agreement.retired = True
            notes += self._move_to(None)
        return notes

    def _move_to(self, slot: int | None) -> list[Note]:
        """Give the own slot up for this free one, or for none."""
        claim = self._agreement.claim
        before, table = claim.slot, claim.table
        assert table is not None and before is not None, "only a robot with a slot gives it up"
        entries: dict[int, BidEntry] = {before: (table[before][0] + 1, 0.0, NO_OWNER)}
        if slot is not None:
            entries[slot] = (table[slot][0] + 1, 0.0, self._robot)
        self._agreement.claim = Claim(slot=slot, table=changed(table, entries), bids=claim.bids)
        return [Note("claimed", {"slot": slot, "before": before})]

    def _follow(self) -> None:
        """Do what lasts, by the votes known now: plan again or not, and whose ways count for more."""
        chosen = [(one, key in self._closed, self.votes.choice(one)) for key, (one, _) in self._since.items()]
        deaths = [(choice or self._usual) if closed else None for one, closed, choice in chosen if one.kind == "death"]
        self._membership.gaps = "replan" if "replan" in (deaths or [self._usual]) else "report"
        self._membership.deliberates = not all(closed for one, closed, _ in chosen if one.kind == "death")
        weights = {one.robot: WEIGHT for one, closed, choice in chosen if closed and choice == "swap"}
        if weights != self._agreement.weights:
            self._agreement.weights = weights

    def _note(self, kind: str, incident: Incident, **detail: object) -> Note:
        return Note(kind, {"about": incident.kind, "robot": incident.robot, **detail})
