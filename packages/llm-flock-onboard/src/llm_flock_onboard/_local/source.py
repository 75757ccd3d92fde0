"""The models on board as a plug-in: names with the prefix `local:`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from llm_flock.llm import Habits, ModelHost

if TYPE_CHECKING:
    from llm_flock.mission import Mission
    from llm_flock.planner import PlanQuestion

LEFT_TO_CODE = ("points", "outline", "letters", "program")
"""Kinds of shapes that hold their drawing already: code places the robots, and no model is asked."""


def is_asked(question: PlanQuestion) -> bool:
    """Whether the packaged model draws this plan: a shape by its name or in words, with nothing in the way.

    Code plans where numbers decide: among obstacles and standing robots, in space, and shapes that are drawn already.
    """
    mission = question.mission
    drawn = mission.dim > 2 or mission.shape.partition(":")[0] in LEFT_TO_CODE
    return not (drawn or mission.obstacles or question.still)


def is_taught(mission: Mission) -> bool:
    """Whether the packaged adapter was taught the plan of this team, so that a right one is recalled."""
    from llm_flock_onboard._distill.curriculum import CURRICULUM, taught_teams

    words = mission.shape.removeprefix("text:")
    said = any(words in text["say"] for text in CURRICULUM["texts"]["train"])
    return said or (mission.shape, mission.n_places) in taught_teams()


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
        """The packaged model is asked as it was trained: briefly, for programs, in its own frame; or for a letter."""
        from llm_flock_onboard._local.weights import LETTERS, SMOLLM2, is_packaged, split_name

        name, adapter = split_name(model)
        trained = name == SMOLLM2
        letters = trained and adapter == LETTERS
        return Habits(
            prompts="letters" if letters else "brief-program" if trained else "full",
            frame="own" if trained else "world",
            plans=is_asked if trained and adapter is None else None,
            taught=is_taught if trained and adapter is None else None,
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
