"""A program of twenty lines that sits the exam: `llm-flock exam benchmarks.twenty_lines:Short`.

It names its own number, goes straight to its goal, plans a circle whatever the shape, takes the first shape that a
mission names, leaves a drawing as it is, and takes the first option. What it gets right needs no model.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any


class Short:
    """Answers every question of the exam from its prompt; no language model."""

    simulated = True

    async def ask(self, call: Any) -> str:
        text, words = "\n".join(message.text for message in call.messages), call.messages[-1].text
        numbers = [[float(one) for one in re.findall(r"-?\d+\.?\d*", line)] for line in text.splitlines()]
        rows = {line.partition(":")[0][:9]: found for line, found in zip(text.splitlines(), numbers, strict=True)}
        if call.kind == "judgement":
            return f"Choice: {re.findall(r'^- ([a-z]+): ', text, re.MULTILINE)[0]}"
        if "The program:" in words:
            return next(line for line in words.splitlines() if line.startswith("{"))
        if call.form is None:
            named = re.findall(r"line|circle|triangle|square|star|cross|wedge|grid|sphere|cube", words.lower())
            return json.dumps({"answer": "mission", "stages": [{"parts": [{"shape": (named or ["circle"])[0]}]}]})
        if call.kind == "plan":
            n, center, radius = (
                call.form.n,
                rows["- Centre "],
                rows["- Spacing"][0] / 2 / math.sin(math.pi / call.form.n),
            )
            turns = [2 * math.pi * k / n for k in range(n)]
            plan = [[center[0] + radius * math.cos(a), center[1] + radius * math.sin(a), *center[2:]] for a in turns]
            return f"Plan: {plan}\nmy plan: {call.robot % n}"
        here, goal, limit = rows["Your posi"], rows["Your goal"][-call.form.dim :], rows["- Step li"][0]
        share = min(1.0, limit / max(math.dist(here, goal), 1e-9))
        step = [a + share * (b - a) for a, b in zip(here, goal, strict=True)]
        return f"Path: {[step]}" if call.form.horizon > 1 else f"Position: {step}"
