"""The exam's questions as a dataset for the Hugging Face Hub: a folder with a card, and a table for each section."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from llm_flock.errors import InputError
from llm_flock.exam.questions import SECTIONS, Question, digest, to_lines
from llm_flock.experiments.store import write_whole

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
        InputError: for field `dataset`: the folder is there already, or its parent is not.
    """
    if os.path.lexists(folder):
        raise InputError("dataset", str(folder), "a folder that is not there yet: none is overwritten")
    if not folder.parent.is_dir():
        raise InputError("dataset", str(folder), "a folder within one that is there")
    tables = {name: [q for q in questions if q.section == name] for name in SECTIONS}
    tables = {name: found for name, found in tables.items() if found}
    folder.mkdir()
    files = [folder / f"{name}.jsonl" for name in tables]
    for file, found in zip(files, tables.values(), strict=True):
        write_whole(file, to_lines(found).encode())
    card = CARD.format(
        size="n<1K" if len(questions) < 1000 else "1K<n<10K",
        configs="\n".join(_config(name) for name in tables),
        version=version,
        split=split,
        count=len(questions),
        digest=digest(questions),
        rows="\n".join(f"| `{name}` | {len(found)} | {SECTIONS[name]} |" for name, found in tables.items()),
    )
    write_whole(folder / "README.md", card.encode())
    return [*files, folder / "README.md"]


def _config(name: str) -> str:
    lines: Iterable[str] = (
        f"  - config_name: {name}",
        "    data_files:",
        "      - split: test",
        f"        path: {name}.jsonl",
    )
    return "\n".join(lines)
