"""The models on board as a plug-in: names with the prefix `local:`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from llm_flock.llm import Habits, ModelHost

if TYPE_CHECKING:
    from llm_flock.planner import PlanQuestion

TAUGHT_PLANS = (("triangle", 3), ("square", 4), ("cross", 5), ("circle", 5), ("circle", 10))
"""Shapes and numbers of places of the plans that the packaged adapter was taught."""


def is_taught(question: PlanQuestion) -> bool:
    """Whether the packaged adapter was taught to plan this: one of the taught teams, with nothing in the way.

    Of 25 teams that it was not taught the model gets one right.
    """
    mission = question.mission
    return (mission.shape, mission.n_places) in TAUGHT_PLANS and not mission.obstacles and not question.still


class OnBoard:
    """Small models in files, on the processor of this machine: a `ModelSource`. Imports what it needs when asked."""

    expects = "smollm2 or a GGUF file"
    example = "local:smollm2"

    @property
    def at_once(self) -> int:
        """Slots of an engine."""
        from llm_flock_onboard._local.engine import slot_count

        return slot_count()

    def host(self) -> ModelHost:
        """See `ModelSource`."""
        from llm_flock_onboard._local.model import EngineLeases

        return EngineLeases()

    def habits(self, model: str) -> Habits:
        """The packaged model is asked as it was trained: with brief prompts in its own frame, or for a letter."""
        from llm_flock_onboard._local.weights import LETTERS, SMOLLM2, is_packaged, split_name

        name, adapter = split_name(model)
        trained = name == SMOLLM2
        letters = trained and adapter == LETTERS
        return Habits(
            prompts="letters" if letters else "brief-program" if trained else "full",
            frame="own" if trained else "world",
            plans=is_taught if trained and adapter is None else None,
            contained=is_packaged(model),
        )

    def digests(self, model: str) -> Mapping[str, str]:
        """See `ModelSource`."""
        from llm_flock_onboard._local.weights import find_weights

        return find_weights(model).digests()

    def versions(self, model: str) -> Mapping[str, str]:
        """See `ModelSource`."""
        from llm_flock_onboard._local.weights import find_weights

        return find_weights(model).versions()


SOURCE = OnBoard()
"""The plug-in."""
