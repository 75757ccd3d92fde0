"""One robot's flight: when it asks its planner, and how checks and shield turn the answer into a move."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import msgspec

from llm_flock.arrays import Point, moved
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.protocol.breaker import BreakerState, CircuitBreaker, Fallback, fallback_notes
from llm_flock.protocol.events import AskStep, Effect, MoveTo, Note, Origin
from llm_flock.protocol.geometry import straight_path
from llm_flock.protocol.messages.message import Course
from llm_flock.protocol.motion.committed_path import HORIZON, CommittedPath, Trigger
from llm_flock.protocol.motion.leg import Leg, leg_to
from llm_flock.protocol.motion.pace import Pace
from llm_flock.protocol.parts import NO_COURSES, Parts
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, StepAnswer, StepQuestion
from llm_flock.protocol.verification.steps import shortened


class Observation(msgspec.Struct, frozen=True, kw_only=True):
    """Positions that a robot observes in a round.

    Attributes:
        position: the robot's believed position [units; world frame].
        sensed: believed positions of the robots within sensing range, by id [units; world frame].
        observed: positions of other robots for the planner's question [units; world frame].
        drift: displacement of the mission's frame so far [units]; empty if the mission stands still.
        ahead: displacement at the end of the round, for which goals are given [units]; empty as `drift`.
        courses: ways that others ask to be left free, by sender.
        still: bodies in sight that do not move [units; world frame].
        period: heartbeat period; None where each round counts as one.
    """

    round: int
    position: Point
    sensed: Mapping[int, Point]
    observed: tuple[Point, ...]
    drift: Point = ()
    ahead: Point = ()
    courses: Mapping[int, Course] = NO_COURSES
    still: tuple[Point, ...] = ()
    period: int | None = None

    def seen(self, point: Point) -> Point:
        """A point of the world frame in the present frame of the mission."""
        return moved(point, self.drift, -1.0)

    @property
    def here(self) -> Point:
        """The robot's position in the frame of the mission."""
        return self.seen(self.position)


class Pilot:
    """Flies one robot, round by round.

    Call `decide` in each round with a goal, or `hold` in a round without one. `decide` may return a question; call
    `take` with its answer, and `look` when positions are updated in between. With `on_event`, the planner gives a path
    and is asked again only on a `Trigger`; `on_path` says whether this round's step comes from that path.

    `fallback` says what flies without a usable answer. While the `breaker` is open, the planner is not asked.
    """

    def __init__(
        self,
        robot: int,
        mission: Mission,
        parts: Parts,
        *,
        noise_bound: float,
        on_event: bool,
        fallback: Fallback,
    ) -> None:
        self.on_path = False
        self.breaker = CircuitBreaker("step", enabled=fallback != "hold")
        self._fallback: Fallback = fallback
        self._pace = Pace()
        self._tolerance = AT_GOAL * mission.spacing
        self._noise = noise_bound
        self._robot = robot
        self._safety, self._verifier = parts.safety, parts.verifier
        self._horizon = HORIZON if on_event else 1
        self._committed: CommittedPath | None = None
        self._question: StepQuestion | None = None
        self._scene: Observation | None = None
        self._leg: Leg | None = None

    def decide(
        self, scene: Observation, mission: Mission, plan: Plan, slot: int | None, target: Point | None
    ) -> list[Effect]:
        """The next step of the committed path, or a question about it.

        The question has `mission` as it stands at the end of the round. `target` is a goal in place of the slot's
        place; both, and `plan`, are in the frame of the mission.
        """
        ahead = scene.ahead
        self._scene, self._tolerance = scene, AT_GOAL * mission.spacing
        aim = plan.points[slot or 0] if target is None else target
        leg = self._leg = leg_to(mission, scene.position, aim, scene.drift, ahead, scene.still, self._noise)
        question = self._question = StepQuestion(
            mission=mission,
            robot=self._robot,
            round=scene.round,
            position=scene.position,
            neighbors=scene.observed,
            plan=Plan.of(moved(x, ahead) for x in plan.points) if ahead else plan,
            slot=slot,
            target=None if target is None else moved(target, ahead),
            corner=None if leg.stop == leg.goal else moved(leg.stop, ahead),
            horizon=self._horizon,
        )
        trigger = None if self._committed is None else self._trigger(self._committed, question, scene)
        self.on_path = self._committed is not None and trigger is None
        if self._committed is not None and trigger is None:
            answer = _shifted(self._committed.answer, ahead)
            return self._move(answer, question, scene, answer.waypoint)
        if not self.breaker.asks(scene.round):
            return self._by_geometry(question, scene)
        if self.breaker.state is BreakerState.HALF_OPEN:
            question = self._question = replace(question, probe=True)
        notes = [] if trigger is None else [Note("asked_again", {"reason": trigger.value})]
        return [*notes, AskStep(question)]

    def take(self, answer: StepAnswer | NoAnswer) -> list[Effect]:
        """The move that follows from the planner's answer. With `on_event`, the robot commits to its path."""
        question, scene = self._question, self._scene
        assert question is not None and scene is not None, "only a robot that asked is answered"
        if self._fallback == "hold":
            return self._commit(answer, question, scene, answer.waypoint)
        fit = self._usable(question, answer)
        if not isinstance(fit, NoAnswer):
            return [*self.breaker.usable(), *self._commit(fit, question, scene, answer.waypoint)]
        notes: list[Effect] = [*self.breaker.refused(scene.round, fit)]
        if self._fallback == "breaker" and not self.breaker.is_open:
            self._pace.held()
            return [*notes, *self._commit(fit, question, scene, answer.waypoint)]
        notes.extend(fallback_notes("step", "geometry", fit))
        return [*notes, *self._by_geometry(question, scene, answer.waypoint)]

    def _usable(self, question: StepQuestion, answer: StepAnswer | NoAnswer) -> StepAnswer | NoAnswer:
        """The answer, clipped if that suffices, or the reason why it cannot be used."""
        fit = answer if isinstance(answer, NoAnswer) else self._verifier.fit(question, answer)
        slow = None if isinstance(fit, NoAnswer) else self._pace.too_slow(question, fit.waypoint)
        return fit if slow is None else NoAnswer(cause="slow", reason=slow)

    def _commit(
        self, answer: StepAnswer | NoAnswer, question: StepQuestion, scene: Observation, asked: Point | None
    ) -> list[Effect]:
        if question.horizon > 1:
            kept = _shifted(answer, scene.ahead, -1.0) if isinstance(answer, StepAnswer) else answer
            self._committed = CommittedPath.of(self._relative(question, scene), kept, scene.sensed)
        return self._move(answer, question, scene, asked)

    def _by_geometry(self, question: StepQuestion, scene: Observation, asked: Point | None = None) -> list[Effect]:
        """A straight step to the goal in place of the planner's."""
        self._committed = None
        return self._fly(straight_path(question).waypoint, scene, asked, Origin.GEOMETRY)

    def seek(self, scene: Observation, mission: Mission, target: Point) -> list[Effect]:
        """Fly by geometry to a point where others will look [units; frame of the mission]: a robot without a plan."""
        self.forget()
        self._tolerance = AT_GOAL * mission.spacing
        self._leg = leg_to(mission, scene.position, target, scene.drift, scene.ahead, scene.still, self._noise)
        here, goal, max_step = scene.position, moved(self._leg.stop, scene.ahead), mission.max_step
        wish = goal if math.dist(here, goal) <= max_step else shortened(here, goal, max_step)
        return self._fly(wish, scene, None, Origin.GEOMETRY)

    def hold(self, scene: Observation, cause: str, reason: str, asked: Point | None = None) -> list[Effect]:
        """Hold the position for a stated cause. With the shield on, still move away from a robot that is too near."""
        held = Note("held", {"cause": cause, "reason": reason})
        flight = self._safety.stay(scene.position, scene.sensed, scene.courses, scene.period)
        return [held, *flight.notes, MoveTo(waypoint=flight.waypoint, proposed=asked, origin=flight.origin)]

    @property
    def course(self) -> Course | None:
        """The way that this robot asks others to leave free, in its last step."""
        return self._safety.course

    def begin_mission(self) -> None:
        """Heed everybody who asks for a way again: a mission has been given."""
        self._safety.begin_mission()

    def look(self, scene: Observation) -> None:
        """Replace the observation while the planner's answer is pending."""
        self._scene = scene

    def forget(self) -> None:
        """Drop the committed path, as for a robot that has no goal."""
        self._committed, self.on_path = None, False

    def _relative(self, question: StepQuestion, scene: Observation) -> StepQuestion:
        """The question in the frame of the mission, in which places stand still."""
        if not scene.ahead:
            return question
        plan = Plan.of(moved(x, scene.ahead, -1.0) for x in question.plan.points)
        assert self._leg is not None, "a robot with a question has a goal"
        return replace(question, position=scene.here, plan=plan, target=self._leg.goal, corner=self._leg.stop)

    def _trigger(self, committed: CommittedPath, question: StepQuestion, scene: Observation) -> Trigger | None:
        """The event that makes a new question necessary: that of the path, or a next step that fails its checks now."""
        sensed = {j: scene.seen(x) for j, x in scene.sensed.items()}
        trigger = committed.trigger(self._relative(question, scene), sensed)
        if trigger is not None:
            return trigger
        fit = self._verifier.waypoint(question, _shifted(committed.answer, scene.ahead))
        if isinstance(fit, NoAnswer):
            return Trigger.UNFIT
        slow = self._fallback != "hold" and self._pace.too_slow(question, fit) is not None
        return Trigger.UNFIT if slow else None

    def _move(
        self, answer: StepAnswer | NoAnswer, question: StepQuestion, scene: Observation, asked: Point | None
    ) -> list[Effect]:
        """The move for the planner's waypoint, which was `asked` before it was clipped."""
        fit = self._verifier.waypoint(question, answer)
        if isinstance(fit, NoAnswer):
            return self.hold(scene, fit.cause, fit.reason, asked)
        corner = question.corner
        reaches = corner is not None and math.dist(scene.position, corner) <= question.mission.max_step
        if corner is not None and reaches and math.dist(fit, corner) <= self._tolerance:
            fit = corner  # a little beside it, the way on may not be free, and the next question would be the same
        chosen = Origin.MODEL if fit == asked else Origin.CLIPPED
        by_geometry = isinstance(answer, StepAnswer) and answer.by == "geometry"
        effects = self._fly(fit, scene, asked, Origin.GEOMETRY if by_geometry else chosen)
        if fit != asked:
            effects.insert(0, Note("clipped", {"proposed": asked, "flown": fit}))
        if self._committed is not None:
            flown = effects[-1]
            assert isinstance(flown, MoveTo)
            self._committed = self._committed.after_step(scene.here, moved(flown.waypoint, scene.ahead, -1.0))
        return effects

    def _fly(self, wish: Point, scene: Observation, asked: Point | None, origin: Origin) -> list[Effect]:
        """The safe move for a waypoint of this origin."""
        assert self._leg is not None, "a robot flies to a goal"
        flight = self._safety.step(
            scene.position,
            scene.sensed,
            wish,
            self._leg,
            self._tolerance,
            scene.drift,
            scene.courses,
            scene.still,
            scene.period,
        )
        if flight.origin is Origin.YIELD or (flight.origin is not Origin.MODEL and origin is not Origin.GEOMETRY):
            origin = flight.origin
        return [*flight.notes, MoveTo(waypoint=flight.waypoint, proposed=asked, origin=origin)]


def _shifted(answer: StepAnswer, by: Point, share: float = 1.0) -> StepAnswer:
    """The same waypoints in a frame displaced by `share` times `by`."""
    if not by:
        return answer
    path = tuple(moved(x, by, share) for x in answer.path)
    return replace(answer, waypoint=moved(answer.waypoint, by, share), path=path)
