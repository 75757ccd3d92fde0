"""A consensus rule of the user's own that fails, or chooses what it must not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import msgspec
import pytest

import llm_flock
from llm_flock.errors import FlockError
from llm_flock.message import Message
from llm_flock.plan import Plan
from llm_flock.protocol import Standing

OTHER = Plan.of([[50, 50], [60, 50], [70, 50]])


@dataclass(frozen=True)
class Mine:
    """Chooses by a function."""

    choice: Callable[[Sequence[Message]], Any]
    name: str = "mine"

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        return cast("Message | None", self.choice(heard) if heard else None)


def nothing(heard: Sequence[Message]) -> Any:
    raise LookupError("no\nplan")


def forged(heard: Sequence[Message]) -> Any:
    return msgspec.structs.replace(heard[0], plan=OTHER)


def planless(heard: Sequence[Message]) -> Any:
    return next((message for message in heard if message.plan is None), None)


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        (nothing, f"failed: LookupError: no\\nplan ({__file__}, line "),
        (lambda heard: heard[0].sender, "returned 1; expected None, or one of the messages heard"),
        (forged, "returned Message(sender=1, "),
        (planless, "returned Message(sender=1, "),
    ],
)
def test_one_line_names_the_rule_and_the_robot(choice: Callable[[Sequence[Message]], Any], words: str) -> None:
    models = ["geometry", "simulated:malformed", "geometry"]
    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    with pytest.raises(FlockError) as caught:
        llm_flock.run(mission, model=models, seed=1, start="connected", max_retries=0, consensus=Mine(choice))
    said = str(caught.value)
    assert said.startswith(f"robot 0: the consensus rule 'mine' {words}") and "\n" not in said and len(said) < 600
    assert (choice is nothing) == isinstance(caught.value.__cause__, LookupError)
