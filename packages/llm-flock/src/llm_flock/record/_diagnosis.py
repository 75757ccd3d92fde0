"""Finds in a record why a team did not form: models, deaths, links, obstacles or rules.

Pages, reports, notebooks and the command line all show this text. Needs no numerical library, so that a first page
loads quickly.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple, cast

from llm_flock.record._history import CallCounts, RunHistory
from llm_flock.record._schema import DEAD, SILENT, LlmEntry
from llm_flock.record._words import MAX_PLACES, begun, counted, robots_text, sentence

AT_GOAL, IN_SHAPE = 0.05, 0.1
"""As shares of the spacing, as in `llm_flock.metrics`, whose libraries load too slowly for a first page."""

SETTLING = (("provenance", "auction"), ("medoid", "auction"))  # rules that bring a team in radio contact together
MAX_TOLD = 3
"""Most groups of robots, plans, and causes that are listed."""


class Cause(NamedTuple):
    """A reason why a team did not form: sentences that describe it, and the robots concerned."""

    text: str
    robots: tuple[int, ...] = ()
    round: int | None = None  # None if it belongs to no single round
    calls: tuple[LlmEntry, ...] = ()  # the model call behind it, and its retries


class Diagnosis(NamedTuple):
    """Why a team did not form, the most important cause first; empty if no round was flown."""

    causes: tuple[Cause, ...] = ()
    robots: tuple[int, ...] = ()  # of all causes, also of those that are not listed
    look: tuple[int, str] | None = None  # if no robot is the cause: a robot worth a look, and why

    @property
    def why(self) -> str:
        """All causes as one text."""
        return " ".join(cause.text for cause in self.causes)


def diagnose(run: RunHistory) -> Diagnosis:
    """Why a team did not form its last mission, by the record up to its last round. Call it for a failed run."""
    if run.last_round < 1:
        return Diagnosis()
    end = _LastRound(run)
    causes = end.causes()
    fact, look = end.fact()
    if not causes and fact is not None and not end.settles:
        return Diagnosis((Cause(f"No robot is to blame: {end.rules_failed()} {fact.text}"),), (), look)
    if not causes:
        only = fact or Cause("By the record, nothing was wrong in the last round.", round=run.last_round)
        return Diagnosis((only,), only.robots, look)
    robots = tuple(dict.fromkeys(robot for cause in causes for robot in cause.robots))
    told = causes[:MAX_TOLD]
    if not end.settles and end.quarrel(robots):
        others = "The other robots did not agree either" if robots else "The robots did not agree"
        told.append(Cause(f"{others}, {'for' if end.alone else 'by'} {end.rules}.", round=run.last_round))
    elif fact is not None and len(told) < MAX_TOLD and not (fact.robots and {*fact.robots} <= {*robots}):
        told.append(fact)
    return Diagnosis(tuple(told), robots, look)


def deaths_text(run: RunHistory) -> str:
    """The robots that are dead in the last round, when they died and by what; empty if all are alive."""
    dead = _dead_robots(run)
    rounds = sorted({run.death_rounds[robot] for robot in dead if robot in run.death_rounds})
    when = f" in round{'s' if len(rounds) > 1 else ''} {', '.join(map(str, rounds[:MAX_PLACES]))}" if rounds else ""
    by = ", ".join(sorted({_killer(run, robot) for robot in dead}))
    return f"{robots_text(dead)} died{when} ({by})" if dead else ""


def _killer(run: RunHistory, robot: int) -> str:
    """By what a robot died: runs kill robots as they are told, and of a swarm's robots nothing more is heard."""
    number = run.death_rounds.get(robot)
    if number is None:
        return "no longer heard"
    trial: Mapping[str, Any] = {} if run.info is None else run.info.config.get("trial", {})
    if f"{robot}@{number}" in str(trial.get("kill")).replace(" ", "").split(","):
        return "killed by --kill"
    return "killed by --kill-random" if trial.get("kill_random") else "killed by an order in flight"


def _dead_robots(run: RunHistory) -> list[int]:
    return [robot for robot, phase in enumerate(run.states[run.last_round].phases) if phase == DEAD]


class _LastRound:
    """The team in the last round, and its history. Each method without a verb finds one kind of cause."""

    def __init__(self, run: RunHistory) -> None:
        self.run, self.state = run, run.states[run.last_round]
        state, self.mission = self.state, run.mission_at(run.last_round).mission
        self.spacing = float(self.mission["spacing"])
        self.awake = [robot for robot, phase in enumerate(state.phases) if phase not in SILENT]
        self.without = [robot for robot in self.awake if state.plan_ids[robot] is None]
        owners = Counter(map(self.claim, self.awake))
        self.shared = [k for k in self.awake if state.slots[k] is not None and owners[self.claim(k)] > 1]
        self.away = [robot for robot in self.awake if self.far(robot) > AT_GOAL * self.spacing]
        held: defaultdict[str, list[int]] = defaultdict(list)
        for robot in self.awake:
            if state.plan_ids[robot] is not None:
                held[run.plan_name(state.plan_ids[robot])].append(robot)
        self.groups = sorted(held.items(), key=lambda one: (-len(one[1]), one[0]))
        largest = self.groups[0][1] if self.groups else []
        # Where no plan has most of the robots, none of them stands apart from the team.
        self.most = 2 * len(largest) > len(self.awake) - len(self.without)
        others = self.groups[1 if self.most else 0 :] if len(self.groups) > 1 else []
        self.strays = sorted(robot for _, members in others for robot in members)
        self.alone = run.rules[0] == "none"
        # True also for rules of which the record says nothing.
        self.settles = run.rules in SETTLING or not all(run.rules)
        named = f"this protocol's rules ({', '.join(run.rules)})"
        self.rules = "this protocol has no consensus" if self.alone else named
        self.named: set[int] = set()  # by the causes found so far

    def causes(self) -> list[Cause]:
        """All causes, in the order in which they are listed."""
        causes: list[Cause] = []
        of_models = (self.accused, self.answers, self.plans, self.steps)
        for find in (*of_models, self.dead, self.ended, self.links, self.blocked):
            cause = find()
            if cause is not None:
                causes.append(cause)
                self.named.update(cause.robots)
        return causes

    def claim(self, robot: int) -> tuple[str | None, int | None]:
        """The place that a robot claims, in its plan."""
        return self.state.plan_ids[robot], self.state.slots[robot]

    def far(self, robot: int) -> float:
        """Distance of a robot from its goal; 0 without one [units]."""
        goal = self.state.goals[robot]
        return 0.0 if goal is None else math.dist(self.state.positions[robot], goal)

    def models(self, robots: Sequence[int]) -> str:
        """The models of some robots, by name if the record has names."""
        names = dict.fromkeys(self.run.call_counts[robot].model for robot in robots if robot in self.run.call_counts)
        some = ", ".join([name for name in names if name][:MAX_TOLD])
        return f"{'its model' if len(robots) == 1 else 'their models'}{f' ({some})' if some else ''}"

    def rules_failed(self) -> str:
        """A sentence on what the rules failed to do."""
        if self.alone:
            own = (
                "each robot kept its own plan"
                if len(self.groups) == len(self.awake)
                else "robots kept plans of their own"
            )
            return f"{self.rules}, so {own}."
        return f"{self.rules} did not bring the team to one plan and each robot to a place of its own."

    def quarrel(self, robots: Sequence[int]) -> bool:
        """Whether the team without some robots, and without their plans, has several plans or claims a place twice."""
        owned = {plan for plan, info in self.run.plans.items() if info.proposer in robots}
        claims = [self.claim(robot) for robot in self.awake if robot not in robots]
        claims = [claim for claim in claims if claim[0] is not None and claim[0] not in owned]
        return len({plan for plan, _ in claims}) > 1 or len(set(claims)) < len(claims)

    def fact(self) -> tuple[Cause | None, tuple[int, str] | None]:
        """What was wrong in the last round, and a robot worth a look; None if nothing was wrong."""
        robots: Sequence[int] = ()
        kind, when = "plan", self.run.last_round
        if self.without:
            robots, look = self.without, (self.without[0], "it has no plan")
            text = f"{begun(robots_text(robots))} got no plan."
        elif len(self.groups) > 1:
            asked, why = self.groups[-1][1][0], "it kept a plan of its own"
            text = f"{len(self.groups)} plans were in use at the end"
            if not self.alone:
                why = "it holds another plan than most" if self.most else "few others hold its plan"
                robots = self.strays if self.most else ()
                told = [f"{robots_text(held)} had plan {name}" for name, held in self.groups[:MAX_TOLD]]
                told += ["and so on"] if len(self.groups) > MAX_TOLD else []
                held = f"{robots_text(self.strays)} held another than most" if self.most else "; ".join(told)
                text = f"The team did not agree: {text}; {held}"
            text, look = f"{text}.", (asked, why)
        elif self.shared:
            one = len(set(map(self.claim, self.shared))) == 1
            claimed = "claimed the same place" if one else "claimed places that others claimed too"
            robots, look = self.shared, (self.shared[0], "another robot claims its place too")
            text = f"{begun(robots_text(robots))} {claimed}."
        elif self.away:
            kind, robots, look = "step", self.away, (max(self.away, key=self.far), "it has not reached its place")
            text = (
                f"{begun(robots_text(robots))} had not reached {'its place' if len(robots) == 1 else 'their places'}."
            )
        else:
            return None, None
        asked = look[0]
        plan = self.run.plans.get(self.state.plan_ids[asked] or "")
        if len(self.groups) > 1 and plan is not None:
            asked, when = plan.proposer, plan.round
        return Cause(text, tuple(robots), self.run.last_round, self.run.last_calls(asked, kind, when)), look

    def accused(self) -> Cause | None:
        """Robots that others caught in a lie."""
        told = [
            f"Robot {robot} was accused of sending what no honest robot sends: {reason}"
            for robot, reason in sorted(self.run.accused.items())
        ]
        return Cause(". ".join(told[:MAX_TOLD]) + ".", tuple(sorted(self.run.accused))) if told else None

    def answers(self) -> Cause | None:
        """Models with at least half of their answers unusable, or that are no longer asked."""
        run, hopeless = self.run, 0.5
        counts = {robot: run.call_counts.get(robot, CallCounts()) for robot in self.awake}
        poor = [robot for robot in self.awake if 0 < counts[robot].unusable >= hopeless * counts[robot].asked]
        breakers = self.state.open_breakers or [[]] * len(self.state.phases)
        hit = {*self.without, *self.strays, *self.shared, *self.away}
        # Where one of them went wrong, models whose robots had help are not to blame.
        robots = [robot for robot in self.awake if robot in hit and (robot in poor or breakers[robot])] or poor
        if not robots:
            return None
        unusable, asked = sum(counts[k].unusable for k in robots), sum(counts[k].asked for k in robots)
        last = next((counts[k].last for k in reversed(robots) if counts[k].last), "").strip()
        quoted = f" The last reason: {sentence(last, 160)}" if last else ""
        calls = f"{unusable} of {counted(asked, 'call')}"
        text = f"{begun(robots_text(robots))}: {self.models(robots)} gave no usable answer in {calls}.{quoted}"
        failed = [
            entry
            for k in robots
            for kind in ("plan", "step")
            for entry in run.last_calls(k, kind, run.last_round)
            if entry.error is not None or entry.rejected is not None
        ]
        last_calls = run.last_calls(failed[-1].robot, failed[-1].kind, failed[-1].round) if failed else ()
        return Cause(text, tuple(robots), last_calls[-1].round if last_calls else None, last_calls)

    def plans(self) -> Cause | None:
        """Robots that proposed a plan in use that is off the shape."""
        most_points = 250  # the work grows with the square of a plan's places
        run, ideal = self.run, self.run.mission_at(self.run.last_round).ideal
        if not ideal or len(ideal) > most_points:
            return None
        wanted = _apart(ideal)
        texts, robots, first = list[str](), dict[int, None](), None
        for plan_id in dict.fromkeys(plan for robot in self.awake if (plan := self.state.plan_ids[robot]) is not None):
            plan = run.plans.get(plan_id)
            if plan is None or len(plan.points) != len(ideal) or len(texts) == MAX_TOLD:
                continue
            off = sum(abs(a - b) for a, b in zip(_apart(plan.points), wanted, strict=True)) / max(1, len(wanted))
            if off <= IN_SHAPE * self.spacing:
                continue
            robots[plan.proposer] = None
            held = [robot for robot in self.awake if self.state.plan_ids[robot] == plan_id]
            who = "all flew it" if len(held) == len(self.awake) else f"{robots_text(held)} flew it"
            whose = "geometry" if run.made_by_geometry(plan_id) else self.models([plan.proposer])
            by = f"distances between its places by {off:.2g} units on average"
            texts.append(f"Robot {plan.proposer}: {whose} proposed a plan that is off the shape ({by}), and {who}.")
            first = first or Cause("", (), plan.round, run.last_calls(plan.proposer, "plan", plan.round))
        return None if first is None else first._replace(text=" ".join(texts), robots=tuple(robots))

    def steps(self) -> Cause | None:
        """Models that led their robots away from their goals in many of the last steps."""
        judged_rounds, least, share = 20, 5, 0.4
        run, told = self.run, dict[int, str]()
        first = max(1, run.mission_at(run.last_round).round, run.last_round - judged_rounds + 1)
        for robot in self.away:
            judged = [away for k in range(first, run.last_round + 1) if (away := self.led_away(robot, k)) is not None]
            astray = sum(judged)
            if astray >= least and astray >= share * len(judged):
                what = f"led it away from its goal in {astray} of its last {len(judged)} steps"
                told[robot] = f"Robot {robot}: {self.models([robot])} {what}."
        return self.each(told, run.last_calls(next(iter(told)), "step", run.last_round) if told else ())

    def each(self, sentences: dict[int, str], calls: tuple[LlmEntry, ...] = ()) -> Cause | None:
        """A cause from one sentence on each robot in the last round; None without any."""
        text = " ".join(list(sentences.values())[:MAX_TOLD])
        return Cause(text, tuple(sentences), self.run.last_round, calls) if sentences else None

    def led_away(self, robot: int, number: int) -> bool | None:
        """Whether a model's step ended farther from the goal than it began; None if no model chose the step."""
        state, before = self.run.states[number], self.run.states[number - 1]
        to, at = state.waypoints[robot], before.positions[robot]
        # A goal may change after the question: a step towards the one or the other is no mistake.
        goals = [goal for goal in (state.goals[robot], before.goals[robot]) if goal is not None]
        if to is None or not goals or state.origins[robot] not in ("model", "clipped"):
            return None
        near = AT_GOAL * float(self.run.mission_at(number).mission["spacing"])
        return all(math.dist(to, goal) > max(near, math.dist(at, goal) - 1e-3) for goal in goals)

    def dead(self) -> Cause | None:
        """Robots that died."""
        dead = _dead_robots(self.run)
        if not dead:
            return None
        others = "and the others did not fill the formation" if self.awake else "and no robot was left"
        when = max((self.run.death_rounds[robot] for robot in dead if robot in self.run.death_rounds), default=None)
        return Cause(f"{begun(deaths_text(self.run))}, {others}.", tuple(dead), when)

    def ended(self) -> Cause | None:
        """Runs that ended before they could form."""
        run, stopped = self.run, (self.run.result or {}).get("stopped")
        if stopped in ("budget", "interrupted"):
            what = "The budget was used up" if stopped == "budget" else "The run was ended"
            return Cause(f"{what} in round {run.last_round}.", round=run.last_round)
        step = self.mission.get("max_step")
        if stopped != "rounds" or self.alone or not isinstance(step, int | float):
            return None
        coming = [
            robot
            for robot in self.away
            if robot not in self.named
            and self.far(robot) > step
            and all(self.nearer(robot, k) > step / 2 for k in (0, 1))
        ]
        if not coming:
            return None
        far = f"{max(map(self.far, coming)):.0f} units from"
        one = len(coming) == 1
        were = f"was still on its way, {far} its place" if one else f"were still on their way, up to {far} their places"
        return Cause(f"{begun(robots_text(coming))} {were}, when the rounds were used up.", round=run.last_round)

    def nearer(self, robot: int, ago: int) -> float:
        """By how much a robot came nearer to its last goal in the last round, or the one before [units]."""
        goal, number = self.state.goals[robot], self.run.last_round - ago
        if goal is None or number <= 0:
            return 0.0
        before, after = (state.positions[robot] for state in self.run.states[number - 1 : number + 1])
        return math.dist(before, goal) - math.dist(after, goal)

    def links(self) -> Cause | None:
        """Robots out of touch with the others, and lost messages."""
        run, told, robots = self.run, list[str](), list[int]()
        parts = self.parts()
        apart = sorted(robot for part in parts[1:] for robot in part)
        if not self.settles:
            # With rules that bring no team together, robots that have met part because of these.
            robots = [k for k in apart if not self.alone and k not in self.named and not self.met(k)]
            if robots:
                told.append(f"{_robots_were(robots)} out of radio range of all others in every round.")
        elif not {*apart} <= self.named:  # a robot that was named before is apart for that reason
            last = next((k for k in range(run.last_round, -1, -1) if run.rows[k].connected), None)
            once = "never were all robots in contact" if last is None else f"all were in contact up to round {last}"
            if len(parts) == len(self.awake):
                told.append("At the end no robot was in radio range of another one.")
            elif 2 * len(parts[0]) > len(self.awake):
                robots = apart
                told.append(f"{_robots_were(robots)} out of radio range of the others at the end; {once}.")
            else:
                some = "; ".join(robots_text(part) for part in parts[:MAX_TOLD])
                more = "; and so on" if len(parts) > MAX_TOLD else ""
                told.append(f"The team was in {len(parts)} parts out of radio range of one another: {some}{more}.")
        many = 0.3
        if run.loss >= many:
            told.append(f"{100 * run.loss:.0f} % of the messages were lost.")
        return Cause(" ".join(told), tuple(robots)) if told else None

    def parts(self) -> list[list[int]]:
        """The robots that hear one another, directly or through others; the largest part first."""
        reach, positions = float(self.mission["comm_range"]), self.state.positions
        left, parts = set(self.awake), list[list[int]]()
        while left:
            part, new = set[int](), {min(left)}
            while new:
                part |= new
                left -= new
                new = {other for other in left if any(math.dist(positions[k], positions[other]) <= reach for k in new)}
            parts.append(sorted(part))
        return sorted(parts, key=lambda part: (-len(part), part))

    def met(self, robot: int) -> bool:
        """Whether a robot was in radio range of any other in any round; not looked at in a very large run."""
        most_distances = 20_000
        reach, states = float(self.mission["comm_range"]), self.run.states[: self.run.last_round + 1]
        others = [other for other in range(self.run.n_robots) if other != robot]
        return len(states) * len(others) > most_distances or any(
            math.dist(state.positions[robot], state.positions[other]) <= reach for state in states for other in others
        )

    def blocked(self) -> Cause | None:
        """Robots that agreed with all others, but found an obstacle or a robot in their way."""
        if self.without or len(self.groups) > 1 or self.shared:
            return None
        run, told = self.run, dict[int, str]()
        recent = [
            event for k in range(max(1, run.last_round - 9), run.last_round + 1) for event in run.events.get(k, ())
        ]
        waiting = {event.robot for event in recent if event.kind in ("deadlock", "gives_way")}
        for robot in self.away:
            at, goal = self.state.positions[robot], self.state.goals[robot]
            if any(crosses((at, goal or at), obstacle) for obstacle in self.mission.get("obstacles", ())):
                why = "an obstacle stood in its way"
            elif robot in waiting:
                why = "other robots were in its way"
            else:
                continue
            told[robot] = f"Robot {robot} had not reached its place: {why}."
        return self.each(told)


def _apart(points: Sequence[Sequence[float]]) -> list[float]:
    """Distances of all pairs in order of size: the same for a shape wherever it stands and however it is turned."""
    return sorted(math.dist(one, other) for one, other in combinations(points, 2))


def _robots_were(robots: Sequence[int]) -> str:
    return f"{begun(robots_text(robots))} {'was' if len(robots) == 1 else 'were'}"


def crosses(way: tuple[Sequence[float], Sequence[float]], obstacle: Mapping[str, Any]) -> bool:
    """Whether a straight way meets an obstacle: a disc, a ball, or, seen from above, a polygon."""
    start, goal = way
    if obstacle.get("polygon") is not None:
        corners = cast("Sequence[Sequence[float]]", obstacle["polygon"])
        sides = zip(corners, [*corners[1:], corners[0]], strict=True)
        return any(
            _side(start, goal, one) * _side(start, goal, other) < 0
            and _side(one, other, start) * _side(one, other, goal) < 0
            for one, other in sides
        )
    middle = cast("Sequence[float]", obstacle["center"])
    along = [b - a for a, b in zip(start, goal, strict=True)]
    long = sum(part * part for part in along) or 1.0
    share = sum((m - a) * part for m, a, part in zip(middle, start, along, strict=False)) / long
    nearest = [a + min(1.0, max(0.0, share)) * part for a, part in zip(start, along, strict=True)]
    return math.dist(nearest[: len(middle)], middle[: len(nearest)]) < float(obstacle["radius"])


def _side(p: Sequence[float], q: Sequence[float], r: Sequence[float]) -> float:
    """On which side of the line from p to q a point r lies."""
    return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
