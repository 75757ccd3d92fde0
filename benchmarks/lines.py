"""Lines of Python by part against the budgets, docstrings apart; with `--strict` it fails where one is exceeded."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

PACKAGES = Path(__file__).parents[1] / "packages"

BUDGETS = {
    "llm-flock": 16_200,
    "llm-flock-swarm": 7_100,
    "llm-flock-flight": 10_000,
    "llm-flock-view": 5_800,
    "llm-flock-lab": 8_400,
    "llm-flock-onboard": 2_000,
}
RING_0 = (
    "__init__",
    "agent",
    "algorithm1",
    "events",
    "message",
    "mission",
    "plan",
    "planner",
    "shapes",
    "shield",
    "simulate",
)
RING_1 = (
    "arrays",
    "bounds",
    "correspondence",
    "errors",
    "graph",
    "members",
    "metrics",
    "obstacles",
    "printable",
    "protocol",
    "roadmap",
    "validation",
)
RINGS = {"ring 0": (RING_0, 2_400), "rings 0 and 1": (RING_0 + RING_1, 7_000)}


def measured(files: list[Path]) -> tuple[int, int]:
    """Lines of some files, and those of them that are docstrings."""
    lines, documented = 0, 0
    for file in files:
        text = file.read_text(encoding="utf-8")
        lines += len(text.splitlines())
        for node in ast.walk(ast.parse(text)):
            first = getattr(node, "body", None)
            if isinstance(first, list) and first and isinstance(first[0], ast.Expr):
                value = first[0].value
                if isinstance(value, ast.Constant) and isinstance(value.value, str):
                    documented += value.end_lineno - value.lineno + 1 if value.end_lineno else 1
    return lines, documented


def main() -> None:
    """Print the table."""
    rows = {part: ([*(PACKAGES / part / "src").rglob("*.py")], budget) for part, budget in BUDGETS.items()}
    core = PACKAGES / "llm-flock" / "src" / "llm_flock"
    for ring, (names, budget) in RINGS.items():
        inside = [file for file in core.rglob("*.py") if file.relative_to(core).parts[0].removesuffix(".py") in names]
        rows[ring] = inside, budget
    rows["all parts"] = [file for part in BUDGETS for file in rows[part][0]], sum(BUDGETS.values())
    exceeded = False
    print(f"{'part':<18} {'lines':>7} {'budget':>7} {'docstrings':>11}")
    for name, (files, budget) in rows.items():
        lines, documented = measured(files)
        exceeded |= lines > budget
        print(f"{name:<18} {lines:>7,} {budget:>7,} {documented:>11,}{'  exceeded' if lines > budget else ''}")
    sys.exit(exceeded and "--strict" in sys.argv)


if __name__ == "__main__":
    main()
