"""One robot's flight: decides when to ask the planner, and turns checked and shielded answers into moves."""

from __future__ import annotations

import math
from dataclasses import replace

from llm_flock.arrays import Point, moved
from llm_flock.events import AskStep, Effect, MoveTo, Note, Origin
from llm_flock.message import Course
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, StepAnswer, StepQuestion
from llm_flock.protocol._breaker import BreakerState, CircuitBreaker, Fallback, fallback_notes
from llm_flock.protocol._geometry import straight_path
from llm_flock.protocol._motion.committed_path import HORIZON, CommittedPath, Trigger
from llm_flock.protocol._motion.leg import Leg, Pace, leg_to
from llm_flock.protocol._parts import Observation, Parts
from llm_flock.protocol._verification.steps import towards


class Pilot:
    """Flies one robot, round by round: call `decide` in each round with a goal, or `hold` in a round without one.

    `decide` may return a question: call `take` with its answer, and `look` when positions are updated in between. With
    `on_event`, the planner gives a path and is asked again only on a `Trigger`; `on_path` says whether this round's
    step comes from it.
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
        # Of the round.
        self._question: StepQuestion
        self._scene: Observation
        self._leg: Leg

    def decide(
        self, scene: Observation, mission: Mission, plan: Plan, slot: int | None, target: Point | None
    ) -> list[Effect]:
        """The next step of the committed path, or a question with `mission` as it stands at the end of the round.

        `target` is a goal in place of the slot's place; both, and `plan`, are in the frame of the mission.
        """
        ahead = scene.ahead
        self._begin(scene, mission, plan.points[slot or 0] if target is None else target)
        self._question = StepQuestion(
            mission=mission,
            robot=self._robot,
            round=scene.round,
            position=scene.position,
            neighbors=scene.observed,
            plan=plan.mapped(ahead),
            slot=slot,
            target=None if target is None else moved(target, ahead),
            corner=None if self._leg.stop == self._leg.goal else moved(self._leg.stop, ahead),
            horizon=self._horizon,
        )
        committed, notes = self._committed, list[Effect]()
        self.on_path = False
        if committed is not None:
            step = self._next_step(committed)
            if not isinstance(step, Trigger):
                self.on_path = True
                return self._move(step, moved(committed.path[0], ahead))
            notes = [Note("asked_again", {"reason": step.value})]
        if not self.breaker.asks(scene.round):
            return self._by_geometry()
        if self.breaker.state is BreakerState.HALF_OPEN:
            self._question = replace(self._question, probe=True)
        return [*notes, AskStep(self._question)]

    def _begin(self, scene: Observation, mission: Mission, goal: Point) -> None:
        """Begin a round with a goal in the frame of the mission."""
        self._scene, self._tolerance = scene, AT_GOAL * mission.spacing
        self._leg = leg_to(mission, scene.position, goal, scene.drift, scene.ahead, scene.still, self._noise)

    def take(self, answer: StepAnswer | NoAnswer) -> list[Effect]:
        """The move that follows from the planner's answer. With `on_event`, the robot commits to its path."""
        scene, asked, notes = self._scene, answer.waypoint, list[Effect]()
        if self._fallback == "hold":
            step = self._waypoint(answer)
        else:
            answer = self._check_answer(answer)
            if isinstance(answer, NoAnswer):
                notes = [*self.breaker.refused(scene.round, answer)]
                if self._fallback == "geometry" or self.breaker.is_open:
                    notes.extend(fallback_notes("step", "geometry", answer))
                    return [*notes, *self._by_geometry(asked)]
                self._pace.held()
                step = self._waypoint(answer)
            else:
                notes, step = [*self.breaker.usable()], answer.waypoint
        if self._horizon > 1:
            kept = _shift(answer, scene.ahead, -1.0) if isinstance(answer, StepAnswer) else answer
            self._committed = CommittedPath.of(self._relative(), kept, scene.sensed)
        by_geometry = isinstance(answer, StepAnswer) and answer.by == "geometry"
        return [*notes, *self._move(step, asked, by_geometry=by_geometry)]

    def _check_answer(self, answer: StepAnswer | NoAnswer) -> StepAnswer | NoAnswer:
        """The answer, clipped if that suffices, or the reason why it cannot be used."""
        if isinstance(answer, NoAnswer):
            return answer
        verdict = self._verifier.judge(self._question, answer)
        if verdict.fit is None:
            return NoAnswer(cause="unverified", reason=verdict.reason or "")
        slow = self._pace.too_slow(self._question, verdict.fit.waypoint, self._room)
        return verdict.fit if slow is None else NoAnswer(cause="slow", reason=slow)

    def _room(self) -> float:
        """How far the others let this robot fly straight to its next stop now [units]."""
        return self._safety.room(self._scene, self._leg)

    def _waypoint(self, answer: StepAnswer | NoAnswer) -> Point | NoAnswer:
        """The first waypoint, or else the last rejected one, if it passes as a single step; otherwise no answer."""
        if isinstance(answer, NoAnswer) and (answer.waypoint is None or not self._verifier.verify):
            return answer
        assert answer.waypoint is not None, "an answer has a waypoint"
        verdict = self._verifier.judge(replace(self._question, horizon=1), StepAnswer(waypoint=answer.waypoint))
        if verdict.fit is not None:
            return verdict.fit.waypoint
        return answer if isinstance(answer, NoAnswer) else NoAnswer(cause="unverified", reason=verdict.reason or "")

    def _by_geometry(self, asked: Point | None = None) -> list[Effect]:
        """A straight step to the goal in place of the planner's."""
        self._committed = None
        return self._fly(straight_path(self._question).waypoint, asked, Origin.GEOMETRY)

    def seek(self, scene: Observation, mission: Mission, target: Point) -> list[Effect]:
        """Fly by geometry to a point where others will look for it [units; frame of the mission]."""
        self.forget()
        self._begin(scene, mission, target)
        return self._fly(
            towards(scene.position, moved(self._leg.stop, scene.ahead), mission.max_step), None, Origin.GEOMETRY
        )

    def hold(self, scene: Observation, cause: str, reason: str, asked: Point | None = None) -> list[Effect]:
        """Hold the position for a stated cause. With the shield on, still move away from a robot that is too near."""
        held = Note("held", {"cause": cause, "reason": reason})
        flight = self._safety.stay(scene)
        return [held, *flight.notes, MoveTo(waypoint=flight.waypoint, proposed=asked, origin=flight.origin)]

    def rest(self, scene: Observation) -> list[Effect]:
        """What to do in a round in which the whole team stands still; empty in other rounds."""
        if not self._safety.rests(scene.round):
            return []
        held = Note("held", {"cause": "sensing", "reason": "all stand still until their sensors have seen it"})
        return [held, MoveTo(waypoint=scene.position, proposed=None, origin=Origin.HOLD)]

    def resting(self, scene: Observation) -> tuple[Obstacle, ...]:
        """As `Safety.resting`. Call before the round's step."""
        return self._safety.resting(scene)

    @property
    def course(self) -> Course | None:
        """The way that this robot asks others to leave free, in its last step."""
        return self._safety.course

    def begin_mission(self) -> None:
        """Begin another mission: heed all requests for a way again."""
        self._safety.begin_mission()

    def look(self, scene: Observation) -> None:
        """Replace the observation while the planner's answer is pending."""
        self._scene = scene

    def forget(self) -> None:
        """Drop the committed path, as for a robot that has no goal."""
        self._committed, self.on_path = None, False

    def _relative(self) -> StepQuestion:
        """The question in the frame of the mission, in which places stand still."""
        question, scene = self._question, self._scene
        if not scene.ahead:
            return question
        plan = question.plan.mapped(tuple(-x for x in scene.ahead))
        return replace(question, position=scene.here, plan=plan, target=self._leg.goal, corner=self._leg.stop)

    def _next_step(self, committed: CommittedPath) -> Point | Trigger:
        """The next step of the path, or the event that makes a new question necessary, such as a failed check."""
        scene = self._scene
        trigger = committed.trigger(self._relative(), {j: scene.seen(x) for j, x in scene.sensed.items()})
        if trigger is not None:
            return trigger
        step = self._waypoint(StepAnswer(waypoint=moved(committed.path[0], scene.ahead)))
        if isinstance(step, NoAnswer):
            return Trigger.UNFIT
        slow = self._fallback != "hold" and self._pace.too_slow(self._question, step, self._room) is not None
        return Trigger.UNFIT if slow else step

    def _move(self, step: Point | NoAnswer, asked: Point | None, *, by_geometry: bool = False) -> list[Effect]:
        """The move for a step that passed the checks; `asked` is the planner's own. Without a step, the robot holds."""
        scene, question = self._scene, self._question
        if isinstance(step, NoAnswer):
            return self.hold(scene, step.cause, step.reason, asked)
        corner = question.corner
        reaches = corner is not None and math.dist(scene.position, corner) <= question.mission.max_step
        if corner is not None and reaches and math.dist(step, corner) <= self._tolerance:
            step = corner  # from a point beside it the way on may be blocked, and the next question would be the same
        chosen = Origin.MODEL if step == asked else Origin.CLIPPED
        effects = self._fly(step, asked, Origin.GEOMETRY if by_geometry else chosen)
        if step != asked:
            effects.insert(0, Note("clipped", {"proposed": asked, "flown": step}))
        if self._committed is not None:
            flown = effects[-1]
            assert isinstance(flown, MoveTo)
            self._committed = self._committed.after_step(scene.here, moved(flown.waypoint, scene.ahead, -1.0))
        return effects

    def _fly(self, wish: Point, asked: Point | None, origin: Origin) -> list[Effect]:
        """The safe move for a waypoint of this origin."""
        flight = self._safety.step(self._scene, wish, self._leg, self._tolerance)
        if flight.origin is Origin.YIELD or (flight.origin is not Origin.MODEL and origin is not Origin.GEOMETRY):
            origin = flight.origin
        return [*flight.notes, MoveTo(waypoint=flight.waypoint, proposed=asked, origin=origin)]


def _shift(answer: StepAnswer, by: Point, share: float = 1.0) -> StepAnswer:
    """The same waypoints in a frame displaced by `share` times `by`."""
    if not by:
        return answer
    path = tuple(moved(x, by, share) for x in answer.path)
    return replace(answer, waypoint=moved(answer.waypoint, by, share), path=path)
