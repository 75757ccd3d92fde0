"""`llm-flock` without a command: the next step, from what is there."""

from __future__ import annotations

from pathlib import Path

from llm_flock.cli._doctor import is_set, version
from llm_flock.cli._terminal import say
from llm_flock.extras import EXTRAS
from llm_flock.llm._providers import PROVIDERS

FIRST = Path("runs/first")


def next_steps(runs: Path = Path("runs")) -> list[tuple[str, str]]:
    """Commands to try next, each with what it does.

    Args:
        runs: where runs keep their records.
    """
    records = sorted(runs.glob("*/run.mcap"), key=lambda path: path.stat().st_mtime)
    steps = [
        (
            f"llm-flock run --shape circle --robots 10 --out {FIRST}",
            "ten robots form a circle, with simulated language models: no key, no network",
        )
    ]
    if records:
        show = "figure" if EXTRAS["view"].missing else "view"
        steps.append((f"llm-flock {show} {records[-1].parent}", "the newest run here"))
    else:
        steps.append((f"llm-flock inspect {FIRST}", "what was recorded, and each robot's talk with its model"))
    info = next((info for info in PROVIDERS.values() if is_set(info.key_env) and info.base_url is not None), None)
    if info is not None:
        extra = EXTRAS["anthropic" if info.name == "anthropic" else "openai"]
        if extra.missing:
            steps.append((extra.install, f"{info.key_env} is set; this adds its library"))
        spend = f"llm-flock run --model {info.example} --max-calls 100"
        steps.append((spend, f"{info.key_env} is set: a run with a real model, and a limit on its calls"))
    else:
        steps.append(("llm-flock models", "providers, and the environment variables for their keys; none is set"))
    steps.append(("llm-flock doctor", "what is installed, and what can be reached"))
    steps.append(("llm-flock --help", "all commands"))
    return steps


def show_next_steps() -> None:
    """Print what can be done next."""
    say(f"LLM-Flock {version()}: robots that agree on a formation, each with its own language model")
    for line, text in next_steps():
        say(f"\n  {line}\n      {text}")
