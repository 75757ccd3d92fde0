"""Models of plug-ins: what a distribution provides that answers names with a prefix of its own, such as `local:...`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from llm_flock import plugins

if TYPE_CHECKING:
    from llm_flock.llm._port import CallSettings, FrameName, LanguageModel
    from llm_flock.planner import PlanQuestion


@dataclass(frozen=True, slots=True, kw_only=True)
class Habits:
    """How a model is best asked, where the configuration does not say.

    Attributes:
        prompts: name of a packaged set of prompts.
        frame: coordinates of the prompts.
        plans: whether it is asked for a plan, the others come from geometry; None where it is asked for all.
        contained: it costs nothing, uses no network and reads no file outside installed packages.
        simulated: it is a stand-in, and no language model: everything that is shown says so.
    """

    prompts: str = "full"
    frame: FrameName = "world"
    plans: Callable[[PlanQuestion], bool] | None = None
    contained: bool = False
    simulated: bool = False


class ModelHost(Protocol):
    """What the models of one team share, such as an engine."""

    def model(self, text: str, settings: CallSettings | None) -> LanguageModel:
        """The model of one robot, named as in the configuration; InputError if it is known that it cannot work."""
        ...

    async def aclose(self) -> None:
        """Give everything back. No model of this host may be asked afterwards."""
        ...


class ModelSource(Protocol):
    """A plug-in of the kind `models`; its name is the prefix.

    Attributes:
        expects: what follows the prefix, as a phrase for error messages.
        example: a model string that works.
    """

    expects: str
    example: str

    @property
    def at_once(self) -> int:
        """Questions that it answers at the same time; others wait, and their time-outs begin later."""
        ...

    def host(self) -> ModelHost:
        """A host for one team. Loads nothing before the first question."""
        ...

    def habits(self, model: str) -> Habits:
        """How a model is best asked, by the part of its name after the prefix. Reads no file."""
        ...

    def digests(self, model: str) -> Mapping[str, str]:
        """Digests of the model's files by name; InputError if one is missing or unfit."""
        ...

    def versions(self, model: str) -> Mapping[str, str]:
        """As `digests`, with the files that were made from them: what a record says of the model."""
        ...


def source_of(prefix: str) -> ModelSource:
    """The plug-in of this prefix; KeyError if there is none, FieldError if it cannot be imported."""
    return plugins.load("models", prefix)


def habits_of(text: str) -> Habits:
    """How the model of this name is best asked; as any other, where no plug-in of its prefix is installed."""
    prefix, _, model = text.partition(":")
    if prefix in plugins.entries("models"):
        return source_of(prefix).habits(model)
    return Habits(simulated=prefix == "simulated")
