"""Commands that plug-ins extend: each plug-in of a kind is a function whose keyword parameters become flags.

Plug-ins that show runs in flight take the configuration and their flags, and return a context manager of a sink.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from llm_flock import plugins
from llm_flock.cli._options import with_parameters
from llm_flock.errors import InputError
from llm_flock.plugins import Kind

if TYPE_CHECKING:
    from llm_flock.record._schema import RecordSink
    from llm_flock.runtime._config import RunConfig
    from llm_flock.runtime._trial import Trial

PACE = 2.0  # rounds a second at most while a run is shown: runs of simulated models would be too fast to watch


@dataclass(frozen=True, slots=True, kw_only=True)
class Extension:
    """A plug-in with the flags that were given for it by parameter name; the first one, if any, switches it on."""

    name: str
    function: Callable[..., Any]
    flags: dict[str, Any]

    @property
    def on(self) -> bool:
        """Whether its first flag was given."""
        return bool(next(iter(self.flags.values()), None))

    def __call__(self, *args: Any) -> Any:
        """Call the plug-in with its flags."""
        return self.function(*args, **self.flags)


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of `llm-flock doctor`."""

    part: str  # base, extra, key or reach
    name: str
    ok: bool
    detail: str  # the finding, or the remedy


def chosen(extensions: Sequence[Extension]) -> list[Extension]:
    """The plug-ins that are switched on. InputError if one that is not has other flags."""
    for extension in extensions:
        defaults = {p.name: p.default for p in _flags(extension.function)}
        for field, value in extension.flags.items():
            if not extension.on and value != defaults[field]:
                switch = next(iter(extension.flags)).replace("_", "-")
                raise InputError(field, value, says=f"has no effect without --{switch}")
    return [extension for extension in extensions if extension.on]


def extended(kind: Kind) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Let the plug-ins of a kind extend a command, which takes them as the keyword parameter `extensions`."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        vars(command)["extended_by"] = kind
        return command

    return decorate


def with_extensions(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the flags of the plug-ins that extend it. Call when it is looked up: plug-ins are loaded."""
    kind: Kind | None = vars(command).get("extended_by")
    if kind is None:
        return command
    functions = dict(plugins.load_all(kind))
    added = {name: _flags(function) for name, function in functions.items()}

    def call(**given: Any) -> None:
        extensions = [
            Extension(name=name, function=functions[name], flags={p.name: given.pop(p.name) for p in parameters})
            for name, parameters in added.items()
        ]
        command(**given, extensions=extensions)

    own = [p for p in inspect.signature(command, eval_str=True).parameters.values() if p.name != "extensions"]
    flags = [p for parameters in added.values() for p in parameters]
    var = [p for p in own if p.kind is p.VAR_KEYWORD]
    parameters = [p.replace(kind=p.KEYWORD_ONLY) for p in own if p not in var] + flags
    return with_parameters(command, call, [*parameters, *var])


def _flags(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """The keyword parameters of a plug-in, with evaluated annotations; those of its other parameters may be strings."""
    scope = vars(inspect.getmodule(function))
    parameters = inspect.signature(function).parameters.values()
    return [p.replace(annotation=eval(p.annotation, scope)) for p in parameters if p.kind is p.KEYWORD_ONLY]  # noqa: S307


def refuse(sinks: Sequence[Extension], where: str) -> None:
    """Refuse sinks that were switched on, for a command that shows nothing."""
    for sink in sinks:
        raise InputError(next(iter(sink.flags)), None, says=f"has no effect in {where}")


@contextmanager
def showing(sinks: Sequence[Extension], config: RunConfig) -> Generator[RecordSink | None]:
    """Open the sinks of a run. Yields one sink for all, None without any."""
    from llm_flock.record import both

    with ExitStack() as stack:
        yield both(*[stack.enter_context(sink(config)) for sink in sinks])


class Pacer:
    """Holds a run to a pace [rounds/s]."""

    def __init__(self, pace: float) -> None:
        self._pace = pace
        self._due = 0.0

    async def __call__(self, trial: Trial) -> None:
        """Wait until the next round is due."""
        import asyncio  # longer to import than some commands take

        await asyncio.sleep(max(0.0, self._due - time.monotonic()))
        self._due = time.monotonic() + 1.0 / self._pace
