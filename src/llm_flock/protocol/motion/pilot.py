"""One robot's flight: when it asks its planner, and how checks and shield turn the answer into a move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import msgspec

from llm_flock.arrays import Point, moved
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.protocol.events import AskStep, Effect, MoveTo, Note, Origin
from llm_flock.protocol.motion.committed_path import HORIZON, CommittedPath, Trigger
from llm_flock.protocol.motion.safety import Safety
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, StepAnswer, StepQuestion
from llm_flock.protocol.verification.validator import Validator, fallback_notes


class Observation(msgspec.Struct, frozen=True, kw_only=True):
    """Positions that a robot observes in a round.

    Attributes:
        position: the robot's believed position [units; world frame].
        sensed: believed positions of the robots within sensing range, by id [units; world frame].
        observed: positions of other robots for the planner's question [units; world frame].
        drift: displacement of the mission's frame so far [units]; empty if the mission stands still.
        ahead: displacement at the end of the round, for which goals are given [units]; empty as `drift`.
    """

    round: int
    position: Point
    sensed: Mapping[int, Point]
    observed: tuple[Point, ...]
    drift: Point = ()
    ahead: Point = ()

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
    """

    def __init__(
        self, robot: int, mission: Mission, validator: Validator, *, shield_on: bool, noise_bound: float, on_event: bool
    ) -> None:
        self.on_path = False
        self._robot = robot
        self._validator = validator
        self._safety = Safety(robot, mission, noise_bound) if shield_on else None
        self._horizon = HORIZON if on_event else 1
        self._committed: CommittedPath | None = None
        self._question: StepQuestion | None = None
        self._scene: Observation | None = None
        self._aim: Point = ()

    def decide(
        self, scene: Observation, mission: Mission, plan: Plan, slot: int | None, target: Point | None
    ) -> list[Effect]:
        """The next step of the committed path, or a question about it.

        The question has `mission` as it stands at the end of the round. `target` is a goal in place of the slot's
        place; both, and `plan`, are in the frame of the mission.
        """
        ahead = scene.ahead
        self._scene = scene
        self._aim = plan.points[slot or 0] if target is None else target
        question = self._question = StepQuestion(
            mission=mission,
            robot=self._robot,
            round=scene.round,
            position=scene.position,
            neighbors=scene.observed,
            plan=Plan.of(moved(x, ahead) for x in plan.points) if ahead else plan,
            slot=slot,
            target=None if target is None else moved(target, ahead),
            horizon=self._horizon,
        )
        if self._committed is None:
            self.on_path = False
            return [AskStep(question)]
        trigger = self._trigger(self._committed, question, scene)
        self.on_path = trigger is None
        if trigger is None:
            return self._move(_shifted(self._committed.answer, ahead), question, scene)
        return [Note("asked_again", {"reason": trigger.value}), AskStep(question)]

    def take(self, answer: StepAnswer | NoAnswer) -> list[Effect]:
        """The move that follows from the planner's answer. With `on_event`, the robot commits to its path."""
        question, scene = self._question, self._scene
        assert question is not None and scene is not None, "only a robot that asked is answered"
        if question.horizon > 1:
            kept = _shifted(answer, scene.ahead, -1.0) if isinstance(answer, StepAnswer) else answer
            self._committed = CommittedPath.of(self._relative(question, scene), kept, scene.sensed)
        return self._move(answer, question, scene)

    def hold(self, scene: Observation, cause: str, reason: str, asked: Point | None = None) -> list[Effect]:
        """Hold the position for a stated cause. With the shield on, still move away from a robot that is too near."""
        held = Note("held", {"cause": cause, "reason": reason})
        if self._safety is None:
            return [held, MoveTo(waypoint=scene.position, proposed=asked, origin=Origin.HOLD)]
        flight = self._safety.stay(scene.position, scene.sensed)
        return [held, *flight.notes, MoveTo(waypoint=flight.waypoint, proposed=asked, origin=flight.origin)]

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
        return replace(question, position=scene.here, plan=plan, target=self._aim)

    def _trigger(self, committed: CommittedPath, question: StepQuestion, scene: Observation) -> Trigger | None:
        """The event that makes a new question necessary: that of the path, or a next step that fails its checks now."""
        sensed = {j: scene.seen(x) for j, x in scene.sensed.items()}
        trigger = committed.trigger(self._relative(question, scene), sensed)
        if trigger is not None:
            return trigger
        fit = self._validator.waypoint(question, _shifted(committed.answer, scene.ahead))
        return Trigger.UNFIT if isinstance(fit, NoAnswer) else None

    def _move(self, answer: StepAnswer | NoAnswer, question: StepQuestion, scene: Observation) -> list[Effect]:
        fit = self._validator.waypoint(question, answer)
        asked = answer.waypoint
        if isinstance(fit, NoAnswer):
            return self.hold(scene, fit.cause, fit.reason, asked)
        failure = answer.instead_of if isinstance(answer, StepAnswer) else None
        notes: list[Effect] = [*fallback_notes("step", "geometry", failure)]
        flown, origin = fit, Origin.MODEL
        if self._safety is not None:
            flight = self._safety.step(
                scene.position, scene.sensed, fit, self._aim, AT_GOAL * question.mission.spacing, scene.drift
            )
            flown, origin = flight.waypoint, flight.origin
            notes.extend(flight.notes)
        if origin is Origin.MODEL and flown != asked:  # clipped to the goal or to the step limit
            notes.append(Note("shielded", {"proposed": asked, "flown": flown}))
            origin = Origin.SHIELD
        if failure is not None and origin is not Origin.DETOUR:
            origin = Origin.FALLBACK
        if self._committed is not None:
            self._committed = self._committed.after_step(scene.here, moved(flown, scene.ahead, -1.0))
        return [*notes, MoveTo(waypoint=flown, proposed=asked, origin=origin)]


def _shifted(answer: StepAnswer, by: Point, share: float = 1.0) -> StepAnswer:
    """The same waypoints in a frame displaced by `share` times `by`."""
    if not by:
        return answer
    path = tuple(moved(x, by, share) for x in answer.path)
    return replace(answer, waypoint=moved(answer.waypoint, by, share), path=path)
