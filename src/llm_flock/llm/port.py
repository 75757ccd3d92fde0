"""The port between planners and language models: one method, plain values on both sides."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, TypeAlias

Role: TypeAlias = Literal["system", "user", "assistant"]
Kind: TypeAlias = Literal["plan", "step"]


@dataclass(frozen=True, slots=True)
class ChatMessage:
    """One message of a conversation."""

    role: Role
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Usage:
    """Tokens of one or many calls; `cached` is the part of `input` that the provider had in its cache."""

    input: int = 0
    output: int = 0
    cached: int = 0

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
    """What an answer may look like, for models that can be held to it while they write.

    Attributes:
        n: places that a plan must have.
        dim: coordinates of a point.
        horizon: positions that a path may have; with 1 a step is a single position.
        json: a JSON object instead of the paper's lines.
        reasons: the prompts ask for a reason before the answer.
    """

    n: int
    dim: int
    horizon: int = 1
    json: bool = False
    reasons: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """One question to a model.

    Attributes:
        robot: whose conversation this is.
        round: motion round.
        kind: what is asked.
        attempt: 0 for the first try, then 1, 2, ... as rejected answers are sent back.
        messages: the whole conversation that the model sees.
        schema: JSON schema of the answer where structured answers are on, else None.
        form: what the answer may look like. It is told by the messages as well, and no part of `request_hash`.
    """

    robot: int
    round: int
    kind: Kind
    attempt: int
    messages: tuple[ChatMessage, ...]
    schema: Mapping[str, Any] | None = None
    form: AnswerForm | None = None

    @property
    def request_hash(self) -> str:
        """16 hexadecimal digits over everything that the model sees."""
        content = json.dumps([[m.role, m.text] for m in self.messages] + [self.schema], sort_keys=True)
        return hashlib.blake2b(content.encode(), digest_size=8).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What a model answered.

    Attributes:
        text: the raw answer.
        model: `provider:model` that really answered.
        settings: sampling settings that were sent (temperature, seed, ...).
        usage: tokens of this call.
        cost_usd: price of this call [US dollars], None where no price is known.
        latency_s: from the first try to the answer, waits for retries included [s].
        faults: kinds of the transport faults that were retried before this answer came, in order.
    """

    text: str
    model: str
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    usage: Usage = Usage()
    cost_usd: float | None = None
    latency_s: float = 0.0
    faults: tuple[str, ...] = ()


class LanguageModel(Protocol):
    """Anything that answers calls. Raises ModelError when it cannot."""

    @property
    def name(self) -> str:
        """`provider:model`, as configured."""
        ...

    async def ask(self, call: Call) -> Reply:
        """Answer one call.

        Raises:
            ModelError: no answer could be had.
            ReplayDrift: a replayed conversation differs.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One call and all that came of it: the line of a cassette and of a record's `/llm` channel.

    Attributes:
        call: what was asked.
        reply: what came back, None when the provider gave no answer.
        parsed: the accepted value (`{"plan": [...], "slot": 0}` or `{"waypoint": [...]}`, for a path
            with what follows as `"path"`), None when rejected.
        rejected: why the answer was not accepted, in the words that went back to the model.
        error: kind and detail of the ModelError, None when there was a reply.
        faults: transport faults met on the way, answered or not.
        latency_s: duration of the whole attempt [s].
    """

    call: Call
    model: str
    reply: Reply | None = None
    parsed: Mapping[str, Any] | None = None
    rejected: str | None = None
    error: tuple[str, str] | None = None
    faults: tuple[str, ...] = ()
    latency_s: float = 0.0


class AttemptSink(Protocol):
    """Told of every attempt as soon as it is over."""

    def __call__(self, attempt: Attempt, /) -> None:
        """Take note of one attempt."""
        ...
