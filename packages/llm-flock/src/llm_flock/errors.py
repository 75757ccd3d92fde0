"""All exceptions that the package raises on purpose.

The class names the source of the fault: the operator's input, a peer's message, a model's answer, a provider's
service, a robot, or a file on disk.

    FlockError
    |-- InputError          the operator gave a value that is not allowed
    |-- MessageError        a peer sent a message that is not acceptable
    |-- AnswerError         a model's answer cannot be used (the reason can be sent to the model)
    |-- ModelError          a provider did not answer (time-out, rate limit, cut connection, refusal)
    |   `-- BudgetExceeded  the run's own limit on calls, tokens or money is used up
    |-- ReplayDrift         a replayed run sends a question that differs from the recorded one
    |-- RobotError          a robot cannot execute, or did not confirm, a command (llm_flock.robots._base)
    `-- RecordError         a record cannot be read or written
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from functools import partial
from typing import Any

from llm_flock.printable import one_line

MAX_SHOWN = 300
"""Longest value that an error shows [characters]."""


MAX_LISTED = 30
"""Most names that an error lists if none is near the given one."""


class FlockError(Exception):
    """Base of all errors raised on purpose by this package."""


class InputError(FlockError):
    """A value given by the operator is not allowed.

    Reads `n_robots = 0: expected at least 1`, or ends with `says`. The command line names a flag instead of the field
    if one was typed.

    Attributes:
        field: name of the offending field, as written in the configuration file.
        value: the value that was given; None if there was none, or if showing it does not help.
        says: what is wrong, as the part of the sentence after the field.
    """

    def __init__(self, field: str, value: object, allowed: str = "", *, says: str = "") -> None:
        """`allowed` is a phrase that follows "expected". For any other text, give `says`."""
        self.field = field
        self.value = value
        self.says = one_line(says or f"expected {allowed}")
        given = "" if value is None else f" = {_value_text(value)}"
        super().__init__(f"{one_line(field)}{given}: {self.says}")

    def __reduce__(self) -> tuple[Any, ...]:
        # Lets a worker process hand it to its parent.
        return partial(type(self), says=self.says), (self.field, self.value)


class FieldError(InputError):
    """A field, section or option is unknown or missing; the whole sentence is in `says`."""

    def __init__(self, field: str, value: object = None, *, says: str) -> None:
        super().__init__(field, value, says=says)
        self.args = (self.says,)


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """Says that `name` is not known: `unknown shape; did you mean 'circle'?`, or which names there are.

    `what` is a phrase for it; put the name there where the value of the field is more than the name.
    """
    names = list(known)
    near = difflib.get_close_matches(name.lower(), names, n=1)
    if near:
        return f"unknown {what}; did you mean {near[0]!r}?"
    if len(names) > MAX_LISTED:
        return f"unknown {what}; `llm-flock run --help-all` and the configuration's reference list them"
    return f"unknown {what}; expected one of {', '.join(names) or '(there are none)'}"


def _value_text(value: object) -> str:
    """A value of any type, in one line."""
    try:
        return one_line(repr(value), MAX_SHOWN)
    except (ValueError, RecursionError):  # thousands of digits, or endless nesting
        return f"a value of type {type(value).__name__}, too large to show"


class MessageError(FlockError):
    """A message from a peer was rejected; `reason` is a short, stable word under which rejections are counted."""

    def __init__(self, reason: str, detail: str = "") -> None:
        self.reason = reason
        self.detail = detail
        super().__init__(f"{reason}: {detail}" if detail else reason)


class AnswerError(FlockError):
    """A model's answer cannot be used. The message is a reason that the model can act on."""


class ModelError(FlockError):
    """A provider did not give an answer.

    Attributes:
        kind: `timeout`, `rate_limit`, `server`, `connection`, `refused` (a 4xx other than 429),
            `garbage` (the response does not follow the provider's protocol) or `budget`.
        retry_after_s: waiting time that the provider asked for [s]; None if it did not.
        faults: kinds of all faults before the client gave up, in order.
        model: `provider:model` that failed, if it differs from the model that was asked (a replayed conversation).
    """

    def __init__(
        self, kind: str, detail: str, retry_after_s: float | None = None, faults: tuple[str, ...] = ()
    ) -> None:
        self.kind = kind
        self.detail = detail
        self.retry_after_s = retry_after_s
        self.faults = faults
        self.model: str | None = None
        super().__init__(f"{kind}: {detail}")


class BudgetExceeded(ModelError):
    """The run's own limit on calls, tokens or money is used up."""

    def __init__(self, detail: str) -> None:
        super().__init__("budget", detail)


class ReplayDrift(FlockError):
    """A replayed run sends a question that is missing from the recording, or recorded with other contents."""


class RecordError(FlockError):
    """A record cannot be read or written; the message is one line."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))
