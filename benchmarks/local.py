"""A model on board: whole missions on this machine's processor, without a network.

python -m benchmarks local          missions of three and five robots, and how fast the engine is
python -m benchmarks local-ten      a circle of ten, asked on events only: duration and memory, in an own process
python -m benchmarks local-table    the same missions: stock weights, the adapter, and ideal simulated models
python -m benchmarks local-wishes   missions with the model that was taught letters, one for each wish and seed, in
                                    wordings that it was not taught
python -m benchmarks local-exam LOG    docs/data/on-board-exam.csv from a log of `exam local:smollm2 --out LOG`:
                                    each section, and apart what was never taught
python -m benchmarks local-held SEEDS [FALLBACK,...]   docs/data/on-board-held.csv: six teams at other centres, and two
                                    teams of ten that it shares with others
python -m benchmarks local-letters FILE.gguf [TURNS]
                                    ten robots asked for a step: a waypoint of the packaged adapter, and a letter of
                                    this one, in turns: tokens and processor time of an answer
"""

from __future__ import annotations

import asyncio
import csv
import itertools
import json
import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from llm_flock.llm._answer_forms import answer_grammar
from llm_flock.llm._limits import CallLane
from llm_flock.llm._models import ModelPool
from llm_flock.llm._planner import LanguagePlanner
from llm_flock.llm._port import AnswerForm, Attempt
from llm_flock.llm._prompting import PromptSet
from llm_flock.runtime._api import run_async
from llm_flock.runtime._result import Summary
from llm_flock.shapes import shape_name
from llm_flock_lab._exam.questions import SECTIONS
from llm_flock_lab._experiments.statistics import wilson
from llm_flock_onboard._distill.choices import draw_choices
from llm_flock_onboard._distill.curriculum import CURRICULUM
from llm_flock_onboard._distill.wishes import WORDINGS
from llm_flock_onboard._local.engine import Engine, slot_count, thread_count
from llm_flock_onboard._local.source import is_taught
from llm_flock_onboard._local.weights import find_weights

TRAINED, STOCK, IDEAL = "local:smollm2", "local:smollm2+none", "simulated:ideal"
LETTERS_MODEL = "local:smollm2+letters"
BARS = (("triangle", 3), ("circle", 5))
HELD = (("triangle", 3), ("square", 4), ("star", 10), ("circle", 7), ("line", 5), ("wedge", 9))
MIXED = (
    ("0-8=local:smollm2,9=simulated:overshoot", "circle", 10),
    ("0-4=local:smollm2,5-9=simulated:ideal", "circle", 10),
)
"""Teams that the model on board shares with a model that is always wrong, and with one that is always right."""

TRIALS = 20
TEN = 10
"""Robots that ask at once."""

SAFE = 3.0
"""The default safe distance [units]."""

FOR_A_WISH = 5
"""Missions for each wish, each in another wording."""

FEW, FEW_ROUNDS = 3, 1
"""Trials of stock weights, and rounds of each: they never form."""


@dataclass(frozen=True, slots=True)
class Flown:
    """Results of some missions with one model."""

    model: str
    summaries: tuple[Summary, ...]
    seconds: tuple[float, ...]

    def row(self, shape: str, n: int) -> str:
        """A line of the table."""
        done, runs = [s for s in self.summaries if s.formed], self.summaries
        safe = sum((s.min_separation or 0.0) < SAFE - 1e-6 for s in runs)
        calls = sum(s.model_calls for s in runs) / len(runs)
        right = 1 - sum(s.calls_rejected for s in runs) / max(1, sum(s.model_calls for s in runs))
        tokens = sum(s.tokens for s in runs) / len(runs)
        rounds = f"{median(s.rounds_to_formed or 0 for s in done):g}" if done else "-"
        return (
            f"| {shape} {n} | {self.model} | {len(done)} of {len(runs)} | {safe} | {rounds} | {calls:.1f} "
            f"| {100 * right:.0f} | {tokens:,.0f} | {median(self.seconds):.1f} |"
        )


HEAD = (
    "| Mission | Model | Formed | Violations | Rounds | Calls | Accepted [%] | Tokens | Seconds |\n"
    "|---|---|---|---|---|---|---|---|---|"
)


def fly(model: str, shape: str, n: int, seeds: range, **options: Any) -> Flown:
    """One mission after the other, on one engine."""

    async def all_of_them() -> list[tuple[Summary, float]]:
        pool, out = ModelPool(), []
        try:
            for seed in seeds:
                began = time.perf_counter()
                lane = CallLane(pool=pool)
                result = await run_async(model=model, shape=shape, n_robots=n, seed=seed, lane=lane, **options)
                out.append((result.summary, time.perf_counter() - began))
        finally:
            await pool.aclose()
        return out

    summaries, seconds = zip(*asyncio.run(all_of_them()), strict=True)
    return Flown(model, summaries, seconds)


def missions() -> None:
    """The bars: every mission forms, and no robots come closer than the safe distance."""
    machine()
    speed(TRAINED)
    print(HEAD)
    for shape, n in BARS:
        print(fly(TRAINED, shape, n, range(TRIALS)).row(shape, n), flush=True)


def table() -> None:
    """Side by side."""
    print(HEAD)
    for shape, n in BARS:
        print(fly(STOCK, shape, n, range(FEW), rounds=FEW_ROUNDS).row(shape, n), flush=True)
        for model in (TRAINED, IDEAL):
            print(fly(model, shape, n, range(TRIALS)).row(shape, n), flush=True)


def wishes() -> None:
    """Five missions for each wish, of a team that was taught and of one that was not; plans come by geometry."""
    print("| Wish | Wording of seed 0 " + HEAD.replace("\n|", "\n|---|---|"))
    for wish, said in WORDINGS.items():
        for shape, n in (("circle", 5), ("star", 10)):
            flown = [
                fly(LETTERS_MODEL, shape, n, range(seed, seed + 1), wish=said["held-out"][seed])
                for seed in range(FOR_A_WISH)
            ]
            summaries = tuple(itertools.chain.from_iterable(one.summaries for one in flown))
            seconds = tuple(itertools.chain.from_iterable(one.seconds for one in flown))
            row = Flown(LETTERS_MODEL, summaries, seconds).row(shape, n)
            print(f"| {wish} | {said['held-out'][0]} {row}", flush=True)


def ten() -> None:
    """A circle of ten, asked on events only, in a fresh process, to measure its memory."""
    code = "from benchmarks.local import _ten; _ten()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    result = json.loads(done.stdout)
    machine()
    print(HEAD)
    print(result["row"])
    print(f"{result['seconds']:.0f} s   bar 180;   {result['peak_mib']:.0f} MiB   bar 1536", flush=True)


def _ten() -> None:
    began = time.perf_counter()
    flown = fly(TRAINED, "circle", 10, range(1), decide="on-event")
    seconds = time.perf_counter() - began
    # Children as well, should there be any.
    peak = sum(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1024
    print(json.dumps({"row": flown.row("circle", 10), "seconds": seconds, "peak_mib": peak}))


def letters(arguments: Sequence[str]) -> None:
    """Ten robots ask the same held-out steps for a waypoint and for a letter, in turns; grammars as on board."""
    if not arguments:
        raise SystemExit("local-letters FILE.gguf [TURNS]: the adapter that was taught letters is missing")
    machine()
    asyncio.run(_letters(f"{TRAINED}+{arguments[0]}", int(arguments[1]) if len(arguments) > 1 else 6))


async def _letters(taught: str, turns: int) -> None:
    forms = {
        "a waypoint": (TRAINED, PromptSet.load("brief"), "own"),
        "a letter": (taught, PromptSet.load("letters", wish="Keep left."), "world"),
    }
    questions = [choice.question for choice in itertools.islice(draw_choices(0, "held-out"), TEN * turns)]
    spent: dict[str, list[float]] = {name: [] for name in forms}
    attempts: dict[str, list[Attempt]] = {name: [] for name in forms}
    async with ModelPool() as pool:
        for turn in range(-1, turns):  # the first turn loads both engines, and does not count
            asked = questions[TEN * max(0, turn) :][:TEN]
            for name, (text, prompts, frame) in forms.items():
                model = pool.model(text, rng=np.random.default_rng(0))
                seen: list[Attempt] = []
                options: Any = {"max_retries": 0, "frame": frame, "on_attempt": seen.append}
                planners = [LanguagePlanner(k, model, prompts, **options) for k in range(TEN)]
                began = time.process_time()
                await asyncio.gather(*(p.step(q) for p, q in zip(planners, asked, strict=True)))
                if turn >= 0:
                    spent[name].append((time.process_time() - began) / max(1, len(seen)))
                    attempts[name] += seen
    print("| Asked for | Model | Answers | Parsed [%] | Tokens in | Out, mean | Out, most | Processor time [s] |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (text, *_) in forms.items():
        usages = [attempt.reply.usage for attempt in attempts[name] if attempt.error is None]
        parsed = sum(attempt.parsed is not None for attempt in attempts[name]) / len(attempts[name])
        written = [usage.output for usage in usages]
        read = sum(usage.input for usage in usages) / len(usages)
        low, middle, high = min(spent[name]), median(spent[name]), max(spent[name])
        print(
            f"| {name} | `{text.rpartition('/')[2]}` | {len(written)} | {100 * parsed:.0f} | {read:.0f} "
            f"| {sum(written) / len(written):.1f} | {max(written)} | {middle:.3f} ({low:.3f} to {high:.3f}) |"
        )


def exam(arguments: Sequence[str]) -> None:
    """Reduce a log of the exam to shares by section, with the questions apart whose plan was never taught."""
    from inspect_ai.log import read_eval_log

    from llm_flock_lab._exam.splits import public_split

    if not arguments:
        raise SystemExit("local-exam LOG: the folder of the log is missing")
    asked = {question.id: question for question in public_split()}
    right: dict[tuple[str, str], list[bool]] = {}
    used: dict[str, list[tuple[int, float]]] = {}
    logs = (read_eval_log(str(path)).samples or [] for path in sorted(Path(arguments[0]).glob("*.eval")))
    for sample in {str(sample.id): sample for sample in itertools.chain(*logs) if sample.scores}.values():
        question, score = asked[str(sample.id)], (sample.scores or {}).get("by_our_checks")
        if score is None:
            continue
        kinds = ["all"]
        if question.asks_plan and question.meant is None and not question.first:
            mission = question.build_mission()
            taught = is_taught(mission) and not question.still and not mission.obstacles
            given = CURRICULUM["plans"]
            shape = mission.shape in given["held_out_shapes"] or mission.shape not in given["shapes"]
            kinds.append("taught" if taught else "shape never taught" if shape else "size or place never taught")
            named = shape_name(mission.shape) != "points"
            kinds.append("its name copied" if named else "places copied")
        for kind in kinds:
            right.setdefault((question.section, kind), []).append(score.value == 1)
        found: dict[str, Any] = score.metadata or {}
        used.setdefault(question.section, []).append((found["tokens_output"], found["seconds"]))
    rows = [("Section", "Questions", "Asked", "Right", "Right [%]", "Low [%]", "High [%]", "Tokens out, mean")]
    for (section, kind), hits in sorted(right.items(), key=lambda one: list(SECTIONS).index(one[0][0])):
        share = wilson(sum(hits), len(hits))
        low, high = 100 * (share.low or 0.0), 100 * (share.high or 0.0)
        out = f"{sum(tokens for tokens, _ in used[section]) / len(used[section]):.0f}" if kind == "all" else ""
        figures = (str(len(hits)), str(sum(hits)), f"{100 * share.value:.0f}", f"{low:.0f}", f"{high:.0f}", out)
        rows.append((section, kind, *figures))
    _write("on-board-exam.csv", rows)


def held(arguments: Sequence[str]) -> None:
    """Fly teams at random centres and spacings, whose robots do what their model answers, or have the breaker too."""
    seeds = range(int(arguments[0]) if arguments else 20)
    fallbacks = arguments[1].split(",") if len(arguments) > 1 else ["hold", "breaker"]
    rows: list[tuple[str, ...]] = [HELD_HEAD]
    teams = [(TRAINED, shape, n) for shape, n in HELD]
    for fallback, (model, shape, n) in itertools.product(fallbacks, (*teams, *MIXED)):
        rng, flown, spent = np.random.default_rng([n, 47]), list[Summary](), time.process_time()
        for seed in seeds:
            center = tuple(rng.uniform(40.0, 60.0, 2).round(1).tolist())
            spacing = round(float(rng.uniform(5.0, 10.0)), 1)
            found = fly(model, shape, n, range(seed, seed + 1), fallback=fallback, center=center, spacing=spacing)
            flown += found.summaries
        calls = sum(one.model_calls for one in flown)
        by_model = sum(one.waypoint_shares.get("model", 0.0) for one in flown) / len(flown)
        formed = [str(sum(x)) for x in ([one.formed for one in flown], [one.formed_by_models for one in flown])]
        least = f"{min(one.min_separation or 0.0 for one in flown):.3f}"
        rounds = f"{median(one.rounds_to_formed or one.rounds for one in flown):g}"
        told = {str(one.plan_taught) for one in flown if one.plan_taught is not None}
        cpu = f"{(time.process_time() - spent) / max(1, calls):.2f}"
        team = (f"{shape} {n}", "" if model == TRAINED else model.partition(",")[2], fallback, "/".join(sorted(told)))
        rows.append((*team, str(len(flown)), *formed, rounds, least, f"{100 * by_model:.0f}", str(calls), cpu))
        _write("on-board-held.csv", rows)


HELD_HEAD = (
    "Team",
    "Models beside",
    "Fallback",
    "Plan taught",
    "Missions",
    "Formed",
    "By models only",
    "Rounds, median",
    "Nearest two",
    "Waypoints by the model [%]",
    "Calls",
    "CPU [s a call]",
)


def _write(name: str, rows: Sequence[Sequence[str]]) -> None:
    with (Path(__file__).parents[1] / "docs" / "data" / name).open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
    print(*(", ".join(row) for row in rows), sep="\n", flush=True)


def machine() -> None:
    """Describe the machine."""
    load = os.getloadavg()[0]
    print(f"{os.cpu_count()} cores, load {load:.1f} (other processes included), {thread_count()} thread(s) compute")


def speed(model: str) -> None:
    """Tokens a second, of questions and of answers, one at a time and as many as the engine answers at once."""
    engine = Engine(find_weights(model.partition(":")[2]), 1024)
    grammar = answer_grammar("plan", AnswerForm(n=12, dim=2, reasons=False))

    def ask(text: str, tokens: int) -> Any:
        messages = [{"role": "user", "content": text}]
        body = {"messages": messages, "max_tokens": tokens, "temperature": 0, "grammar": grammar}
        return engine.submit(body, threading.Event())

    try:
        ask("Hello", 1).result()
        began = time.perf_counter()
        read = ask(" ".join(f"[{i}.25, -{i}.5]" for i in range(30)), 1).result().usage
        reading = (read.input - read.cached) / (time.perf_counter() - began)
        print(f"questions {reading:.0f} tokens/s", end="; ")
        for at_once in (1, slot_count()):
            began = time.perf_counter()
            usages = [asked.result().usage for asked in [ask(f"{i}", 100) for i in range(at_once)]]
            writing = sum(usage.output for usage in usages) / (time.perf_counter() - began)
            print(f"answers, {at_once} at once, {writing:.0f} tokens/s", end="; ")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{peak:.0f} MiB in use", flush=True)
    finally:
        engine.close()
