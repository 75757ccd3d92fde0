"""The port between planners and language models: one method, plain values on both sides."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Annotated, Any, Literal, Protocol, TypeAlias

from pydantic import ConfigDict, Field

from llm_flock.errors import ModelError

Role: TypeAlias = Literal["system", "user", "assistant"]
Kind: TypeAlias = Literal["plan", "step"]
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
    """Sampling settings; None leaves the provider's default.

    Attributes:
        temperature: 0 for the likeliest answer; reasoning models ignore or refuse it.
        seed: for repeatable sampling, where the provider supports it.
        max_tokens: longest answer, reasoning included.
    """

    temperature: float | None = None
    seed: int | None = None
    reasoning: Effort | None = None
    max_tokens: int | None = None

    def plain(self) -> dict[str, Any]:
        """The settings without defaults, as they go into records."""
        return {name: value for name, value in asdict(self).items() if value is not None}


MAX_TOKENS = 10**9
"""Most tokens that are believed of one call, in each direction: sums of calls have room in a record."""

Count: TypeAlias = Annotated[int, Field(ge=0, le=MAX_TOKENS)]
Amount: TypeAlias = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
CHECKED = ConfigDict(strict=True, revalidate_instances="always")
"""How pydantic checks what code or files of others hold, where it is asked to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Usage:
    """Tokens of one or many calls; `cached` is the part of `input` that the provider had in its cache."""

    __pydantic_config__ = CHECKED

    input: Count = 0
    output: Count = 0
    cached: Count = 0

    @classmethod
    def reported(cls, tokens_in: int, tokens_out: int, cached: int = 0) -> Usage:
        """What a provider says that one call took, kept within 0 and `MAX_TOKENS`: it may say anything."""
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
    """The form of an answer, to read it, and to hold a model to it while it writes.

    A `horizon` of 1 asks for a single position, `letters` for one of them. `reasons`: the prompts ask for one before.
    """

    n: int
    dim: int
    horizon: int = 1
    json: bool = False
    reasons: bool = True
    letters: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """One question to a model.

    Attributes:
        robot: its id.
        round: motion round.
        attempt: 0 for the first try, then 1, 2, ... as rejected answers are sent back.
        probe: whether the model's last answers could not be used, so that this is a try whether it has recovered.
        messages: the whole conversation that the model sees.
        schema: JSON schema of the answer where structured answers are on, else None.
        form: form of the answer. The messages state it too, so `request_hash` leaves it out.
    """

    robot: int
    round: int
    kind: Kind
    attempt: int
    messages: tuple[ChatMessage, ...]
    schema: Mapping[str, Any] | None = None
    form: AnswerForm | None = None
    probe: bool = False

    @property
    def request_hash(self) -> str:
        """16 hexadecimal digits of everything that the model sees."""
        content = json.dumps([[m.role, m.text] for m in self.messages] + [self.schema], sort_keys=True)
        return hashlib.blake2b(content.encode(), digest_size=8).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """An answer of a model.

    Attributes:
        text: the answer as it was written, without thoughts that have an end.
        model: `provider:model` that answered.
        settings: how it was sampled (temperature, seed, ...).
        cost_usd: price of this call [US dollars], None where no price is known.
        latency_s: from the first try to the answer, waits for retries included [s].
        faults: kinds of the transport faults that were retried before this answer came, in order.
        finish_reason: why the model stopped writing (`stop`, `length`, ...), None where the provider does not say.
        thought: whether it thought before it answered: thoughts are not part of the text, but may be all there is.
    """

    __pydantic_config__ = CHECKED

    text: str
    model: str
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    usage: Usage = Usage()
    cost_usd: Amount | None = None
    latency_s: Amount = 0.0
    faults: tuple[str, ...] = ()
    finish_reason: str | None = None
    thought: bool = False


class LanguageModel(Protocol):
    """Anything that answers calls."""

    @property
    def name(self) -> str:
        """`provider:model`, as configured."""
        ...

    async def ask(self, call: Call) -> Reply:
        """Answer one call; ModelError if there is no answer, ReplayDrift if a replayed conversation differs."""
        ...


class Answers(Protocol):
    """All that a model of the user's own needs; it may also have `aclose`, and say that it is `simulated`."""

    async def ask(self, call: Call) -> Reply | str:
        """Answer one call. Whatever it raises counts as a failed call."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One call and its outcome: a line of a cassette and of a record's `/llm` channel.

    Attributes:
        reply: without text if there was no answer; then it tells who was asked, the faults and the duration.
        parsed: the accepted value (`{"plan": [...], "slot": 0}` or `{"waypoint": [...]}`, with the rest of a path as
            `"path"`), None when rejected.
        rejected: why the answer was rejected, in the words that went back to the model.
        clipped: why the answer, a step, is only flown clipped; None otherwise.
        error: kind and detail of the ModelError, None when there was an answer.
    """

    call: Call
    reply: Reply
    parsed: Mapping[str, Any] | None = None
    rejected: str | None = None
    clipped: str | None = None
    error: tuple[str, str] | None = None

    @classmethod
    def failed(cls, call: Call, error: ModelError, name: str, latency_s: float = 0.0) -> Attempt:
        """A call to the model of this name that got no answer."""
        reply = Reply(text="", model=error.model or name, faults=error.faults, latency_s=latency_s)
        return cls(call=call, reply=reply, error=(error.kind, error.detail))

    def told(self) -> dict[str, Any]:
        """Its fields, and those of the call and the reply, by name: what cassettes and records hold."""
        values = (self, self.call, self.reply)
        told = {field.name: getattr(value, field.name) for value in values for field in fields(value)}
        told |= {"request_hash": self.call.request_hash, "settings": dict(self.reply.settings)}
        return told | {"text": self.reply.text if self.error is None else None}


AttemptSink: TypeAlias = Callable[[Attempt], None]
"""Receives every attempt as soon as it is over."""
