"""Language models of a user's own: a class that answers what it was made with, and a source of stand-ins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from llm_flock.llm import CallSettings, Habits, LanguageModel, ModelHost
from llm_flock.llm._own import OwnModel
from llm_flock.llm._port import Call


class Echo:
    """Says what it was made with."""

    def __init__(self, answer: Any = "hm") -> None:
        self.answer = answer

    async def ask(self, call: Call) -> Any:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


class Outside(Echo):
    """Sends every robot out of the room."""

    def __init__(self) -> None:
        super().__init__("Position: [400.0, -400.0]")


class Stands:
    """A `ModelSource` of stand-ins."""

    expects, example, at_once = "a name", "stands:in", 100

    def host(self) -> ModelHost:
        return self

    def habits(self, model: str) -> Habits:
        return Habits(simulated=model == "in")

    def digests(self, model: str) -> Mapping[str, str]:
        return {}

    versions = digests

    def model(self, text: str, settings: CallSettings | None) -> LanguageModel:
        return OwnModel(Echo("hm"), name=text)

    async def aclose(self) -> None: ...


SOURCE = Stands()
