"""Makes a plain chat completion of whatever a server sends with status 200.

Servers leave fields out, send them with other types, in another protocol, as a stream that was not asked for, or report
an error in place of an answer. What carries readable text is used. An error gets the status that says its kind, and
keeps its words.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import httpx2

_KINDS = (
    (429, ("rate limit", "rate_limit", "ratelimit", "throttl", "too many requests", "request limit")),
    (402, ("quota", "balance", "credit", "billing", "payment")),
    (404, ("not found", "does not exist", "no such model")),
    (401, ("api key", "api_key", "unauthorized", "authentication", "permission")),
    (400, ("context", "too long", "too large", "policy", "policies", "filter", "flagged", "invalid", "unsupported")),
)
"""Status codes by words of an error; any other error is the server's."""

_TEXT_FIELDS = ("content", "text", "response", "generated_text", "output_text", "parts")
_WRAPPERS = ("data", "result", "output", "body", "completion")
_THOUGHTS = ("reasoning_content", "reasoning", "thinking")
_QUOTED = 120


@dataclass(slots=True)
class _Answer:
    """What has been found in a body."""

    text: list[str] = field(default_factory=list[str])
    thoughts: list[str] = field(default_factory=list[str])
    refusal: str | None = None
    finish: str | None = None
    usage: dict[str, Any] = field(default_factory=dict[str, Any])
    model: str = ""
    found: bool = False
    """Whether there is a message, even if it is empty."""


def chat_completion(body: bytes) -> tuple[int, bytes]:
    """The status and the body of a plain chat completion, or of an error of the server in its own words.

    Raises:
        httpx2.DecodingError: the body carries neither readable text nor an error.
    """
    text = body.decode("utf-8-sig", errors="replace").strip()
    parts, streamed = _parts(text)
    error = next((found for part in parts if (found := _error(part)) is not None), None)
    answer = _Answer()
    if error is None:
        for part in parts:
            _collect(part, answer)
    if error is None and not answer.found:
        error = next((found for part in parts if (found := _loose_error(part)) is not None), None)
    if error is None and streamed and answer.found and answer.finish is None and "[DONE]" not in text:
        error = {"message": "the stream broke off before its end"}
    if error is not None:
        return _status(error), json.dumps({"error": error}).encode()
    if not answer.found:
        raise httpx2.DecodingError(f"no readable text in the response: {text[:_QUOTED] or 'it is empty'}")
    message = {"role": "assistant", "content": "".join(answer.text), "refusal": answer.refusal}
    if answer.thoughts:
        message["reasoning_content"] = "".join(answer.thoughts)
    choice = {"index": 0, "finish_reason": answer.finish, "message": message}
    plain = {"id": "", "object": "chat.completion", "created": 0, "model": answer.model, "choices": [choice]}
    return 200, json.dumps(plain | ({"usage": answer.usage} if answer.usage else {})).encode()


def _parts(text: str) -> tuple[list[object], bool]:
    """The JSON values of a body, and whether it is a stream: one value, a list of chunks, events, or a value a line."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        pass
    else:
        parts = cast(list[object], value) if isinstance(value, list) else [value]
        return parts, False
    found: list[object] = []
    streamed = False
    lines = [line.strip() for line in text.split("\n")]
    kept = [line for line in lines if line and not line.startswith((":", "event:", "id:", "retry:"))]
    if not any(line.startswith("data:") for line in kept):
        try:  # comments before one value that takes several lines
            return [json.loads("\n".join(kept))], False
        except (ValueError, RecursionError):
            pass
    for line in kept:
        try:
            found.append(json.loads(line.removeprefix("data:")))
            streamed = True
        except (ValueError, RecursionError):
            continue
    return found, streamed


def _mappings(values: object) -> Iterator[Mapping[str, Any]]:
    """The objects of a value that should be a list of objects."""
    for value in cast(Iterable[object], values if isinstance(values, list) else [values]):
        if isinstance(value, Mapping):
            yield cast(Mapping[str, Any], value)


def _collect(part: object, answer: _Answer) -> None:
    """Add what one value of a body holds."""
    for body in _mappings(part):
        if not answer.model and isinstance(name := body.get("model"), str):
            answer.model = name
        for usage in _mappings(body.get("usage")):
            if counts := _counts(usage):
                read, written = counts.get("prompt_tokens", 0), counts.get("completion_tokens", 0)
                exact = {"prompt_tokens": read, "completion_tokens": written, "total_tokens": read + written}
                answer.usage = counts | exact
        choices = list(_mappings(body.get("choices"))) or list(_mappings(body.get("candidates")))
        if choices:
            _message(choices[0], answer)
        elif "choices" not in body:
            known = answer.found
            _message(body, answer)
            for name in _WRAPPERS if answer.found == known else ():
                _collect(body.get(name), answer)


def _message(choice: Mapping[str, Any], answer: _Answer) -> None:
    """Add the message of a choice, of a chunk, or of a body that is one itself."""
    for name in ("finish_reason", "finishReason", "done_reason", "stop_reason"):
        reason: object = choice.get(name)
        if isinstance(reason, Mapping):
            reason = cast(Mapping[str, object], reason).get("type")
        if isinstance(reason, str) and reason:
            answer.finish = reason.lower()
    if choice.get("done") is True and answer.finish is None:
        answer.finish = "stop"
    inside = [choice[name] for name in ("message", "delta", "content") if isinstance(choice.get(name), Mapping)]
    message = cast(Mapping[str, Any], inside[0]) if inside else choice
    for name in _THOUGHTS:
        if isinstance(thought := message.get(name), str) and thought:
            answer.thoughts.append(thought)
            break
    if isinstance(refusal := message.get("refusal"), str) and refusal:
        answer.refusal, answer.found = refusal, True
    if inside and ("content" in message or "reasoning_content" in message or not message):
        answer.found = True
    for name in _TEXT_FIELDS:
        if name in message and isinstance(message[name], str | list | Mapping):
            answer.found = True
            _text(message[name], answer)
            return


def _text(content: object, answer: _Answer) -> None:
    """Add the text of a message: a string, or parts of which some are thoughts."""
    if isinstance(content, str):
        answer.text.append(content)
    elif isinstance(content, list):
        for part in cast(list[object], content):
            _text(part, answer)
    elif isinstance(content, Mapping):
        part = cast(Mapping[str, Any], content)
        if part.get("type") in ("thinking", "reasoning") or part.get("thought") is True:
            answer.thoughts.append(json.dumps(part)[:_QUOTED])
        else:
            _text(part.get("text"), answer)


def _counts(usage: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of a usage as whole numbers from 0; everything else is left out."""
    out: dict[str, Any] = {}
    for name, value in usage.items():
        if isinstance(value, Mapping):
            out[name] = _counts(cast(Mapping[str, Any], value))
            continue
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            continue
        out[name] = max(0, int(number)) if math.isfinite(number) and not isinstance(value, bool) else 0
    return out


def _error(part: object) -> object | None:
    """The error that a value reports, at its top or in a choice; None if it reports none."""
    for body in _mappings(part):
        for holder in (body, *_mappings(body.get("choices"))):
            for name in ("error", "errors"):
                if holder.get(name):
                    return holder[name]
    return None


def _loose_error(part: object) -> object | None:
    """An error in another form, where there is no answer."""
    for body in _mappings(part):
        words = (body.get(name) for name in ("message", "msg", "detail", "error_msg", "error_message", "base_resp"))
        if any(word and isinstance(word, str | list | Mapping) for word in words):
            return body
    return None


def _status(error: object) -> int:
    """The status of HTTP for an error: its own code, or else by its words."""
    for one in _mappings(error):
        for name in ("code", "status", "status_code"):
            code = str(one.get(name, ""))
            if code.isdecimal() and code.isascii() and 400 <= int(code[:4]) < 600:
                return int(code[:4])
    words = json.dumps(error).lower()
    return next((status for status, signs in _KINDS if any(sign in words for sign in signs)), 500)
