"""Makes a plain chat completion of whatever a server sends with status 200.

Servers leave fields out, send them with other types, in another protocol, as a stream that was not asked for, or report
an error in place of an answer. What carries readable text is used. An error gets the status that says its kind, and
keeps its words.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import httpx2

from llm_flock.llm._dialect import fault

_TEXT_FIELDS = ("content", "text", "response", "generated_text", "output_text", "parts")
_WRAPPERS = ("data", "result", "output", "body", "completion")
_THOUGHTS = ("reasoning_content", "reasoning", "thinking")
_ERRORS = ("message", "msg", "detail", "error_msg", "error_message", "base_resp", "promptFeedback")
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
    error: object = None
    """What the body calls an error."""
    complaint: object = None
    """A body that is an error in another form, if there is no message."""


def chat_completion(body: bytes) -> tuple[int, bytes]:
    """The status and the body of a plain chat completion, or of an error of the server in its own words.

    Raises:
        httpx2.DecodingError: the body carries neither readable text nor an error.
    """
    text = body.decode("utf-8-sig", errors="replace").strip()
    parts, streamed = _parts(text)
    answer = _Answer()
    for part in parts:
        _collect(part, answer)
    error = answer.error or (None if answer.found else answer.complaint)
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
    lines = [line.strip() for line in text.split("\n")]
    kept = [line for line in lines if line and not line.startswith((":", "event:", "id:", "retry:"))]
    for whole in (text, "\n".join(kept)):
        for value in _decoded([whole]):
            return cast(list[object], value) if isinstance(value, list) else [value], False
    events = list(_decoded(line.removeprefix("data:") for line in kept))
    return events, bool(events)


def _decoded(texts: Iterable[str]) -> Iterator[object]:
    """The values of the texts that are JSON."""
    for text in texts:
        try:
            yield json.loads(text, strict=False)
        except (ValueError, RecursionError):
            continue


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
        choices = [*_mappings(body.get("choices")), *_mappings(body.get("candidates"))]
        errors = (holder.get(name) for holder in (body, *choices) for name in ("error", "errors"))
        answer.error = answer.error or next(filter(None, errors), None)
        words = (body.get(name) for name in _ERRORS if isinstance(body.get(name), str | list | Mapping))
        answer.complaint = answer.complaint or (body if any(words) else None)
        known = answer.found
        if choices or "choices" not in body:
            _message((choices or [body])[0], answer)
        for name in _WRAPPERS if not choices and answer.found == known else ():
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
    answer.thoughts += [thought for name in _THOUGHTS if isinstance(thought := message.get(name), str) and thought][:1]
    if isinstance(refusal := message.get("refusal"), str) and refusal:
        answer.refusal, answer.found = refusal, True
    if inside and ("content" in message or "reasoning_content" in message or not message):
        answer.found = True
    for name in _TEXT_FIELDS:
        if isinstance(message.get(name), str | list | Mapping):
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
    nested = {
        name: _counts(cast(Mapping[str, Any], value)) for name, value in usage.items() if isinstance(value, Mapping)
    }
    numbers = {name: value for name, value in usage.items() if type(value) in (int, float) and math.isfinite(value)}
    return nested | {name: max(0, int(value)) for name, value in numbers.items()}


def _status(error: object) -> int:
    """The status of HTTP for an error: its own code, or else by its words."""
    for one in _mappings(error):
        for name in ("code", "status", "status_code"):
            if re.fullmatch("[45][0-9]{2}", code := str(one.get(name))):
                return int(code)
    return int(fault(json.dumps(error))["status"])
