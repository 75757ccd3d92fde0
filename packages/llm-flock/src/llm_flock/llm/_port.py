"""The port between planners and language models: one method, with plain values on both sides."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Annotated, Any, Literal, Protocol, TypeAlias

from pydantic import ConfigDict, Field

from llm_flock.errors import ModelError

Role: TypeAlias = Literal["system", "user", "assistant"]
Kind: TypeAlias = Literal["plan", "step", "judgement"]
Effort: TypeAlias = Literal["none", "minimal", "low", "medium", "high", "xhigh", "max"]
"""Reasoning effort, as providers name it."""
FrameName: TypeAlias = Literal["world", "own"]
"""Coordinates of a prompt: those of the world, or the robot's own (`llm_flock.llm._frame`)."""


@dataclass(frozen=True, slots=True)
class ChatMessage:
    """One message of a conversation."""

    role: Role
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CallSettings:
    """Sampling settings; None leaves the provider's default. `max_tokens` limits reasoning and answer together."""

    temperature: float | None = None
    seed: int | None = None
    reasoning: Effort | None = None
    max_tokens: int | None = None

    def plain(self) -> dict[str, Any]:
        """The settings that are not None, as in records."""
        return {name: value for name, value in asdict(self).items() if value is not None}


MAX_TOKENS = 10**9
"""Most tokens of one call that are believed, in each direction, so that sums of calls fit into a record."""

Count: TypeAlias = Annotated[int, Field(ge=0, le=MAX_TOKENS)]
Amount: TypeAlias = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
CHECKED = ConfigDict(strict=True, revalidate_instances="always")
"""How pydantic checks values from other people's code or files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Usage:
    """Tokens of one or many calls; `cached` is the part of `input` that came from the provider's cache."""

    __pydantic_config__ = CHECKED

    input: Count = 0
    output: Count = 0
    cached: Count = 0

    @classmethod
    def reported(cls, tokens_in: int, tokens_out: int, cached: int = 0) -> Usage:
        """The tokens of one call as a provider reports them, limited to 0 to `MAX_TOKENS`: it may report anything."""
        read, written, known = (min(max(0, count), MAX_TOKENS) for count in (tokens_in, tokens_out, cached))
        return cls(input=read, output=written, cached=known)

    def __add__(self, other: Usage) -> Usage:
        return Usage(
            input=self.input + other.input, output=self.output + other.output, cached=self.cached + other.cached
        )

    @property
    def total(self) -> int:
        """Input and output together."""
        return self.input + self.output


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerForm:
    """The form of an answer, for reading it and for constraining a model that writes it.

    A `horizon` of 1 means a single position, `letters` one letter of these, `reasons` a reason before the answer,
    `program` a formation program in JSON instead of the places of a plan, `edit` changes of one by path, or why it
    cannot be drawn, `choices` the names of options.
    """

    n: int
    dim: int
    horizon: int = 1
    json: bool = False
    reasons: bool = True
    letters: str = ""
    program: bool = False
    edit: bool = False
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """One question to a model."""

    robot: int
    round: int
    kind: Kind
    attempt: int  #: 0, then 1, 2, ... after rejected answers.
    messages: tuple[ChatMessage, ...]  #: The whole conversation that the model sees.
    schema: Mapping[str, Any] | None = None  #: JSON schema of the answer, None for answers as text.
    form: AnswerForm | None = None  #: Form of the answer. The messages state it too, so `request_hash` leaves it out.
    probe: bool = False  #: Whether this question only tests if a model has recovered from unusable answers.

    @property
    def request_hash(self) -> str:
        """16 hexadecimal digits of everything that the model sees."""
        content = json.dumps([[m.role, m.text] for m in self.messages] + [self.schema], sort_keys=True)
        return hashlib.blake2b(content.encode(), digest_size=8).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """An answer of a model."""

    __pydantic_config__ = CHECKED

    text: str  #: The answer as written, without finished thoughts.
    model: str  #: `provider:model` that answered.
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    usage: Usage = Usage()
    cost_usd: Amount | None = None  #: Price of this call [US dollars], None where no price is known.
    latency_s: Amount = 0.0  #: From the first attempt to the answer, waits for retries included [s].
    faults: tuple[str, ...] = ()  #: Kinds of the transport faults that were retried before this answer, in order.
    #: The reason why the model stopped (`stop`, `length`, ...), None if the provider gives none.
    finish_reason: str | None = None
    #: Whether it wrote thoughts, which are not part of the text, before the answer or instead of one.
    thought: bool = False


class LanguageModel(Protocol):
    """Answers calls."""

    @property
    def name(self) -> str:
        """`provider:model`, as configured."""
        ...

    async def ask(self, call: Call) -> Reply:
        """Answer one call; ModelError if there is no answer, ReplayDrift if a replayed conversation differs."""
        ...


class Answers(Protocol):
    """The one method that a model of the user's own needs; it may also have `aclose` and `simulated = True`."""

    async def ask(self, call: Call) -> Reply | str:
        """Answer one call. Any exception counts as a failed call."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One call and its outcome: a line of a cassette and of a record's `/llm` channel."""

    call: Call
    reply: Reply  #: Without an answer, only the model, the faults and the duration.
    #: The accepted value (`{"plan": [...], "slot": 0}` or `{"waypoint": [...]}`, with the rest of a path as `"path"`),
    #: None when rejected.
    parsed: Mapping[str, Any] | None = None
    rejected: str | None = None  #: The reason for a rejection, as sent back to the model.
    clipped: str | None = None  #: The reason why a step is only flown clipped.
    error: tuple[str, str] | None = None  #: Kind and detail of the ModelError, None with an answer.

    @classmethod
    def failed(cls, call: Call, error: ModelError, name: str, latency_s: float = 0.0) -> Attempt:
        """A call without an answer from the model of this name."""
        reply = Reply(text="", model=error.model or name, faults=error.faults, latency_s=latency_s)
        return cls(call=call, reply=reply, error=(error.kind, error.detail))

    def told(self) -> dict[str, Any]:
        """The fields of the attempt, its call and its reply, by name: the content of cassettes and records."""
        values = (self, self.call, self.reply)
        told = {field.name: getattr(value, field.name) for value in values for field in fields(value)}
        told |= {"request_hash": self.call.request_hash, "settings": dict(self.reply.settings)}
        return told | {"text": self.reply.text if self.error is None else None}


AttemptSink: TypeAlias = Callable[[Attempt], None]
"""Receives every attempt as soon as it is over."""
