"""What went wrong in a recorded trial, in which round and with whom, and what that robot and its model said."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from llm_flock.experiments.compare import TOLERANCE
from llm_flock.metrics import AT_GOAL, IN_SHAPE
from llm_flock.record.reader import RunRecord
from llm_flock.record.schema import SILENT, LlmEntry


@dataclass(frozen=True, slots=True, kw_only=True)
class Guilt:
    """A fault that explains why a trial went wrong.

    Attributes:
        sentence: what happened.
        round: when; None where it was not at any one time.
        entries: the question behind it and its retries; empty where no model was asked.
    """

    sentence: str
    round: int | None = None
    entries: tuple[LlmEntry, ...] = ()


def guilty(record: RunRecord) -> tuple[Guilt, ...]:
    """Everything that went wrong in a record, the worst first.

    That no model answered, or the budget ended; that two robots came too near; and the first that is true of: several
    plans, two robots with one goal, a robot away from its goal, a plan that is not the shape. Where nothing of all
    this is true, it took too long.
    """
    ending = next((found for find in (_plans, _goals, _away, _shape) if (found := find(record)) is not None), None)
    found = tuple(guilt for guilt in (_unanswered(record), _crash(record), ending) if guilt is not None)
    return found or (Guilt(sentence="It took too many rounds.", round=record.rounds),)


def _unanswered(record: RunRecord) -> Guilt | None:
    stopped = (record.result or {}).get("stopped")
    failed = [entry for entry in record.llm if entry.error is not None]
    if stopped not in ("no_answers", "budget", "failed") or not failed:
        return None
    entry = failed[-1]
    what = "The budget was used up" if stopped == "budget" else f"Robot {entry.robot} got no answer"
    # A call that the budget refused was never made: there is no conversation to show.
    thread = () if stopped == "budget" else _thread(record, entry)
    return Guilt(sentence=f"{what} in round {entry.round}: {entry.error}.", round=entry.round, entries=thread)


def _crash(record: RunRecord) -> Guilt | None:
    safe = float(record.mission.mission["safe_distance"]) - TOLERANCE
    for number, gaps in _closest(record.positions):
        if gaps.min() >= safe:
            continue
        first, second = (int(k) for k in np.unravel_index(int(gaps.argmin()), gaps.shape))
        what = f"robots {first} and {second} came within {gaps[first, second]:.2f} units of each other"
        if number == 0:
            return Guilt(sentence=f"At the start, {what}.", round=0)
        moved = np.linalg.norm(record.positions[number] - record.positions[number - 1], axis=1)
        state = record.states[number]
        pair = sorted((first, second), key=lambda k: (state.origins[k] != "model", -float(moved[k])))
        entry = _last(record, pair[0], "step", number)
        thread = () if entry is None else _thread(record, entry)
        return Guilt(
            sentence=f"In round {number}, {what}; robot {pair[0]} moved {moved[pair[0]]:.2f} units.",
            round=number,
            entries=thread,
        )
    return None


def _closest(positions: NDArray[np.float64]) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """For each round, the smallest distance of every pair while moving; each pair once, infinite elsewhere."""
    away = np.tril(np.full((positions.shape[1], positions.shape[1]), np.inf))
    for number, after in enumerate(positions):
        before = positions[max(0, number - 1)]
        start = before[:, None] - before[None, :]
        way = after[:, None] - after[None, :] - start
        length = (way**2).sum(axis=-1)
        share = np.clip(-(start * way).sum(axis=-1) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        yield number, np.linalg.norm(start + share[..., None] * way, axis=-1) + away


def _plans(record: RunRecord) -> Guilt | None:
    state = record.states[-1]
    awake = _awake(record)
    without = [robot for robot in awake if state.plan_ids[robot] is None]
    if without:
        entry = _last(record, without[0], "plan", record.rounds)
        thread = () if entry is None else _thread(record, entry)
        return Guilt(sentence=f"Robot {without[0]} had no plan at the end.", round=record.rounds, entries=thread)
    counts = Counter(state.plan_ids[robot] for robot in awake)
    if len(counts) < 2:
        return None
    rarest = min(awake, key=lambda robot: (counts[state.plan_ids[robot]], -robot))
    sentence = f"At the end {len(counts)} plans were in use among {len(awake)} robots"
    return _of_plan(record, state.plan_ids[rarest], f"{sentence}; robot {rarest} followed")


def _goals(record: RunRecord) -> Guilt | None:
    state = record.states[-1]
    heading = [robot for robot in _awake(record) if state.slots[robot] is not None]
    counts = Counter(state.slots[robot] for robot in heading)
    shared = [robot for robot in heading if counts[state.slots[robot]] > 1]
    if not shared:
        return None
    slot = state.slots[shared[0]]
    rivals = [robot for robot in shared if state.slots[robot] == slot]
    names = " and ".join(map(str, rivals))
    robot = max(rivals, key=lambda k: _distance(record, k))
    entry = _last(record, robot, "plan", record.rounds) or _last(record, robot, "step", record.rounds)
    return Guilt(
        sentence=f"At the end robots {names} headed for the same place, number {slot} of the plan.",
        round=record.rounds,
        entries=() if entry is None else _thread(record, entry),
    )


def _away(record: RunRecord) -> Guilt | None:
    heading = [robot for robot in _awake(record) if record.states[-1].goals[robot] is not None]
    robot = max(heading, key=lambda k: _distance(record, k), default=None)
    if robot is None or _distance(record, robot) <= AT_GOAL * float(record.mission.mission["spacing"]):
        return None
    entry = _last(record, robot, "step", record.rounds)
    return Guilt(
        sentence=f"At the end robot {robot} was {_distance(record, robot):.2f} units from its goal.",
        round=record.rounds,
        entries=() if entry is None else _thread(record, entry),
    )


def _shape(record: RunRecord) -> Guilt | None:
    error = record.errors[-1]
    if np.isnan(error) or error <= IN_SHAPE * float(record.mission.mission["spacing"]):
        return None
    plan = next((record.states[-1].plan_ids[robot] for robot in _awake(record)), None)
    return _of_plan(record, plan, f"Every robot is at its goal, {error:.2f} units from the ideal shape; they followed")


def _of_plan(record: RunRecord, plan: str | None, beginning: str) -> Guilt:
    info = next((info for info in record.plans if info.plan_id == plan), None)
    if info is None:
        return Guilt(sentence=f"{beginning} a plan that nobody proposed.", round=record.rounds)
    entry = _last(record, info.proposer, "plan", info.round)
    return Guilt(
        sentence=f"{beginning} the plan that robot {info.proposer} proposed in round {info.round}.",
        round=record.rounds,
        entries=() if entry is None else _thread(record, entry),
    )


def _awake(record: RunRecord) -> list[int]:
    phases = record.states[-1].phases
    return [robot for robot, phase in enumerate(phases) if phase not in SILENT]


def _distance(record: RunRecord, robot: int) -> float:
    goal = record.states[-1].goals[robot]
    return 0.0 if goal is None else float(np.linalg.norm(record.positions[-1][robot] - np.array(goal)))


def _last(record: RunRecord, robot: int, kind: str, up_to: int) -> LlmEntry | None:
    """The robot's last call of a kind, not after a round: a path is flown for rounds without another call."""
    found = [e for e in record.llm if e.robot == robot and e.kind == kind and e.round <= up_to]
    return found[-1] if found else None


def _thread(record: RunRecord, entry: LlmEntry) -> tuple[LlmEntry, ...]:
    """A call, and what was asked of this robot for the same purpose in the same round."""
    same: Sequence[LlmEntry] = [
        e for e in record.llm if (e.robot, e.round, e.kind) == (entry.robot, entry.round, entry.kind)
    ]
    return tuple(same)
