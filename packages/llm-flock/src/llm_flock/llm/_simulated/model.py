"""A simulated model in place of a provider's: it reads the prompt, and answers in prose or in JSON.

Limits, retries, records and replay treat it as any other model. All results are marked as simulated.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace

import numpy as np

from llm_flock.arrays import Point, separation
from llm_flock.errors import InputError, ModelError
from llm_flock.llm._answer_forms import REASONING
from llm_flock.llm._port import Call, CallSettings, Reply, Usage
from llm_flock.llm._prompt_values import IN_PLACE
from llm_flock.llm._simulated.profiles import FAILURES, NOT_IN_STEPS, Profile
from llm_flock.llm._simulated.prompt_reader import (
    JUDGEMENT_MARK,
    PLAN_MARK,
    STEP_MARK,
    StepPrompt,
    Task,
    asks_for_program,
    formation,
    is_clear,
    named_figure,
    numbers,
    other_figures,
    read_judgement,
    read_plan,
    read_step,
    read_still,
    read_task,
    read_ways,
    sensible_decimals,
)
from llm_flock.llm._simulated.seen import AFTER_REJECTION, SEEN, is_retry, spoiled
from llm_flock.mission import ORIENTATIONS
from llm_flock.planner import best_option
from llm_flock.shapes import rotated

CHARS_PER_TOKEN = 4  # for an estimate of the tokens
ADDED_LATER = 14  # number of the last `FAILURES` that were added after the first results were published

CHANCE_WITHIN = 10.0
"""Largest distance of random coordinates from the centre [spacings] or the own position [step limits]."""

OPEN = {"path": "M0 0H4V-4H0", "fill": True}  # what a program draws with the fault `open`
CUT_OFF = frozenset({"cutoff", "rambling", "turns"})  # faults that a server reports by the reason why the answer ended

LATENCIES = {"slow": (1.0, 0.5), "brisk": (0.3, 0.6)}
"""Median latency [s] and standard deviation of its logarithm, for each profile that only delays answers."""

TURNS_DEG = (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75)
SHARES = (1.0, 0.75, 0.5, 0.25)
"""Directions of a step aside from the way to the goal, and parts of the longest step, in the order of preference."""


class SimulatedModel:
    """A `LanguageModel` named `simulated:PROFILE`; equal conversations and random generators give equal answers."""

    def __init__(
        self,
        profile: Profile,
        rng: np.random.Generator,
        settings: CallSettings | None = None,
        *,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.name = f"simulated:{profile.text}"
        self._rates = [profile.rates.get(name, 0.0) for name in FAILURES]
        self._seen = profile.seen
        self._rng = rng
        self._settings = (settings or CallSettings()).plain()
        self._sleep = sleep

    async def ask(self, call: Call) -> Reply:
        """Answer one call; ModelError for `flaky`, InputError for prompts that are not from the packaged templates."""
        started = time.perf_counter()
        talk = [(message.role, message.text) for message in call.messages]
        failures = self.draw() | self._draw_seen(talk)
        for profile in LATENCIES.keys() & failures:
            median, spread = LATENCIES[profile]
            await self._sleep(median * float(self._rng.lognormal(0.0, spread)))
        if "flaky" in failures:
            raise self._fault(call.robot)
        text = self.answer(talk, failures)
        return Reply(
            text=text,
            model=self.name,
            settings=self._settings,
            usage=Usage(input=_tokens(sum(len(message.text) for message in call.messages)), output=_tokens(len(text))),
            cost_usd=0.0,
            latency_s=time.perf_counter() - started,
            finish_reason="length" if failures & CUT_OFF else "stop",
        )

    def draw(self) -> frozenset[str]:
        """Draw the failures of the next call."""
        if not any(self._rates):
            return frozenset()
        # One draw for each failure at any rate, so that changing one rate does not shift the draws of the others.
        chance = self._rng.random(len(FAILURES) - ADDED_LATER).tolist()
        # Failures added after published results draw only with a rate, so that those results stay reproducible.
        chance += [float(self._rng.random()) if rate else 1.0 for rate in self._rates[-ADDED_LATER:]]
        return frozenset(name for name, x, rate in zip(FAILURES, chance, self._rates, strict=True) if x < rate)

    def _draw_seen(self, talk: Sequence[tuple[str, str]]) -> frozenset[str]:
        """Draw what the answer says wrong, if anything. First questions have all but what needs a rejected answer."""
        if not self._seen or self._rng.random() >= sum(self._seen.values()):
            return frozenset()
        rates = {name: rate for name, rate in self._seen.items() if is_retry(talk) or name not in AFTER_REJECTION}
        chance = np.array([*rates.values()])
        return frozenset([str(self._rng.choice([*rates], p=chance / chance.sum()))]) if rates else frozenset()

    def _fault(self, robot: int) -> ModelError:
        return (
            ModelError("rate_limit", f"simulated 429 for robot {robot}", retry_after_s=0.02),
            ModelError("server", f"simulated 500 for robot {robot}"),
            ModelError("timeout", f"simulated time-out for robot {robot}"),
        )[int(self._rng.integers(3))]

    def answer(self, conversation: Sequence[tuple[str, str]], failures: frozenset[str] | None = None) -> str:
        """The answer to the last question of a conversation of (role, text); failures are drawn if left out."""
        if failures is None:
            failures = self.draw() | self._draw_seen(conversation)
        for role, text in reversed(conversation):
            if role == "user" and JUDGEMENT_MARK in text:
                return self._judgement(text, failures)
        failures -= {"misjudge"}
        for fault in SEEN.keys() & failures:
            right = self.answer(conversation, failures - SEEN.keys())
            return spoiled(fault, right, conversation, self._rng)
        system = next((text for role, text in conversation if role == "system"), "")
        # After a rejected answer, the question is not the last message.
        for role, text in reversed(conversation):
            ways = read_ways(text) if role == "user" else []
            if ways:
                return self._letter(ways, failures)
            if role == "user" and STEP_MARK in text:
                return self._step(read_step(text, read_task(system)), failures)
            if role == "user" and PLAN_MARK in text:
                task = read_task(system)
                still = read_still(text, len(task.center)) if "careful" in failures else []
                if asks_for_program(text):
                    return self._program(task, read_plan(text)[0], failures)
                return self._plan(task, *read_plan(text), failures, still)
        last = conversation[-1][1] if conversation else ""
        raise InputError("prompts", last[:80], "plan.j2 and step.j2 in the packaged words, the only ones understood")

    def _letter(self, ways: Sequence[str], failures: frozenset[str]) -> str:
        """The first way, except for some failures. A stand-in does not read the wish."""
        if "malformed" in failures:
            return "I would rather not say."
        return ways[int(self._rng.integers(len(ways)))] if "random" in failures else ways[0]

    def _judgement(self, text: str, failures: frozenset[str]) -> str:
        """The right option by the figures in the prompt, except for some failures."""
        if "malformed" in failures:
            return "That depends on what the others choose."
        options, aim, as_json = read_judgement(text)
        choice = best_option(options, aim)
        others = [option.choice for option in options if "random" in failures or option.choice != choice]
        if others and failures & {"misjudge", "random"}:
            choice = others[int(self._rng.integers(len(others)))]
        reason = f"Of {len(options)} options I prefer {choice}: {aim.partition(' count')[0]} decide."
        return json.dumps({REASONING: reason, "choice": choice}) if as_json else f"{reason}\n\nChoice: {choice}"

    def _plan(self, task: Task, robot: int, as_json: bool, failures: frozenset[str], still: Sequence[Point]) -> str:
        angle_rad, points = self._rng.uniform(0.0, 2 * math.pi), formation(task)
        oriented = IN_PLACE in task.shape
        if "canonical" in failures or oriented:
            angle_rad = 0.0
        for k in range(ORIENTATIONS if (task.obstacles or still) and not oriented else 1):
            points = rotated(formation(task), task.center, angle_rad + 2 * math.pi * k / ORIENTATIONS)
            if is_clear(points, task, still):
                break
        if "distorted" in failures:
            stretch = self._rng.uniform(0.6, 1.4, len(task.center))
            noise = self._rng.normal(0.0, 0.2 * task.spacing, points.shape)
            points = task.center + (points - task.center) * stretch + noise
        index, cut = robot % task.n_places, False
        if "random" in failures:
            points = task.center + self._rng.uniform(-CHANCE_WITHIN, CHANCE_WITHIN, points.shape) * task.spacing
        if failures & {"random", "any"}:
            index = int(self._rng.integers(task.n_places))
        elif "first" in failures:
            index = 0
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
            f"and take {'the place with my own number' if index == robot % task.n_places else f'place {index}'}."
        )
        if as_json:
            answer = json.dumps({REASONING: reason, "plan": rows, "my_plan": index})
        else:
            answer = f"{reason}\n\nPlan: {rows}\nmy plan: {index}"
        return answer[: len(answer) * 2 // 3] if cut else answer

    def _program(self, task: Task, robot: int, failures: frozenset[str]) -> str:
        """A named shape as a formation program."""
        figure, turn = named_figure(task), round(float(self._rng.uniform(0.0, 360.0)), 1)
        figure |= {} if "canonical" in failures else {"turn": turn}
        if failures & {"distorted", "random"}:
            figure["scale"] = self._rng.uniform(0.4, 1.6, 2).round(2).tolist()
        if failures & {"misread", "stranger"}:
            others = other_figures(figure)
            figure = others[int(self._rng.integers(len(others))) if "stranger" in failures else 0]
        figure |= {"mirror": "x"} if "mirrored" in failures else {}
        size = {"size": task.spacing / 2} if "crowded" in failures else {}
        index = int(self._rng.integers(task.n_places)) if failures & {"random", "any"} else robot % task.n_places
        answer = {
            REASONING: f"The shape is {task.shape[:200]}, so I draw that.",
            "program": {"draw": [OPEN if "open" in failures else figure], **size},
            "my_plan": task.n_places if "malformed" in failures else 0 if "first" in failures else index,
        }
        return json.dumps(answer)

    def _step(self, prompt: StepPrompt, failures: frozenset[str]) -> str:
        waypoint, reason, last = self._waypoint(prompt, failures)
        path = [waypoint]
        while not last and len(path) < prompt.horizon:
            waypoint, _, last = self._waypoint(replace(prompt, position=numbers(path[-1])), failures)
            path.append(waypoint)
        if len(path) > 1:
            reason += f" In the same way I go on, {len(path)} positions in all."
        if "malformed" in failures:
            return self._malformed_step(prompt, path)
        if prompt.json:
            return f'{{"{REASONING}": {json.dumps(reason)}, {prompt.stated(path)[1:]}'
        return f"{reason}\n\n{prompt.stated(path)}"

    def _waypoint(self, prompt: StepPrompt, failures: frozenset[str]) -> tuple[str, str, bool]:
        """The next waypoint, the reason for it, and whether the path ends there."""
        if "random" in failures:
            here = np.array(prompt.position)
            there = here + self._rng.uniform(-CHANCE_WITHIN, CHANCE_WITHIN, here.shape) * prompt.task.max_step
            waypoint_row: list[float] = there.round(prompt.decimals).tolist()
            return repr(waypoint_row), "I go somewhere.", True
        if failures - NOT_IN_STEPS:
            return self._faulty_step(prompt, failures)
        if prompt.objection:
            return _around(prompt), "My way is not free, so I leave it to the others.", True
        if "careful" in failures and (aside := _aside(prompt)) is not None:
            return aside
        if math.dist(prompt.position, prompt.goal) <= prompt.reach:
            return prompt.goal_text, "I reach my goal within one step, so I go exactly there.", True
        waypoint = repr(list(prompt.towards(prompt.goal)))
        return waypoint, "My goal is farther away than one step, so I take a full step straight towards it.", False

    def _faulty_step(self, prompt: StepPrompt, failures: frozenset[str]) -> tuple[str, str, bool]:
        """A step with a wrong target, a wrong length, or both."""
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
            reason += f" and move {prompt.task.max_step:g} units"
        elif "overlong" in failures and distance > prompt.reach:
            far = [x + 3.0 * prompt.reach * (t - x) / distance for x, t in zip(prompt.position, target, strict=True)]
            return prompt.rounded(far), reason + " in one leap.", True
        elif distance <= prompt.reach:
            exact = prompt.goal_text if target == prompt.goal else prompt.rounded(target)
            return exact, reason + ".", True
        return repr(list(prompt.towards(target))), reason + ".", distance <= prompt.reach

    def _malformed_step(self, prompt: StepPrompt, path: list[str]) -> str:
        *before, waypoint = path
        return (
            "It depends on what the others are going to do; I will wait and see.",
            prompt.stated([*before, waypoint[:-1] + ", 0.0, 1.0]"]),
            prompt.stated([*before, "[NaN, " + waypoint.partition(", ")[2]]),
            prompt.stated(path)[: len(waypoint)],
            prompt.stated([*before, waypoint[:-1] + " + 0.5]"]),
        )[int(self._rng.integers(5))]


def _aside(prompt: StepPrompt) -> tuple[str, str, bool] | None:
    """A step aside, or a wait, if the straight step ends too near to another robot; else None."""
    here, goal, others, task = prompt.position, prompt.goal, prompt.seen(), prompt.task

    def keeps_away(there: Point) -> bool:
        """Whether it is far enough from all others, or farther than now from one that is too near."""
        gaps = ([separation(at, other, task.downwash) for at in (here, there)] for other in others)
        return all(after >= min(task.safe_distance, before) for before, after in gaps)

    way = math.dist(here, goal)
    if keeps_away(goal if way <= prompt.reach else prompt.towards(goal)):
        return None
    angle = math.atan2(goal[1] - here[1], goal[0] - here[0])
    longest, half = min(prompt.reach, way), 0.5 * 10.0**-prompt.decimals
    for turn in TURNS_DEG:
        for share in SHARES:
            # Shorter by what rounding may add.
            length, at = share * longest - 2 * half, angle + math.radians(turn)
            aside = (length * math.cos(at), length * math.sin(at), *(0.0,) * (len(here) - 2))
            there = tuple(round(x + d, prompt.decimals) for x, d in zip(here, aside, strict=True))
            if math.dist(there, goal) < way - half and keeps_away(there):
                return repr(list(there)), "Another robot is in my way, so I step aside or shorter.", False
    return prompt.rounded(here), "Others are in my way on all sides, so I wait.", True


def _around(prompt: StepPrompt) -> str:
    """The step that keeps away from the ways in an objection and ends nearest to the goal; none leaves the place."""
    here, margin, ways = prompt.position, *prompt.objected()
    reach = min(prompt.reach, max(math.dist(here, prompt.goal), margin))
    asides = reach * np.array(
        [(s * math.cos(a), s * math.sin(a)) for a in np.arange(36) * math.tau / 36 for s in SHARES]
    )
    ends = np.array([here] * (1 + len(asides)))
    ends[1:, :2] += asides
    if math.dist(here, prompt.goal) <= prompt.reach:
        ends = np.vstack([ends, prompt.goal])
    free = np.ones(len(ends), dtype=bool)
    for start, end in ways:  # all leave and arrive together
        offset, change = np.subtract(here, start), ends - here - np.subtract(end, start)
        share = np.clip(-(change @ offset) / np.maximum((change**2).sum(axis=1), 1e-12), 0.0, 1.0)
        free &= np.linalg.norm(offset + share[:, None] * change, axis=1) >= margin
    left = np.linalg.norm(ends - prompt.goal, axis=1)
    return prompt.rounded(ends[int(np.argmin(np.where(free, left, np.inf)))].tolist() if free.any() else here)


def _tokens(chars: int) -> int:
    return -(-chars // CHARS_PER_TOKEN)
