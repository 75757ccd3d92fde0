"""How a robot flies: when it asks its planner, what it makes of the answer, and what its shield makes of that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import msgspec

from llm_flock.arrays import Point, moved
from llm_flock.metrics import AT_GOAL
from llm_flock.mission import Mission
from llm_flock.protocol.events import AskStep, Effect, MoveTo, Note, Origin
from llm_flock.protocol.motion.committed_path import HORIZON, CommittedPath, Reason
from llm_flock.protocol.motion.limits import Limits
from llm_flock.protocol.motion.safety import Safety
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, StepAnswer, StepQuestion
from llm_flock.protocol.verification.validator import Validator, fallback_notes


class Observation(msgspec.Struct, frozen=True, kw_only=True):
    """What a robot sees in a round.

    Attributes:
        round: number of the round.
        position: where it believes it is [units; world frame].
        sensed: believed positions of the robots within sensing range, by id [units; world frame].
        observed: positions to tell the planner.
        drift: how far the mission's frame has travelled [units]; empty where it stands still.
        ahead: the same for the end of the round, which is what goals are given for.
    """

    round: int
    position: Point
    sensed: Mapping[int, Point]
    observed: tuple[Point, ...]
    drift: Point = ()
    ahead: Point = ()

    def seen(self, point: Point) -> Point:
        """Something of now in the frame of the mission."""
        return moved(point, self.drift, -1.0)

    @property
    def here(self) -> Point:
        """The own position in the frame of the mission."""
        return self.seen(self.position)


class Pilot:
    """One robot's way, round by round.

    Args:
        robot: own id.
        mission: sets its limits.
        validator: checks what planners answer.
        shield_on: project every waypoint on the buffered Voronoi cell, and go round what blocks the way.
        noise_bound: largest error of a believed position [units].
        on_event: let the planner give a path, and ask it again only when something unforeseen happens.
    """

    def __init__(
        self, robot: int, mission: Mission, validator: Validator, *, shield_on: bool, noise_bound: float, on_event: bool
    ) -> None:
        self.on_path = False  # whether this round's step was foreseen, and nobody asked for it
        self._robot = robot
        self._validator = validator
        self._safety = Safety(robot, Limits.of(mission), noise_bound) if shield_on else None
        self._horizon = HORIZON if on_event else 1
        self._committed: CommittedPath | None = None
        self._question: StepQuestion | None = None
        self._scene: Observation | None = None
        self._aim: Point = ()

    def decide(
        self, scene: Observation, mission: Mission, plan: Plan, slot: int | None, target: Point | None
    ) -> list[Effect]:
        """The next step: as it was foreseen, or a question about it.

        Args:
            scene: what the robot sees.
            mission: what the planner is told, as it is at the end of the round.
            plan: the plan that is followed, in the frame of the mission.
            slot: own place in it; None for a spare.
            target: where to go instead of the own place, in the frame of the mission.
        """
        ahead = scene.ahead
        self._scene = scene
        self._aim = plan.points[slot or 0] if target is None else target
        self._question = StepQuestion(
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
            return [AskStep(self._question)]
        surprise = self._surprise(self._committed)
        self.on_path = surprise is None
        if surprise is None:
            return self._move(_shifted(self._committed.answer, ahead))
        return [Note("asked_again", {"reason": surprise.value}), AskStep(self._question)]

    def take(self, answer: StepAnswer | NoAnswer) -> list[Effect]:
        """An answer of the planner; where it may be a path, the robot remembers it."""
        question, scene = self._question, self._scene
        assert question is not None and scene is not None, "only a robot that asked is answered"
        if question.horizon > 1:
            kept = _shifted(answer, scene.ahead, -1.0) if isinstance(answer, StepAnswer) else answer
            self._committed = CommittedPath.of(self._relative, kept, scene.sensed)
        return self._move(answer)

    def hold(self, scene: Observation, cause: str, reason: str, asked: Point | None = None) -> list[Effect]:
        """Nothing to do, and why."""
        held = Note("held", {"cause": cause, "reason": reason})
        if self._safety is None:
            return [held, MoveTo(waypoint=scene.position, proposed=asked, origin=Origin.HOLD)]
        flight = self._safety.stay(scene.position, scene.sensed)
        return [held, *flight.notes, MoveTo(waypoint=flight.waypoint, proposed=asked, origin=flight.origin)]

    def look(self, scene: Observation) -> None:
        """Another look while the planner thinks."""
        self._scene = scene

    def forget(self) -> None:
        """What was foreseen is void."""
        self._committed, self.on_path = None, False

    @property
    def _relative(self) -> StepQuestion:
        """The question in the frame of the mission, in which a path leads to places that stand still."""
        question, scene = self._question, self._scene
        assert question is not None and scene is not None
        if not scene.ahead:
            return question
        plan = Plan.of(moved(x, scene.ahead, -1.0) for x in question.plan.points)
        return replace(question, position=scene.here, plan=plan, target=self._aim)

    def _surprise(self, committed: CommittedPath) -> Reason | None:
        """Why the planner must be asked again; a step that does not pass the checks any more is a reason as well."""
        question, scene = self._question, self._scene
        assert question is not None and scene is not None
        found = committed.surprise(self._relative, {j: scene.seen(x) for j, x in scene.sensed.items()})
        if found is not None:
            return found
        fit = self._validator.waypoint(question, _shifted(committed.answer, scene.ahead))
        return Reason.UNFIT if isinstance(fit, NoAnswer) else None

    def _move(self, answer: StepAnswer | NoAnswer) -> list[Effect]:
        question, scene = self._question, self._scene
        assert question is not None and scene is not None
        fit = self._validator.waypoint(question, answer)
        asked = answer.waypoint
        if isinstance(fit, NoAnswer):
            return self.hold(scene, fit.cause, fit.reason, asked)
        failure = answer.instead_of if isinstance(answer, StepAnswer) else None
        notes: list[Effect] = [*fallback_notes("step", "geometry", failure)]
        flown, origin = fit, Origin.MODEL
        if self._safety is not None:
            tolerance = AT_GOAL * question.mission.spacing
            flight = self._safety.step(scene.position, scene.sensed, fit, self._aim, tolerance, scene.drift)
            flown, origin = flight.waypoint, flight.origin
            notes.extend(flight.notes)
        if origin is Origin.MODEL and flown != asked:  # clipped to the goal or to the step limit
            notes.append(Note("shielded", {"proposed": asked, "flown": flown}))
            origin = Origin.SHIELD
        if failure is not None and origin is not Origin.DETOUR:
            origin = Origin.FALLBACK
        if self._committed is not None:
            self._committed = self._committed.flown(scene.here, moved(flown, scene.ahead, -1.0))
        return [*notes, MoveTo(waypoint=flown, proposed=asked, origin=origin)]


def _shifted(answer: StepAnswer, by: Point, share: float = 1.0) -> StepAnswer:
    """The same way in a frame that has travelled."""
    if not by:
        return answer
    path = tuple(moved(x, by, share) for x in answer.path)
    return replace(answer, waypoint=moved(answer.waypoint, by, share), path=path)
