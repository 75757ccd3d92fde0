"""A simulated model in place of a provider's: it reads the prompt, and answers in prose or in JSON.

Limits, retries, records and replay treat it as any other model. All results say that they are simulated.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace

import numpy as np

from llm_flock.arrays import Point
from llm_flock.errors import InputError, ModelError
from llm_flock.llm._answer_forms import REASONING
from llm_flock.llm._port import Call, CallSettings, Reply, Usage
from llm_flock.llm._simulated.avoidance import clear_of_robots, keeps_away, step_aside
from llm_flock.llm._simulated.profiles import FAILURES, Profile
from llm_flock.llm._simulated.prompt_reader import (
    PLAN_MARK,
    STEP_MARK,
    StepPrompt,
    Task,
    clear_of_obstacles,
    formation,
    numbers,
    read_plan,
    read_step,
    read_still,
    read_task,
    read_ways,
    sensible_decimals,
)
from llm_flock.mission import ORIENTATIONS
from llm_flock.protocol._geometry import turned

CHARS_PER_TOKEN = 4
"""Tokens are only estimated here."""

LATER = 4
"""Number of failures that were added after the first results were published, the last ones of `FAILURES`."""

CHANCE_WITHIN = 10.0
"""Coordinates by chance are at most this far from the centre [spacings] or the own position [step limits]."""

LATENCIES = {"slow": (1.0, 0.5), "brisk": (0.3, 0.6)}
"""Median latency [s] and standard deviation of its logarithm, for each profile that only delays answers."""


class Responder:
    """One simulated model: text in, text out.

    The same conversation with the same chance gives the same answers.
    """

    def __init__(self, profile: Profile, rng: np.random.Generator) -> None:
        self._rates = [profile.rates.get(name, 0.0) for name in FAILURES]
        self._always_right = not any(self._rates)
        self._rng = rng

    def draw(self) -> frozenset[str]:
        """Draw the failures of the next call."""
        if self._always_right:
            return frozenset()
        # One draw for each failure, whatever its rate: changing one rate does not shift the others' chance.
        chance = self._rng.random(len(FAILURES) - LATER).tolist()
        # Those added after published results draw only where they are on, so that these stay reproducible.
        chance += [float(self._rng.random()) if rate else 1.0 for rate in self._rates[-LATER:]]
        return frozenset(name for name, x, rate in zip(FAILURES, chance, self._rates, strict=True) if x < rate)

    def latency_s(self, profile: str = "slow") -> float:
        """Draw the latency of an answer, for a profile in LATENCIES [s]."""
        median, spread = LATENCIES[profile]
        return median * float(self._rng.lognormal(0.0, spread))

    def fault(self, robot: int) -> ModelError:
        """Draw the error of a flaky provider."""
        return (
            ModelError("rate_limit", f"simulated 429 for robot {robot}", retry_after_s=0.02),
            ModelError("server", f"simulated 500 for robot {robot}"),
            ModelError("timeout", f"simulated time-out for robot {robot}"),
        )[int(self._rng.integers(3))]

    def answer(self, conversation: Sequence[tuple[str, str]], failures: frozenset[str] | None = None) -> str:
        """The answer to the last question of a conversation of (role, text); failures are drawn if left out.

        Raises:
            InputError: for field `prompts`: the question is not in the words of the packaged templates.
        """
        if failures is None:
            failures = self.draw()
        system = next((text for role, text in conversation if role == "system"), "")
        # After a rejected answer, the question is not the last message.
        for role, text in reversed(conversation):
            ways = read_ways(text) if role == "user" else []
            if ways:
                return self._letter(ways, failures)
            if role == "user" and STEP_MARK in text:
                return self._step(read_task(system), read_step(text), failures)
            if role == "user" and PLAN_MARK in text:
                task = read_task(system)
                still = read_still(text, len(task.center)) if "careful" in failures else []
                return self._plan(task, *read_plan(text), failures, still)
        last = conversation[-1][1] if conversation else ""
        raise InputError("prompts", last[:80], "plan.j2 and step.j2 in the packaged words, the only ones understood")

    def _letter(self, ways: Sequence[str], failures: frozenset[str]) -> str:
        """The first way whatever the wish, for a stand-in reads no words; some failures change it."""
        if "malformed" in failures:
            return "I would rather not say."
        return ways[int(self._rng.integers(len(ways)))] if "random" in failures else ways[0]

    def _plan(
        self, task: Task, robot: int, as_json: bool, failures: frozenset[str], still: Sequence[Point] = ()
    ) -> str:
        angle_rad, points = self._rng.uniform(0.0, 2 * math.pi), formation(task)
        for k in range(ORIENTATIONS if task.obstacles or still else 1):
            points = turned(formation(task), task.center, angle_rad + 2 * math.pi * k / ORIENTATIONS)
            if clear_of_obstacles(points, task) and clear_of_robots(points, still, task.safe_distance):
                break
        if "distorted" in failures:
            stretch = self._rng.uniform(0.6, 1.4, len(task.center))
            noise = self._rng.normal(0.0, 0.2 * task.spacing, points.shape)
            points = task.center + (points - task.center) * stretch + noise
        index, cut = robot % task.n_places, False
        if "random" in failures:
            points = task.center + self._rng.uniform(-CHANCE_WITHIN, CHANCE_WITHIN, points.shape) * task.spacing
            index = int(self._rng.integers(task.n_places))
        rows: list[list[float]] = points.round(sensible_decimals(task.spacing)).tolist()
        if "malformed" in failures:
            match int(self._rng.integers(5)):
                case 0:
                    return "I would rather not commit myself to a formation before I know more about the others."
                case 1:
                    rows = rows[:-1]
                case 2:
                    index = task.n_places
                case 3:
                    rows[0][0] = math.nan
                case _:
                    cut = True
        reason = (
            f"The shape is {task.shape[:200]}. I put its {task.n_places} places around the centre, "
            f"{task.spacing:g} apart, turn it by {math.degrees(angle_rad):.0f} degrees, "
            f"and take the place with my own number."
        )
        if as_json:
            said = json.dumps({REASONING: reason, "plan": rows, "my_plan": index})
        else:
            said = f"{reason}\n\nPlan: {rows}\nmy plan: {index}"
        return said[: len(said) * 2 // 3] if cut else said

    def _step(self, task: Task, prompt: StepPrompt, failures: frozenset[str]) -> str:
        waypoint, reason, last = self._waypoint(task, prompt, failures)
        path = [waypoint]
        while not last and len(path) < prompt.horizon:
            there = replace(prompt, position=numbers(path[-1]))
            waypoint, _, last = self._waypoint(task, there, failures)
            path.append(waypoint)
        if len(path) > 1:
            reason += f" In the same way I go on, {len(path)} positions in all."
        if "malformed" in failures:
            return self._malformed_step(prompt, path)
        if prompt.json:
            return f'{{"{REASONING}": {json.dumps(reason)}, {_stated(prompt, path)[1:]}'
        return f"{reason}\n\n{_stated(prompt, path)}"

    def _waypoint(self, task: Task, prompt: StepPrompt, failures: frozenset[str]) -> tuple[str, str, bool]:
        """The next waypoint, the reason for it, and whether the path ends there."""
        if "random" in failures:
            here = np.array(prompt.position)
            there = here + self._rng.uniform(-CHANCE_WITHIN, CHANCE_WITHIN, here.shape) * task.max_step
            said: list[float] = there.round(sensible_decimals(task.max_step)).tolist()
            return repr(said), "I go somewhere.", True
        if failures - {"careful"}:
            return self._faulty_step(task, prompt, failures)
        if "careful" in failures:
            aside = self._aside(task, prompt)
            if aside is not None:
                return aside
        if math.dist(prompt.position, prompt.goal) <= _reach(task):
            return prompt.goal_text, "I reach my goal within one step, so I go exactly there.", True
        waypoint = repr(list(_towards(prompt.goal, task, prompt)))
        return waypoint, "My goal is farther away than one step, so I take a full step straight towards it.", False

    def _aside(self, task: Task, prompt: StepPrompt) -> tuple[str, str, bool] | None:
        """A step aside where the straight one ends too near to another robot, or none; None where it does not."""
        here, goal = prompt.position, prompt.goal
        others, reach, places = prompt.seen(), _reach(task), sensible_decimals(task.max_step)
        arrives = math.dist(here, goal) <= reach
        end = goal if arrives else _towards(goal, task, prompt)
        if keeps_away(here, end, others, task.safe_distance):
            return None
        there = step_aside(here, goal, others, reach=reach, safe_distance=task.safe_distance, decimals=places)
        if there is None:
            return repr([round(x, places) for x in here]), "Others are in my way on all sides, so I wait.", True
        return repr(list(there)), "Another robot is in my way, so I step aside or shorter.", False

    def _faulty_step(self, task: Task, prompt: StepPrompt, failures: frozenset[str]) -> tuple[str, str, bool]:
        """A step with a wrong target, of a wrong length, or both."""
        target, reason = prompt.goal, "I head for my goal"
        if "collapse" in failures:
            seen = [prompt.position, *prompt.seen()]
            target = tuple(sum(values) / len(seen) for values in zip(*seen, strict=True))
            reason = "I keep to the middle of the robots around me"
        distance = math.dist(prompt.position, target)
        if "overshoot" in failures:
            if distance < 1e-9:
                angle_rad = self._rng.uniform(0.0, 2 * math.pi)
                x, y, *rest = prompt.position
                target = (x + math.cos(angle_rad), y + math.sin(angle_rad), *rest)
            reason += f" and move {task.max_step:g} units"
        elif "overlong" in failures and distance > _reach(task):
            far = tuple(
                x + 3.0 * _reach(task) * (t - x) / distance for x, t in zip(prompt.position, target, strict=True)
            )
            return repr([round(x, sensible_decimals(task.max_step)) for x in far]), reason + " in one leap.", True
        elif distance <= _reach(task):
            places = sensible_decimals(task.max_step)
            exact = prompt.goal_text if target == prompt.goal else repr([round(x, places) for x in target])
            return exact, reason + ".", True
        return repr(list(_towards(target, task, prompt))), reason + ".", distance <= _reach(task)

    def _malformed_step(self, prompt: StepPrompt, path: list[str]) -> str:
        *before, waypoint = path
        return (
            "It depends on what the others are going to do; I will wait and see.",
            _stated(prompt, [*before, waypoint[:-1] + ", 0.0, 1.0]"]),
            _stated(prompt, [*before, "[NaN, " + waypoint.partition(", ")[2]]),
            _stated(prompt, path)[: len(waypoint)],
            _stated(prompt, [*before, waypoint[:-1] + " + 0.5]"]),
        )[int(self._rng.integers(5))]


def _stated(prompt: StepPrompt, path: Sequence[str]) -> str:
    """Waypoints in the form that the prompt asks for."""
    if prompt.horizon == 1:
        return f'{{"position": {path[0]}}}' if prompt.json else f"Position: {path[0]}"
    rows = ", ".join(path)
    return f'{{"path": [{rows}]}}' if prompt.json else f"Path: [{rows}]"


def _reach(task: Task) -> float:
    """Longest stated step: the step limit less what rounding of the printed position may add."""
    return task.max_step - max(1e-6, 10.0 ** -(sensible_decimals(task.max_step) + 1))


def _towards(target: Point, task: Task, prompt: StepPrompt) -> Point:
    """A full step towards a target, each coordinate rounded back towards the own position."""
    share = _reach(task) / math.dist(prompt.position, target)
    scale = 10 ** sensible_decimals(task.max_step)
    return tuple(
        (math.floor if t > x else math.ceil)((x + share * (t - x)) * scale) / scale
        for x, t in zip(prompt.position, target, strict=True)
    )


class SimulatedModel:
    """A `LanguageModel`, named `simulated:PROFILE`. It costs nothing and needs no network."""

    def __init__(
        self,
        profile: Profile,
        rng: np.random.Generator,
        settings: CallSettings | None = None,
        *,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.name = f"simulated:{profile.text}"
        self._responder = Responder(profile, rng)
        self._settings = (settings or CallSettings()).plain()
        self._sleep = sleep

    async def ask(self, call: Call) -> Reply:
        """Answer one call; settings and schema change nothing, for the prompt says it all.

        Raises:
            ModelError: the failure `flaky`.
            InputError: for field `prompts`: the question is not in the words of the packaged templates.
        """
        started = time.perf_counter()
        failures = self._responder.draw()
        for profile in LATENCIES.keys() & failures:
            await self._sleep(self._responder.latency_s(profile))
        if "flaky" in failures:
            raise self._responder.fault(call.robot)
        text = self._responder.answer([(message.role, message.text) for message in call.messages], failures)
        return Reply(
            text=text,
            model=self.name,
            settings=self._settings,
            usage=Usage(input=_tokens(sum(len(said.text) for said in call.messages)), output=_tokens(len(text))),
            cost_usd=0.0,
            latency_s=time.perf_counter() - started,
            finish_reason="stop",
        )


def _tokens(chars: int) -> int:
    return -(-chars // CHARS_PER_TOKEN)
