"""Which questions the adapter of the model on board has seen in training, word for word, by its documented recipe."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from llm_flock.distill.taught import training_prompts
from llm_flock.exam.questions import Question
from llm_flock.exam.sit import first_messages
from llm_flock.llm.frame import FrameName
from llm_flock.llm.prompting import PromptSet
from llm_flock.llm.sources import habits_of


def seen_in_training(
    model: str, questions: Sequence[Question], prompts: PromptSet, frame: FrameName
) -> Mapping[str, float] | None:
    """Share of each section whose first prompt was taught, every robot's; None for models that were not taught here."""
    if habits_of(model).frame != "own" or model.endswith("+none"):
        return None
    taught, seen, asked = training_prompts(), Counter[str](), Counter[str]()
    for question in questions:
        messages = [tuple(message.text for message in pair) for pair in first_messages(question, prompts, frame)]
        asked[question.section] += 1
        seen[question.section] += all(pair in taught for pair in messages)
    return {section: seen[section] / count for section, count in asked.items()}
