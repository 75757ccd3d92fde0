"""Makes one call through pydantic-ai: our messages in, our reply or our ModelError out.

pydantic-ai's `direct.model_request` translates between providers. Its retries are off: `limits` retries transport
faults, and the planner asks again after answers that it cannot use.
"""

from __future__ import annotations

import html
import logging
import math
import re
import time
from collections.abc import Mapping
from itertools import groupby
from typing import Any, cast
from urllib.parse import unquote

import httpx2
from pydantic_ai import exceptions as pai
from pydantic_ai.direct import model_request
from pydantic_ai.messages import (
    ModelMessage,
    ModelRequest,
    ModelResponse,
    SystemPromptPart,
    TextPart,
    ThinkingPart,
    UserPromptPart,
)
from pydantic_ai.models import Model, ModelRequestParameters
from pydantic_ai.output import OutputObjectDefinition
from pydantic_ai.settings import ModelSettings

from llm_flock.errors import ModelError
from llm_flock.llm._dialect import Dialect, fault
from llm_flock.llm._port import Call, CallSettings, ChatMessage, Reply, Usage
from llm_flock.llm._providers import cost_usd
from llm_flock.llm._thoughts import spoken
from llm_flock.printable import printable, same_model

logger = logging.getLogger(__name__)

DETAIL_LENGTH = 400  # longest error text of a provider [characters]

CUT_OFF = frozenset({"max_tokens", "max_output_tokens", "max_length", "model_length", "context_length_exceeded"})
"""Finish reasons of some servers that mean `length`; pydantic-ai passes them on unchanged."""

BROKEN_OFF = frozenset({"error", "abort", "aborted", "cancelled", "failed", "insufficient_system_resource"})
"""Finish reasons that mean that the server broke the answer off."""

CHARACTERS_PER_TOKEN = 4  # as common tokenizers have in English text, on average

_SECONDS = re.compile(r"(?:^|retryDelay['\"]?\s*:\s*['\"])([0-9]{1,9}(?:\.[0-9]{1,9})?)s")

_FINISH_REASON = re.compile(r"[a-z][a-z_]{0,39}")

_KEY_LIKE = re.compile(r"\bsk-[A-Za-z0-9_*-]{6,}")
"""The form of providers' keys, including one that a provider returns half hidden by asterisks."""

_ESCAPE = re.compile(r"\\(?:u([0-9A-Fa-f]{4})|x([0-9A-Fa-f]{2})|[a-z])")


def scrub(text: str, secrets: tuple[str, ...]) -> str:
    """The text without any of the secrets and without anything that looks like a key.

    No server says a key with anything between its letters, or escaped, by chance: nothing of that text is passed on.
    """
    for secret in filter(None, secrets):
        text = text.replace(secret, "[key]")
    plain = re.sub(_ESCAPE, lambda one: chr(int(one[1] or one[2] or "20", 16)), text)
    # No letter has a number of eight digits; Python raises errors for numbers of thousands.
    plain = re.sub("&#[1-9][0-9]{7,}", "", re.sub("&#0+(?=[0-9])", "&#", unquote(plain)))
    plain = re.sub("<[^<>]*>", "", html.unescape(plain))
    for letters in (_letters(text), _letters(plain)):
        if any(len(key) >= 12 and key in letters for key in map(_letters, secrets)):  # fewer may be words
            return "[a text with a key in it]"
    return _KEY_LIKE.sub("[key]", text) if "sk-" in text else text


def _letters(text: str) -> str:
    return re.sub("[^0-9A-Za-z]", "", text)


class PydanticModel:
    """A `LanguageModel` on top of any pydantic-ai model; the models behind it may be shared by many robots.

    `secrets` are removed from every text that leaves this object. `priced` is whether the provider's prices apply.
    """

    def __init__(
        self,
        model: Model[Any],
        *,
        name: str,
        settings: CallSettings | None = None,
        secrets: tuple[str, ...] = (),
        priced: bool = False,
        dialect: Dialect | None = None,
    ) -> None:
        self._model = model
        self._dialect = dialect or Dialect(str(model.base_url), model.model_name)
        self.name = name
        self._provider = name.partition(":")[0]
        self._secrets = secrets
        self._price_list = self._provider if priced else None
        self._settings = (settings or CallSettings()).plain()

    async def ask(self, call: Call) -> Reply:
        """Answer one call, in one attempt, or more where the server refuses its form (`Dialect`).

        Every failure is a ModelError, whose text holds no key.
        """
        first = await self._dialect.turn()
        try:
            return await self._ask(call)
        finally:
            if first:
                self._dialect.learned()

    async def _ask(self, call: Call) -> Reply:
        started = time.perf_counter()
        try:
            response = await self._request(call)
            reply = self._reply(response, call, time.perf_counter() - started)
        except (pai.AgentRunError, pai.UserError, httpx2.HTTPError, TimeoutError, OSError) as error:
            wait_s = retry_after_s(error)
            asks = "" if wait_s is None else f"asks to wait {wait_s:g} s: "
            raise ModelError(error_kind(error), self._clean(asks + _describe(error)), wait_s) from None
        except Exception as error:  # noqa: BLE001 - SDKs may raise anything; it is logged, recorded and counted
            # A malformed body that the SDK's parser cannot read must not end the run of all robots.
            # `from None`, here and above: the original exception may quote the request's headers.
            detail = f"{type(error).__name__} while reading the response: {error}"
            logger.warning("robot %d, %s: %s", call.robot, self.name, self._clean(detail))
            raise ModelError("garbage", self._clean(detail)) from None
        if reply.finish_reason == "content_filter":
            refusal = (response.provider_details or {}).get("refusal") or "no reason given"
            raise ModelError("refused", self._clean(f"the provider's content filter stopped the answer: {refusal}"))
        if reply.finish_reason in BROKEN_OFF:
            raise ModelError("server", f"the provider broke the answer off ({reply.finish_reason})")
        return reply

    async def _request(self, call: Call) -> ModelResponse:
        """Send the call; once more, in another form, for each thing that the server refuses in it."""
        while True:
            settings = self._dialect.settings(self._settings)
            sent = {**settings, "roles": True} | ({"response_format": True} if call.schema is not None else {})
            try:
                return await model_request(
                    self._model,
                    to_model_messages(self._dialect.messages(call.messages)),
                    model_settings=_model_settings(settings, self._provider),
                    model_request_parameters=self._parameters(call.schema),
                )
            except pai.ModelHTTPError as error:
                body = cast("dict[str, Any] | None", error.body)
                words = (
                    " ".join(str(body[key]) for key in ("message", "param") if body.get(key))
                    if isinstance(body, dict)
                    else ""
                )
                unclear = error.status_code in (400, 422)
                if not self._dialect.refuses(self._clean(words or str(error)), sent, unclear=unclear):
                    raise

    def _parameters(self, schema: Mapping[str, Any] | None) -> ModelRequestParameters:
        if schema is None or "response_format" in self._dialect.without:
            return ModelRequestParameters()
        answer = OutputObjectDefinition(json_schema=dict(schema), name="answer")
        # DeepSeek and older Claude models accept no JSON schema: they are asked for JSON, and get the schema as text.
        native = self._model.profile.get("supports_json_schema_output", False)
        return ModelRequestParameters(output_mode="native" if native else "prompted", output_object=answer)

    def _reply(self, response: ModelResponse, call: Call, latency_s: float) -> Reply:
        used = response.usage
        usage = Usage.reported(used.input_tokens, used.output_tokens, used.cache_read_tokens)
        settings = self._dialect.settings(self._settings)
        if self._dialect.without:
            settings["without"] = [*self._dialect.without]
        if not usage.total:
            usage, settings["usage"] = estimated(call, response.text or ""), "estimated"
            self._dialect.say_once("reports no tokens: they are estimated at one for four characters")
        answer = spoken(response.text or "")
        # An unfinished thought stays, with its mark: the record shows the rejected text.
        raw = answer.text.lstrip() if answer.thought and not answer.unfinished else response.text or ""
        text = _encodable(scrub(raw, self._secrets))
        # A server may return anything as its model's name, even the key.
        answered_by = _encodable(scrub(response.model_name or "", self._secrets)[:100])
        answered_by = answered_by or self.name.partition(":")[2]
        model = f"{self._provider}:{answered_by}"
        if not same_model(self.name, model):  # some servers answer to any name
            self._dialect.say_once(f"answers as {printable(answered_by)}, which the record has")
        return Reply(
            text=text,
            model=model,
            settings=settings,
            usage=usage,
            cost_usd=cost_usd(self._price_list, answered_by, usage),
            latency_s=latency_s,
            finish_reason=finish_reason(response),
            thought=answer.thought or _has_thoughts(response),
        )

    def _clean(self, text: str) -> str:
        # Scrub before cutting: half a key would not be recognised.
        text = _encodable(" ".join(scrub(text, self._secrets).split()))
        return text if len(text) <= DETAIL_LENGTH else text[: DETAIL_LENGTH - 3] + "..."


def _encodable(text: str) -> str:
    """The text without lone surrogates, which UTF-8 and the records cannot hold."""
    return text if text.isascii() else text.encode("utf-8", "replace").decode("utf-8")


def finish_reason(response: ModelResponse) -> str | None:
    """The reason why a model stopped: `stop`, `length`, `content_filter`, one of BROKEN_OFF, or the server's word."""
    if response.finish_reason is not None:
        return response.finish_reason
    word = str((response.provider_details or {}).get("finish_reason", "")).lower()
    if word in CUT_OFF:
        return "length"
    # Anthropic streams long answers, and every whole one has a reason: without it, the stream broke off.
    if not word and (response.state in ("incomplete", "interrupted") or response.provider_name == "anthropic"):
        return "aborted"
    return word if _FINISH_REASON.fullmatch(word) else None


def _has_thoughts(response: ModelResponse) -> bool:
    """Whether the response has thoughts apart from its text; some providers only count their tokens."""
    counted = response.usage.details.get("reasoning_tokens", 0)
    return counted > 0 or any(isinstance(part, ThinkingPart) for part in response.parts)


def error_kind(error: Exception) -> str:
    """The ModelError kind of an exception from pydantic-ai or from the HTTP client below it."""
    match error:
        case pai.ModelTimeoutError() | pai.ModelRequestTimeout() | httpx2.TimeoutException() | TimeoutError():
            return "timeout"
        case pai.ModelRateLimitError():
            return "rate_limit"
        case pai.ModelUnavailableError() | pai.ModelServerError():
            return "server"
        case httpx2.DecodingError():
            return "garbage"
        case pai.ModelConnectionError() if isinstance(_origin(error), httpx2.DecodingError):
            return "garbage"
        case pai.ModelConnectionError() | httpx2.HTTPError() | OSError():
            return "connection"
        case pai.ModelQuotaExceededError() | pai.ModelRequestRejectedError() | pai.ContentFilterError():
            return "refused"
        case pai.ModelHTTPError(status_code=status):
            return "server" if status >= 500 else {408: "timeout", 429: "rate_limit"}.get(status, "refused")
        case pai.UserError():
            return "refused"  # a feature that the model lacks, which a retry does not change
        case pai.ModelAPIError() if getattr(_origin(error), "status_code", 0) in (301, 302, 307, 308):
            return "refused"
        case _:
            return "garbage"


def retry_after_s(error: Exception) -> float | None:
    """The wait that a provider asks for [s]: in a header, or in the body as Gemini's `retryDelay`; None without one."""
    if isinstance(error, pai.ModelAPIError) and error.retry_after is not None:
        return error.retry_after
    if isinstance(error, pai.ModelHTTPError):
        header = (error.headers or {}).get("retry-after", "") + "s"  # pydantic-ai reads whole seconds and dates
        for text in (header, str(error.body)):
            if found := _SECONDS.search(text):
                return float(found[1])
    return None


def estimated(call: Call, answer: str) -> Usage:
    """Tokens of a call whose server reports none: a token for each four characters."""
    asked = sum(len(message.text) for message in call.messages)
    return Usage.reported(math.ceil(asked / CHARACTERS_PER_TOKEN), math.ceil(len(answer) / CHARACTERS_PER_TOKEN))


def _describe(error: Exception) -> str:
    """One line about an exception, with the transport's cause if pydantic-ai only has "Connection error."."""
    text, cause = str(error) or type(error).__name__, _origin(error)
    if isinstance(error, pai.ModelConnectionError) and cause is not error:
        text += f" ({type(cause).__name__}: {cause})"
    advice = fault(text).get("advice") if isinstance(error, pai.ModelAPIError) else None
    return f"{advice}: {text}" if advice else text


def _origin(error: BaseException) -> BaseException:
    """The first exception of a chain of causes."""
    while error.__cause__ is not None:
        error = error.__cause__
    return error


def to_model_messages(messages: tuple[ChatMessage, ...]) -> list[ModelMessage]:
    """A conversation in pydantic-ai's form: the messages between two answers are one request."""
    out: list[ModelMessage] = []
    for answers, group in groupby(messages, key=lambda message: message.role == "assistant"):
        if answers:
            out += [ModelResponse(parts=[TextPart(message.text)]) for message in group]
        else:
            parts = [(SystemPromptPart if m.role == "system" else UserPromptPart)(m.text) for m in group]
            out.append(ModelRequest(parts=parts))
    return out


def _model_settings(settings: dict[str, Any], provider: str) -> ModelSettings | None:
    out = dict(settings)
    limit = out.pop("max_completion_tokens", None)
    if limit is not None:
        out["extra_body"] = {"max_completion_tokens": limit}
    effort = out.pop("reasoning", None)
    if effort is not None and provider == "anthropic":
        out["thinking"] = False if effort == "none" else effort
    elif effort is not None:
        # pydantic-ai drops its unified `thinking` for models that it does not know as reasoning models, such as most
        # local ones. This field is always sent.
        out["openai_reasoning_effort"] = effort
    return cast(ModelSettings, out) if out else None
