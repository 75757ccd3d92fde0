"""Checks of waypoints before they are flown, and clipping of those that fail: advice, not safety."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache

from llm_flock.arrays import Point, between, flattened
from llm_flock.mission import Mission
from llm_flock.obstacles import nearest_on_segment
from llm_flock.planner import StepAnswer, StepQuestion
from llm_flock.protocol._verification.plans import LENGTH_TOLERANCE, ROUNDING, at_text, number_text, outside


class Fault(StrEnum):
    """A rule that a waypoint violates; `step_faults` lists them."""

    FORM = "form"
    LENGTH = "length"
    SEPARATION = "separation"
    ARENA = "arena"
    OVERSHOOT = "overshoot"
    PROGRESS = "progress"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The reason to ask the model again, None for an answer that fits; and the step to fly, clipped if need be."""

    reason: str | None
    fit: StepAnswer | None


def step_faults(question: StepQuestion, waypoint: Point) -> dict[Fault, str]:
    """All faults of a waypoint, each with the reason for the model.

    - form: not a finite point of the mission's dimension; nothing else is checked then.
    - length: farther than `max_step`, with a tolerance for printed decimals.
    - separation: nearer than `safe_distance` to the observed position of another robot, unless that robot is already
      too near and the step leads away from it.
    - arena: outside, and farther outside than the robot already is.
    - overshoot: the step passes the goal.
    - progress: no nearer to the goal than before. A step that ends at the goal needs no progress, and a robot whose
      straight path is blocked (`blocked`) may go anywhere: it neither overshoots nor lacks progress.
    """
    mission = question.mission
    if len(waypoint) != mission.dim or not all(map(math.isfinite, waypoint)):
        return {Fault.FORM: f"the position must be {mission.dim} finite numbers"}
    faults: dict[Fault, str] = {}
    here, goal = question.position, question.goal
    near = ROUNDING * mission.spacing
    length = math.dist(here, waypoint)
    if length > mission.max_step * (1 + LENGTH_TOLERANCE):
        limit = number_text(mission.max_step)
        faults[Fault.LENGTH] = f"the position is {number_text(length)} from yours, {limit} is the step limit"
    too_near = _too_near(question, waypoint)
    if too_near is not None:
        gap, other = too_near
        faults[Fault.SEPARATION] = (
            f"the position is {number_text(gap)} from the robot at {at_text(other)}{mission.by_height}, "
            f"at least {number_text(mission.safe_distance)} is required"
        )
    out = outside(mission, waypoint)
    if out > near and out > outside(mission, here):
        corners = " to ".join(map(at_text, mission.arena))
        faults[Fault.ARENA] = f"the position is {number_text(out)} outside the arena from {corners}"
    before, after = math.dist(here, goal), math.dist(waypoint, goal)
    if after <= near or blocked(question):
        return faults
    past = _along(here, goal, waypoint) - before
    if past > near:
        faults[Fault.OVERSHOOT] = (
            f"the position is {number_text(past)} beyond your goal, which is {number_text(before)} away"
        )
    elif after > before - LENGTH_TOLERANCE * min(mission.max_step, before):
        faults[Fault.PROGRESS] = (
            f"the position is {number_text(after)} from your goal, no nearer than you are now ({number_text(before)})"
        )
    return faults


@lru_cache(maxsize=256)
def judge(question: StepQuestion, answer: StepAnswer, *, shield_on: bool) -> Verdict:
    """The verdict on an answer. Pure, and cached: planner and pilot read the same one.

    With a horizon of 1, the waypoint must have no faults. Each waypoint of a path is checked as a step from the one
    before, and the reason names the first that fails, counted from 1. Only the first must keep the separation, and with
    a shield not even that: later positions of the others are unknown, and every step passes through the shield.

    A waypoint that fails is clipped to the goal, the step limit and the arena. A path is cut into steps of the largest
    length, and ends at the goal; if that does not help, its first waypoint is clipped, and the rest is dropped.
    """
    reason = _objection(question, answer, shield_on=shield_on)
    if reason is None:
        return Verdict(reason=None, fit=answer)
    if question.horizon > 1:
        cut = _cut_path(question, answer)
        if cut is not None and _objection(question, cut, shield_on=shield_on) is None:
            return Verdict(reason=reason, fit=cut)
    waypoint = _clip(question, answer.waypoint, shield_on=shield_on)
    return Verdict(reason=reason, fit=None if waypoint is None else replace(answer, waypoint=waypoint, path=()))


def _objection(question: StepQuestion, answer: StepAnswer, *, shield_on: bool) -> str | None:
    """The reason to reject an answer as it is, or None."""
    if question.horizon == 1:
        faults = step_faults(question, answer.waypoint)
        return "; ".join(faults.values()) + "." if faults else None
    left_to_shield = {Fault.SEPARATION} if shield_on else set[Fault]()
    origin = ""
    for number, waypoint in enumerate((answer.waypoint, *answer.path), start=1):
        faults = step_faults(question, waypoint)
        reasons = [reason for fault, reason in faults.items() if fault not in left_to_shield]
        if reasons:
            return f"position {number} of the path{origin}: {'; '.join(reasons)}."
        question = replace(question, position=waypoint)
        left_to_shield = {Fault.SEPARATION}
        origin = f", counted from position {number} as yours"
    return None


def _cut_path(question: StepQuestion, answer: StepAnswer) -> StepAnswer | None:
    """The same way in steps of at most the largest length, up to the goal or the horizon; None for unusable points."""
    mission, here, goal, cut = question.mission, question.position, question.goal, list[Point]()
    for waypoint in (answer.waypoint, *answer.path):
        if len(waypoint) != mission.dim or not all(map(math.isfinite, waypoint)):
            return None
        ends = _along(here, goal, waypoint) >= math.dist(here, goal)
        target = goal if ends else waypoint
        while math.dist(here, target) > mission.max_step and len(cut) < question.horizon:
            here = towards(here, target, mission.max_step)
            cut.append(here)
        if len(cut) == question.horizon:
            break
        here = target
        cut.append(here)
        if ends:
            break
    return replace(answer, waypoint=cut[0], path=tuple(cut[1:]))


def towards(here: Point, target: Point, longest: float) -> Point:
    """The target, or the point a hair less than `longest` away towards it, so that rounding cannot exceed it."""
    far = math.dist(here, target)
    if far <= longest:
        return target
    return between(here, target, longest * (1 - 1e-12) / far)


def _clip(question: StepQuestion, waypoint: Point, *, shield_on: bool) -> Point | None:
    """A waypoint without faults but those of the shield: as it is, or clipped; None for a wrong direction."""
    mission, faults = question.mission, step_faults(question, waypoint)
    if not faults:
        return waypoint
    if Fault.FORM in faults:
        return None
    here, goal = question.position, question.goal
    target = goal if _along(here, goal, waypoint) >= math.dist(here, goal) else waypoint
    target = towards(here, target, mission.max_step)
    if outside(mission, here) == 0.0 and outside(mission, target) > ROUNDING * mission.spacing:
        low, high = mission.arena
        target = tuple(min(max(x, a), b) for a, x, b in zip(low, target, high, strict=True))
    left = step_faults(question, target).keys()
    return target if not left or (shield_on and left == {Fault.SEPARATION}) else None


def passing(mission: Mission, other: Point, here: Point, end: Point) -> float:
    """The distance at which a robot that flies straight from `here` to `end` passes one that stands [units]."""
    if mission.downwash != 1.0:
        other, here, end = map(tuple, flattened([other, here, end], mission.downwash).tolist())
    return math.dist(nearest_on_segment(other, here, end), other)


def blocked(question: StepQuestion) -> bool:
    """Whether one straight step towards the goal comes nearer than the safe distance to an observed robot."""
    mission, here, goal = question.mission, question.position, question.goal
    distance = math.dist(here, goal)
    share = min(1.0, mission.max_step / distance) if distance else 0.0
    end = between(here, goal, share)
    limit = mission.safe_distance + ROUNDING * mission.spacing
    return any(passing(mission, other, here, end) < limit for other in question.neighbors)


def _along(here: Point, goal: Point, point: Point) -> float:
    """Distance of a point along the direction to the goal [units]; its plain distance if the robot is at the goal."""
    distance = math.dist(here, goal)
    if distance == 0.0:
        return math.dist(here, point)
    return sum((g - x) * (p - x) for x, g, p in zip(here, goal, point, strict=True)) / distance


def _too_near(question: StepQuestion, waypoint: Point) -> tuple[float, Point] | None:
    """Distance and position of the nearest robot from which the waypoint is not separated."""
    mission, worst = question.mission, None
    safe = mission.safe_distance
    for other in question.neighbors:
        gap = mission.separation(waypoint, other)
        needed = min(safe, mission.separation(question.position, other)) - ROUNDING * safe
        if gap < needed and (worst is None or gap < worst[0]):
            worst = gap, other
    return worst
