"""The exam's questions as a dataset for the Hugging Face Hub: a folder with a card, and a table for each section."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path

from llm_flock.errors import InputError
from llm_flock.exam.questions import SECTIONS, Question, digest, to_lines

CARD = """---
license: mit
language: [en]
pretty_name: LLM-Flock exam
tags: [robotics, multi-robot, formation, benchmark]
size_categories: [{size}]
configs:
{configs}
---

# LLM-Flock exam, version {version}, {split} split

Questions that a robot of a team without a central controller asks its language model: plan a formation, choose a place
in it, fly the next step, use the reason why an answer was refused, read a mission in plain words. A seeded program
makes them, and code scores every answer. The digest of these {count} questions is `{digest}`.

| Table | Questions | What is asked |
|---|---|---|
{rows}

A question holds no prompt: `llm-flock exam` renders it with the templates of a run, so that any prompt can be tried.
Fields that have their default are left out. LLM-Flock's reference describes them (docs/reference/exam-questions.md).

```python
from datasets import load_dataset

steps = load_dataset("OWNER/NAME", "step", split="test")
```

**For measuring only.** Do not train on these questions. Nothing in them comes from people or from a language model; the
wordings of missions were written for the exam. Lengths are mission units, positions are in the world frame.
"""


def write_dataset(folder: Path, questions: Sequence[Question], *, version: int, split: str) -> list[Path]:
    """Write a card and one file of JSON lines for each section into a new folder; returns the files.

    Raises:
        InputError: for field `dataset`: the folder is there already, its parent is not, or it cannot be made. Nothing
            is left of one that is not finished.
    """
    if os.path.lexists(folder):
        raise InputError("dataset", str(folder), "a folder that is not there yet: none is overwritten")
    if not folder.parent.is_dir():
        raise InputError("dataset", str(folder), "a folder within one that is there")
    tables = {name: [q for q in questions if q.section == name] for name in SECTIONS}
    tables = {name: found for name, found in tables.items() if found}
    texts = {f"{name}.jsonl": to_lines(found) for name, found in tables.items()}
    texts["README.md"] = CARD.format(
        size="n<1K" if len(questions) < 1000 else "1K<n<10K",
        configs="\n".join(_config(name) for name in tables),
        version=version,
        split=split,
        count=len(questions),
        digest=digest(questions),
        rows="\n".join(f"| `{name}` | {len(found)} | {SECTIONS[name]} |" for name, found in tables.items()),
    )
    unfinished = folder.with_name(f".{folder.name}-{os.getpid()}")
    try:
        unfinished.mkdir()
        for name, text in texts.items():
            (unfinished / name).write_text(text, encoding="utf-8")
        unfinished.rename(folder)
    except OSError as error:
        raise InputError("dataset", str(folder), says=f"cannot be made ({error.strerror})") from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return [folder / name for name in texts]


def _config(name: str) -> str:
    lines: Iterable[str] = (
        f"  - config_name: {name}",
        "    data_files:",
        "      - split: test",
        f"        path: {name}.jsonl",
    )
    return "\n".join(lines)
