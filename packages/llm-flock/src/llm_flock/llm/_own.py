"""A language model of the user's own: an object with `ask`, or a class named as `package.module:Class`."""

from __future__ import annotations

import asyncio
import inspect
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self, TypeAlias, cast

from pydantic import TypeAdapter, ValidationError

from llm_flock.cancellation import is_cancelled
from llm_flock.errors import InputError, ModelError
from llm_flock.llm._port import Answers, Call, Reply
from llm_flock.llm._providers import habits_of, model_forms, parse_model
from llm_flock.user_code import describe_exception, load_own

logger = logging.getLogger(__name__)

_REPLY = TypeAdapter(Reply)

CLOSE_S = 10.0  # longest wait for a model of the user's own to close [s]

ModelChoice: TypeAlias = str | Answers | Sequence[str | Answers]
"""One model for all robots, by its name or as an object, or one for each."""


class OwnModel:
    """A `LanguageModel` around an object of the user's own; its errors and bad replies do not end a run.

    An exception counts as a failed call. `TimeoutError` and other `OSError`s are retried. All others are faults of the
    code: they are logged once with a traceback, and not retried. InputError without `async def ask(self, call)`.

    Attributes:
        name: `package.module:Class`, as in records.
        simulated: whether the object declares itself a stand-in.
        made: whether it was made from its name, not passed as an object.
    """

    def __init__(self, model: object, *, name: str | None = None) -> None:
        self.name = own_name(model) if name is None else name
        self.simulated = bool(getattr(model, "simulated", False))
        self.made = name is not None
        self._model = model
        self._logged = False
        if not inspect.iscoroutinefunction(getattr(model, "ask", None)):
            raise InputError("model", self.name, "a class with the method `async def ask(self, call)`")

    @classmethod
    def load(cls, name: str) -> Self:
        """An object of the class of this name, made without arguments; InputError if that fails."""
        make = load_own("model", name, model_forms())
        try:
            model = make()
        except Exception as error:  # a user's code may raise anything
            allowed = f"a class that is called without arguments ({describe_exception(error)})"
            raise InputError("model", name, allowed) from error
        return cls(model, name=name)

    async def ask(self, call: Call) -> Reply:
        """Answer one call; a ModelError without an answer."""
        try:
            reply = await cast(Answers, self._model).ask(call)
        except ModelError:
            raise
        except TimeoutError as error:
            raise ModelError("timeout", f"{self.name}: {error or 'no answer in time'}") from error
        except OSError as error:
            raise ModelError("connection", f"{self.name}: {describe_exception(error)}") from error
        except (Exception, SystemExit, asyncio.CancelledError) as error:  # a user's code may raise anything
            if isinstance(error, asyncio.CancelledError) and is_cancelled():
                raise
            if not self._logged:
                self._logged = True
                logger.warning("robot %d, %s failed", call.robot, self.name, exc_info=True)
            raise ModelError("refused", f"{self.name} failed: {describe_exception(error)}") from error
        whole = Reply(text=reply, model=self.name) if isinstance(reply, str) else reply
        if (fault := _fault(whole)) is not None:
            raise ModelError("garbage", f"{self.name} returned {fault}")
        # UTF-8 and the records cannot hold half a character.
        return replace(whole, text=whole.text.encode("utf-8", "replace").decode(), model=self.name)

    async def aclose(self) -> None:
        """Close an object that was made here, if it has an `aclose`; one that was passed stays open."""
        close = getattr(self._model, "aclose", None)
        if self.made and close is not None:
            try:
                await asyncio.wait_for(close(), CLOSE_S)
            except (Exception, SystemExit, asyncio.CancelledError) as error:  # the run is over already
                if isinstance(error, asyncio.CancelledError) and is_cancelled():
                    raise
                logger.warning("%s could not be closed: %s", self.name, describe_exception(error))

    @property
    def unrepeatable(self) -> str:
        """A sentence about the part of this model that a record cannot repeat."""
        if not self.made:
            return (
                f"{self.name} was handed over as an object: neither its code nor its arguments are recorded, so the "
                "run cannot be flown again by its configuration; a cassette (record_llm) repeats the answers."
            )
        return f"{self.name} is code of the user's own, of which only the name is recorded."


def says_simulated(name: str) -> bool:
    """Whether the model of this name is a stand-in; a class of the user's own is imported, but not called."""
    if parse_model(name).kind != "own":
        return habits_of(name).simulated
    return bool(getattr(load_own("model", name, model_forms()), "simulated", False))


def own_name(model: object) -> str:
    """The name of an object's class: `package.module:Class`."""
    kind = type(model)
    return f"{kind.__module__}:{kind.__qualname__}"


def split_choice(choice: ModelChoice) -> tuple[str, Mapping[int, OwnModel]]:
    """A choice of models as the configuration writes it, and the objects in it by robot; -1 is for all robots."""
    if isinstance(choice, str):
        return choice, {}
    if not isinstance(choice, list | tuple):
        own = _wrap(choice)
        return own.name, {-1: own}
    if not choice:
        raise InputError("model", [], "a model for each robot")
    known: dict[int, OwnModel] = {}
    objects: dict[int, OwnModel] = {}
    names: list[str] = []
    for robot, model in enumerate(cast("Sequence[str | Answers]", choice)):
        if isinstance(model, str):
            names.append(model)
        else:
            objects[robot] = known.setdefault(id(model), _wrap(model))
            names.append(objects[robot].name)
    return ",".join(f"{robot}={name}" for robot, name in enumerate(names)), objects


def _wrap(model: object) -> OwnModel:
    if isinstance(model, type):
        raise InputError("model", own_name(model), f"an object, such as {model.__name__}(), or a name")
    return OwnModel(model)


def _fault(reply: object) -> str | None:
    """The fault of a reply that a record cannot hold, else None."""
    if not isinstance(reply, Reply):
        return f"{type(reply).__name__}, and no Reply or str"
    try:
        _REPLY.validate_python(reply)
        json.dumps(dict(reply.settings), allow_nan=False)
    except ValidationError as error:
        first = error.errors()[0]
        return f"a reply whose {'.'.join(map(str, first['loc']))} is {first['input']!r}: {first['msg']}"
    except (TypeError, ValueError, RecursionError) as error:
        return f"a reply whose settings are no JSON ({error})"
    return None
