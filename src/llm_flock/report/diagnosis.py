"""Finds what went wrong in a recorded trial: in which round, with which robot, and what its model was asked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from llm_flock.experiments.compare import TOLERANCE
from llm_flock.metrics import AT_GOAL, IN_SHAPE
from llm_flock.record.reader import RunRecord
from llm_flock.record.schema import SILENT, ChatLine, LlmEntry
from llm_flock.record.words import robots_text

LONGEST = 6000
"""Letters of a message that are shown at most."""


class Cause(NamedTuple):
    """Something that explains why a trial went wrong.

    Attributes:
        sentence: what happened.
        round: when; None where it was not at any one time.
        entries: the model call behind it and its retries; empty where no model was called.
    """

    sentence: str
    round: int | None = None
    entries: tuple[LlmEntry, ...] = ()

    @property
    def about(self) -> str:
        """Whose conversation it is, and when; empty without one."""
        if not self.entries:
            return ""
        last = self.entries[-1]
        question = {"plan": "asked for a plan", "step": "asked for its next step"}.get(last.kind, last.kind)
        return f"Robot {last.robot}, {question} in round {last.round}, {last.model}"

    @property
    def conversation(self) -> list[ChatLine]:
        """The last call with all messages before it, its answer, and with the role "verdict", what became of that."""
        if not self.entries:
            return []
        last = self.entries[-1]
        lines = [message.model_copy(update={"text": _short(message.text)}) for message in last.messages]
        if last.text is not None:
            lines.append(ChatLine(role="assistant", text=_short(last.text)))
        refused = f"The answer was not used: {last.rejected or last.error or 'no answer came'}"
        return [*lines, ChatLine(role="verdict", text=refused if last.parsed is None else "The answer was taken.")]


def find_causes(record: RunRecord) -> tuple[Cause, ...]:
    """Everything that went wrong in a record, the worst first.

    First, that no model answered, the budget ended, or no model gave an acceptable plan; then that two robots came too
    near; then the first of these that holds: several plans, two robots with one goal, a robot away from its goal, a
    plan that is not the shape; then whose model was no longer asked. Where nothing of all this holds, the run took too
    long.
    """
    ending = next((found for find in (_plans, _goals, _away, _shape) if (found := find(record)) is not None), None)
    causes = (_unanswered(record), _no_plan(record), _crash(record), ending, _contained(record))
    found = tuple(cause for cause in causes if cause is not None)
    return found or (Cause("It took too many rounds.", record.rounds),)


def _short(text: str) -> str:
    if len(text) <= LONGEST:
        return text
    half = LONGEST // 2
    return f"{text[:half]}\n[... {len(text) - 2 * half:,} letters left out ...]\n{text[-half:]}"


def _unanswered(record: RunRecord) -> Cause | None:
    stopped = (record.result or {}).get("stopped")
    failed = [entry for entry in record.llm if entry.error is not None]
    if stopped not in ("no_answers", "budget", "failed") or not failed:
        return None
    entry = failed[-1]
    what = "The budget was used up" if stopped == "budget" else f"Robot {entry.robot} got no answer"
    # A call that the budget refused was never made: there is no conversation to show.
    calls = () if stopped == "budget" else _last_calls(record, entry.robot, entry.kind, entry.round)
    return Cause(f"{what} in round {entry.round}: {entry.error}.", entry.round, calls)


def _no_plan(record: RunRecord) -> Cause | None:
    result = record.result or {}
    refused = [entry for entry in record.llm if entry.kind == "plan" and entry.rejected is not None]
    if result.get("stopped") != "no_plan" or not refused:
        return None
    entry = refused[-1]
    calls = _last_calls(record, entry.robot, "plan", entry.round)
    return Cause(f"No model proposed an acceptable plan; most often, {result.get('reason')}", entry.round, calls)


def _contained(record: RunRecord) -> Cause | None:
    opened = {e.robot: e for e in record.events if e.kind == "breaker" and e.detail.get("state") == "open"}
    open_now = [robot for robot, kinds in enumerate(record.states[-1].open_breakers) if kinds and robot in opened]
    if not open_now:
        return None
    event = opened[open_now[0]]
    sentence = f"At the end the models of {robots_text(open_now)} were no longer asked; robot {event.robot}'s because"
    kind = str(event.detail.get("question"))
    calls = _last_calls(record, event.robot, kind, event.round)
    return Cause(f"{sentence} {event.detail.get('reason')}", event.round, calls)


def _crash(record: RunRecord) -> Cause | None:
    safe = float(record.mission.mission["safe_distance"]) - TOLERANCE
    for number, gaps in _closest(record.positions):
        if gaps.min() >= safe:
            continue
        first, second = (int(k) for k in np.unravel_index(int(gaps.argmin()), gaps.shape))
        what = f"robots {first} and {second} came within {gaps[first, second]:.2f} units of each other"
        if number == 0:
            return Cause(f"At the start, {what}.", 0)
        moved = np.linalg.norm(record.positions[number] - record.positions[number - 1], axis=1)
        origins = record.states[number].origins
        robot = min(sorted((first, second)), key=lambda k: (origins[k] != "model", -float(moved[k])))
        sentence = f"In round {number}, {what}; robot {robot} moved {moved[robot]:.2f} units."
        return Cause(sentence, number, _last_calls(record, robot, "step", number))
    return None


def _closest(positions: NDArray[np.float64]) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """For each round, the smallest distance of every pair while moving; each pair once, infinite elsewhere."""
    away = np.tril(np.full((positions.shape[1], positions.shape[1]), np.inf))
    for number, after in enumerate(positions):
        before = positions[max(0, number - 1)]
        start = before[:, None] - before[None, :]
        motion = after[:, None] - after[None, :] - start
        length = (motion**2).sum(axis=-1)
        share = np.clip(-(start * motion).sum(axis=-1) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        yield number, np.linalg.norm(start + share[..., None] * motion, axis=-1) + away


def _plans(record: RunRecord) -> Cause | None:
    plan_ids = record.states[-1].plan_ids
    awake = _awake(record)
    without = next((robot for robot in awake if plan_ids[robot] is None), None)
    if without is not None:
        calls = _last_calls(record, without, "plan", record.rounds)
        return Cause(f"Robot {without} had no plan at the end.", record.rounds, calls)
    counts = Counter(plan_ids[robot] for robot in awake)
    if len(counts) < 2:
        return None
    rarest = min(awake, key=lambda robot: (counts[plan_ids[robot]], -robot))
    sentence = f"At the end {len(counts)} plans were in use among {len(awake)} robots"
    return _of_plan(record, plan_ids[rarest], f"{sentence}; robot {rarest} followed")


def _goals(record: RunRecord) -> Cause | None:
    slots = record.states[-1].slots
    heading = [robot for robot in _awake(record) if slots[robot] is not None]
    counts = Counter(slots[robot] for robot in heading)
    slot = next((slots[robot] for robot in heading if counts[slots[robot]] > 1), None)
    if slot is None:
        return None
    rivals = [robot for robot in heading if slots[robot] == slot]
    robot = max(rivals, key=lambda k: _distance(record, k))
    calls = _last_calls(record, robot, "plan", record.rounds) or _last_calls(record, robot, "step", record.rounds)
    names = " and ".join(map(str, rivals))
    sentence = f"At the end robots {names} headed for the same place, number {slot} of the plan."
    return Cause(sentence, record.rounds, calls)


def _away(record: RunRecord) -> Cause | None:
    heading = [robot for robot in _awake(record) if record.states[-1].goals[robot] is not None]
    robot = max(heading, key=lambda k: _distance(record, k), default=None)
    if robot is None or _distance(record, robot) <= AT_GOAL * float(record.mission.mission["spacing"]):
        return None
    sentence = f"At the end robot {robot} was {_distance(record, robot):.2f} units from its goal."
    return Cause(sentence, record.rounds, _last_calls(record, robot, "step", record.rounds))


def _shape(record: RunRecord) -> Cause | None:
    error = record.errors[-1]
    if np.isnan(error) or error <= IN_SHAPE * float(record.mission.mission["spacing"]):
        return None
    plan = next((record.states[-1].plan_ids[robot] for robot in _awake(record)), None)
    return _of_plan(record, plan, f"Every robot is at its goal, {error:.2f} units from the ideal shape; they followed")


def _of_plan(record: RunRecord, plan: str | None, beginning: str) -> Cause:
    info = next((info for info in record.plans if info.plan_id == plan), None)
    if info is None:
        return Cause(f"{beginning} a plan that nobody proposed.", record.rounds)
    sentence = f"{beginning} the plan that robot {info.proposer} proposed in round {info.round}."
    return Cause(sentence, record.rounds, _last_calls(record, info.proposer, "plan", info.round))


def _awake(record: RunRecord) -> list[int]:
    phases = record.states[-1].phases
    return [robot for robot, phase in enumerate(phases) if phase not in SILENT]


def _distance(record: RunRecord, robot: int) -> float:
    """Distance of a robot from its goal at the end [units]; 0 without a goal."""
    goal = record.states[-1].goals[robot]
    return 0.0 if goal is None else float(np.linalg.norm(record.positions[-1][robot] - np.array(goal)))


def _last_calls(record: RunRecord, robot: int, kind: str, up_to: int) -> tuple[LlmEntry, ...]:
    """The robot's last call of a kind up to a round, and its retries: a path is flown for rounds without a call."""
    calls = [entry for entry in record.llm if entry.robot == robot and entry.kind == kind and entry.round <= up_to]
    return tuple(entry for entry in calls if entry.round == calls[-1].round)
