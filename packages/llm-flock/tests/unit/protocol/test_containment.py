"""One robot with a bad model: what is clipped, asked again, held and answered by geometry, and when it is probed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from driven_agent import says
from rounds import round_began
from whole_agent import whole_agent

from llm_flock.arrays import Point
from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    MissionGiven,
    MoveTo,
    Note,
    Origin,
    Phase,
    Planned,
    Received,
)
from llm_flock.message import decode
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.consensus import ProvenanceConsensus
from llm_flock.protocol._breaker import Fallback
from llm_flock.protocol._membership.liveness import CANNOT_FLY, NO_PLAN, PER_BEAT
from llm_flock.protocol._motion.leg import Pace

MISSION = Mission(shape="triangle", n_robots=3, comm_range=40)
IDEAL = Plan.of(MISSION.ideal or ())
START = (20.0, 50.0)
REFUSED = NoAnswer(cause="answer", reason="3 tries")

Planning = Callable[[PlanQuestion], PlanAnswer | NoAnswer]
Stepping = Callable[[StepQuestion], StepAnswer | NoAnswer]


def good_plan(question: PlanQuestion) -> PlanAnswer:
    return PlanAnswer(plan=Plan.of(question.mission.ideal or ()), slot=0)


def no_plan(_: PlanQuestion) -> NoAnswer:
    return REFUSED


def backwards(question: StepQuestion) -> StepAnswer:
    """A step of a unit away from the goal."""
    here, goal = question.position, question.goal
    away = math.dist(here, goal)
    return StepAnswer(waypoint=tuple(x - (g - x) / away for x, g in zip(here, goal, strict=True)))


def towards(question: StepQuestion, length: float = 6.0) -> Point:
    """The point on the way to the goal at this distance, or beyond it."""
    here, goal = question.position, question.goal
    away = math.dist(here, goal)
    share = 1.0 if length <= 6.0 and away <= length else length / away
    return tuple(x + share * (g - x) for x, g in zip(here, goal, strict=True))


class Robot:
    """One robot without neighbours, or beside `bodies` that say nothing, flown round by round with a test's model."""

    def __init__(
        self,
        plan: Planning = good_plan,
        step: Stepping = backwards,
        *,
        mission: Mission = MISSION,
        fallback: Fallback = "breaker",
        on_event: bool = False,
        shield_on: bool = True,
    ) -> None:
        self.agent = whole_agent(
            0,
            mission,
            ProvenanceConsensus(),
            AuctionAssignment(),
            shield_on=shield_on,
            verify=True,
            fallback=fallback,
            on_event=on_event,
        )
        self.model = plan, step
        self.here: Point = START
        self.bodies: dict[int, Point] = {}
        self.number = 0
        self.asked: list[PlanQuestion | StepQuestion] = []
        self.notes: list[Note] = []
        self.moves: list[MoveTo] = []
        self.beats: list[int] = []

    def begin(self) -> None:
        self.number += 1
        for effect in self.agent.handle(round_began(self.number, self.here, self.bodies)):
            if isinstance(effect, AskPlan):
                self.asked.append(effect.question)
                self.take(Planned(self.model[0](effect.question)))
            elif isinstance(effect, Note):
                self.notes.append(effect)

    def take(self, event: Planned | Decided) -> None:
        for effect in self.agent.handle(event):
            if isinstance(effect, Note):
                self.notes.append(effect)
            elif isinstance(effect, MoveTo):
                self.moves.append(effect)

    def fly(self, rounds: int = 1, *payloads: bytes) -> Robot:
        for _ in range(rounds):
            self.begin()
            (said,) = self.agent.handle(CommRoundBegan())
            assert isinstance(said, Broadcast)
            beats = decode(said.payload, 3, len(self.here)).beats
            self.beats.append(-1 if beats is None else beats[0] % PER_BEAT)
            for payload in payloads:
                self.agent.handle(Received(payload))
            self.agent.handle(CommRoundEnded())
            for effect in self.agent.handle(AgreementEnded()):
                if isinstance(effect, AskStep):
                    self.asked.append(effect.question)
                    self.take(Decided(self.model[1](effect.question)))
                elif isinstance(effect, MoveTo):
                    self.moves.append(effect)
                elif isinstance(effect, Note):
                    self.notes.append(effect)
            self.here = self.moves[-1].waypoint
            self.agent.handle(Arrived())
        return self

    @property
    def origins(self) -> list[str]:
        return [move.origin.value for move in self.moves]

    def breaker_notes(self) -> list[tuple[str, str]]:
        return [(n.detail["question"], n.detail["state"]) for n in self.notes if n.kind == "breaker"]


def test_refused_steps_give_way_to_geometry_and_model_probes() -> None:
    robot = Robot().fly(9)
    assert robot.origins == ["hold"] + ["geometry"] * 8
    steps = [(q.round, q.probe) for q in robot.asked if isinstance(q, StepQuestion)]
    assert steps == [(1, False), (2, False), (4, True), (8, True)]
    assert robot.agent.open_breakers == ("step",) and robot.agent.goal is not None
    assert robot.agent.goal in [move.waypoint for move in robot.moves], "then it goes to look for the others"
    assert robot.breaker_notes() == [("step", "open")] * 3
    assert [beat & CANNOT_FLY for beat in robot.beats] == [0, 0] + [CANNOT_FLY] * 7, "its heartbeats say so"
    fallbacks = [note.detail for note in robot.notes if note.kind == "fallback"]
    assert {(f["question"], f["by"]) for f in fallbacks} == {("step", "geometry")} and len(fallbacks) == 3


def test_a_probe_that_is_answered_well_closes_the_breaker() -> None:
    robot = Robot()
    robot.model = good_plan, lambda q: backwards(q) if q.round < 4 else StepAnswer(waypoint=towards(q))
    robot.fly(6)
    assert robot.origins == ["hold", "geometry", "geometry", "model", "model", "model"]
    assert robot.breaker_notes() == [("step", "open"), ("step", "closed")] and not robot.agent.open_breakers


@pytest.mark.parametrize("times", [1.5, 3.0, 40.0])
def test_too_long_step_in_the_right_direction_is_clipped(times: float) -> None:
    robot = Robot()
    robot.model = good_plan, lambda q: StepAnswer(waypoint=towards(q, 6.0 * times))
    robot.fly(3)
    assert set(robot.origins) == {"clipped"} and len([q for q in robot.asked if isinstance(q, StepQuestion)]) == 3
    assert robot.here == pytest.approx((38.0, 50.0), abs=6.0)
    clipped = [note for note in robot.notes if note.kind == "clipped"]
    assert len(clipped) == 3 and clipped[0].detail["flown"] == robot.moves[0].waypoint


def test_path_of_too_long_steps_is_cut_into_allowed_steps() -> None:
    robot = Robot(on_event=True)

    def two_leaps(question: StepQuestion) -> StepAnswer:
        (x, y), (gx, gy) = question.position, question.goal
        beyond = (gx + (gx - x), gy + (gy - y))
        return StepAnswer(waypoint=((x + gx) / 2, (y + gy) / 2), path=(beyond,))

    robot.model = good_plan, two_leaps
    robot.fly(7)
    assert robot.agent.goal is not None and math.dist(robot.here, robot.agent.goal) < 1e-9
    assert len([q for q in robot.asked if isinstance(q, StepQuestion)]) == 1
    assert robot.origins[0] == "clipped" and set(robot.origins[1:]) == {"model"}


def test_a_path_that_ends_short_of_the_goal_is_cut_up_to_its_end() -> None:
    robot = Robot(on_event=True)
    robot.model = good_plan, lambda q: StepAnswer(waypoint=towards(q, 10.0))
    robot.fly(2)
    assert math.dist(START, robot.here) == pytest.approx(10.0)
    assert len([q for q in robot.asked if isinstance(q, StepQuestion)]) == 1


def test_path_with_only_a_clippable_first_step_is_asked_again() -> None:
    robot = Robot(on_event=True)
    robot.model = good_plan, lambda q: StepAnswer(waypoint=towards(q, 12.0), path=((0.0, 0.0), (50.0, 50.0)))
    robot.fly(2)
    assert robot.origins == ["clipped", "clipped"] and len(robot.asked) == 3


@pytest.mark.parametrize("bad", [(math.nan, 50.0), (20.0, 50.0, 1.0)])
def test_path_with_a_bad_point_is_refused_or_ends_before_it(bad: Point) -> None:
    robot = Robot(on_event=True)
    robot.model = good_plan, lambda q: StepAnswer(waypoint=towards(q, 9.0), path=(bad,))
    robot.fly(1)
    assert robot.origins == ["clipped"]
    robot = Robot(on_event=True)
    robot.model = good_plan, lambda _: StepAnswer(waypoint=bad)
    robot.fly(2)
    assert robot.origins == ["hold", "geometry"]


def test_a_long_way_is_cut_at_the_horizon() -> None:
    wide = MISSION.change(center=(500.0, 50.0), arena=((0.0, 0.0), (1000.0, 100.0)))
    robot = Robot(mission=wide, on_event=True)
    robot.model = good_plan, lambda q: StepAnswer(waypoint=towards(q, 400.0))
    robot.fly(20)
    assert len([q for q in robot.asked if isinstance(q, StepQuestion)]) == 1
    assert math.dist(START, robot.here) == pytest.approx(120.0)


def test_a_model_that_only_just_passes_its_checks_is_too_slow() -> None:
    robot = Robot()
    robot.model = good_plan, lambda q: StepAnswer(waypoint=towards(q, 0.3))
    robot.fly(15)
    assert robot.agent.goal is not None and math.dist(robot.here, robot.agent.goal) < 1e-9
    assert "geometry" in robot.origins and robot.agent.open_breakers == ("step",)
    assert any(n.kind == "breaker" and "nearer to the goal" in n.detail["reason"] for n in robot.notes)


def test_nearly_arrived_or_blocked_robot_is_not_called_slow() -> None:
    pace = Pace()
    goal = IDEAL.points[0]
    question = StepQuestion(
        mission=MISSION, robot=0, round=1, position=(goal[0] + 0.15, goal[1]), neighbors=(), plan=IDEAL, slot=0
    )
    for _ in range(20):
        assert pace.too_slow(question, (goal[0] + 0.14, goal[1]), lambda: 6.0) is None
    blocked = replace(question, position=(goal[0] + 20.0, goal[1]), neighbors=((goal[0] + 17.0, goal[1]),))
    for _ in range(20):
        assert pace.too_slow(blocked, (goal[0] + 20.0, goal[1] + 6.0), lambda: 1.4) is None
    reasons = [pace.too_slow(blocked, (goal[0] + 20.0, goal[1] + 6.0), lambda: 1.6) for _ in range(5)]
    assert reasons[0] is None and "of a step nearer to the goal" in (reasons[-1] or ""), "others leave it room"


def test_a_probe_that_leads_away_is_refused_even_without_room() -> None:
    goal, pace = IDEAL.points[0], Pace()
    here, near = (goal[0] + 20.0, goal[1]), (goal[0] + 17.0, goal[1])
    question = StepQuestion(mission=MISSION, robot=0, round=1, position=here, neighbors=(near,), plan=IDEAL, slot=0)
    away, aside = (here[0] + 5.0, here[1]), (here[0] - 1.0, here[1] + 5.0)
    assert pace.too_slow(question, away, lambda: 0.0) is None, "it makes room"
    probe = replace(question, probe=True)
    assert "leads away" in (pace.too_slow(probe, away, lambda: 0.0) or "")
    assert pace.too_slow(probe, aside, lambda: 0.0) is None


@pytest.mark.parametrize(("beside", "ends"), [(2.5, "geometry"), (0.0, "model")])
def test_a_model_that_waits_is_overruled_if_there_is_room(beside: float, ends: str) -> None:
    """A body is in its straight way; past one that stands a little aside, the shield would let it fly."""
    robot = Robot(step=lambda question: StepAnswer(waypoint=question.position))
    robot.here = (IDEAL.points[1][0] - 20.0, IDEAL.points[1][1])
    robot.bodies = {1: (robot.here[0] + 3.5, robot.here[1] + beside)}
    robot.fly(9)
    assert robot.origins[-1] == ends and robot.origins[0] == "model"


def test_a_model_that_is_slow_between_refusals_is_found_out_too() -> None:
    """A third of a step at every second question, and prose at the others."""
    robot = Robot()

    def half_good(question: StepQuestion) -> StepAnswer | NoAnswer:
        return REFUSED if question.round % 2 else StepAnswer(waypoint=towards(question, 2.0))

    robot.model = good_plan, half_good
    robot.fly(12)
    assert robot.agent.goal in [move.waypoint for move in robot.moves]


def test_a_place_that_travels_has_to_be_reached_not_followed() -> None:
    """A robot that flies half of what is left trails behind by a whole step of the formation."""
    travels = MISSION.change(velocity=(2.0, 0.0))
    goal = IDEAL.points[0]
    reasons: list[str | None] = []
    for mission, after in ((travels, 1.0), (travels, 0.2), (MISSION, 1.0)):
        question = StepQuestion(
            mission=mission, robot=0, round=1, position=(goal[0] - 2.0, goal[1]), neighbors=(), plan=IDEAL, slot=0
        )
        pace = Pace()
        reasons.append([pace.too_slow(question, (goal[0] - after, goal[1]), lambda: 0.0) for _ in range(6)][-1])
    assert reasons[0] is not None and reasons[1:] == [None, None]


def test_fallback_hold_holds_and_asks_in_every_round() -> None:
    robot = Robot(fallback="hold").fly(6)
    assert robot.origins == ["hold"] * 6 and robot.here == START and not robot.agent.open_breakers
    assert len([q for q in robot.asked if isinstance(q, StepQuestion)]) == 6 and not robot.breaker_notes()
    lost = Robot(no_plan, fallback="hold").fly(5)
    assert lost.here == START and len(lost.asked) == 5 and lost.agent.hopeless is None


def test_with_geometry_no_round_is_lost() -> None:
    robot = Robot(no_plan, fallback="geometry").fly(5)
    assert robot.origins == ["geometry"] * 5 and robot.agent.plan == IDEAL
    assert [note.detail["by"] for note in robot.notes if note.kind == "proposed"] == ["geometry"]


def test_geometry_without_points_leaves_a_robot_without_a_plan() -> None:
    words = Mission(shape="text:a cloud", n_robots=3, comm_range=40)
    robot = Robot(no_plan, mission=words, fallback="geometry").fly(3)
    assert robot.agent.plan is None and robot.agent.hopeless == REFUSED


def test_robot_without_plan_goes_to_centre_and_asks_rarely() -> None:
    robot = Robot(no_plan).fly(12)
    assert [(q.round, q.probe) for q in robot.asked] == [(1, False), (2, False), (4, True), (8, True)]
    assert math.dist(robot.here, MISSION.center) <= 0.5 * MISSION.spacing
    assert set(robot.origins[:4]) == {"geometry"} and robot.origins[-1] == "hold"
    assert robot.agent.hopeless == REFUSED and robot.agent.open_breakers == ("plan",)
    assert [beat & NO_PLAN for beat in robot.beats] == [NO_PLAN] * 12
    robot.fly(1, says(1, mission=MISSION, plan=IDEAL))
    assert robot.agent.plan == IDEAL and robot.agent.hopeless is None, "the first acceptable plan that it hears"


def test_gathering_reaches_the_centre_without_the_shield() -> None:
    robot = Robot(no_plan, shield_on=False).fly(12)
    assert math.dist(robot.here, MISSION.center) <= 0.5 * MISSION.spacing


def test_a_robot_that_has_not_been_refused_yet_listens_and_stays() -> None:
    robot = Robot(no_plan)
    robot.number = 4
    robot.agent.handle(round_began(5, START, {1: (30.0, 50.0)}))
    assert robot.agent.phase is Phase.AGREEING, "it joins a team that works"
    (note, move) = robot.agent.handle(AgreementEnded())
    assert isinstance(note, Note) and isinstance(move, MoveTo) and move.origin is Origin.HOLD


def test_another_mission_is_asked_about_at_once() -> None:
    robot = Robot(no_plan).fly(2)
    assert robot.agent.hopeless is not None
    robot.model = good_plan, backwards
    robot.agent.handle(MissionGiven(mission=MISSION.change(spacing=11.0), ordered_at=1))
    assert robot.agent.hopeless is None
    robot.fly(1)
    assert robot.asked[2].probe and robot.agent.plan is not None and robot.agent.open_breakers == ()


def test_an_order_that_changes_nothing_is_no_other_mission() -> None:
    robot = Robot(no_plan).fly(2)
    robot.agent.handle(Received(b"nothing"))
    assert robot.agent.hopeless is not None


def test_a_path_of_tiny_steps_is_not_flown_to_its_end() -> None:
    robot = Robot(on_event=True)

    def crawl(question: StepQuestion) -> StepAnswer:
        way = [towards(question, 0.2 * k) for k in range(1, 21)]
        return StepAnswer(waypoint=way[0], path=tuple(way[1:]))

    robot.model = good_plan, crawl
    robot.fly(25)
    assert robot.agent.goal in [move.waypoint for move in robot.moves] and "geometry" in robot.origins
