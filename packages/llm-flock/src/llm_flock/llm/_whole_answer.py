"""Whether a reply holds a whole answer: an answer that was cut off is never read, nor is a thought.

A cut in the middle of `Position: [51.2, 4` cannot be read anyway, but `Path: [[51.2, 4], [` or a draft before the
answer could be, and nobody can see whether `Position: [51.2, 4]` was meant to go on. So the provider's word counts.
"""

from __future__ import annotations

from llm_flock.errors import AnswerError
from llm_flock.llm._port import Reply
from llm_flock.llm._thoughts import spoken

MAX_QUOTED = 20_000
"""Longest answer that is quoted to the model [characters]; a runaway answer must not fill every later request."""

NO_TEXT = "(no text)"
"""Stands for an empty answer in the conversation: providers refuse empty messages."""


def whole_answer(reply: Reply) -> str:
    """What the model says, to be read as its answer. Call on every reply before reading it.

    Raises:
        AnswerError: the answer was cut off or filtered, or the model thought and did not answer.
    """
    said = spoken(reply.text)
    cut = reply.finish_reason == "length"
    empty = said.unfinished or not said.text.strip()
    if empty and (cut or reply.thought or said.thought):
        raise AnswerError(_only_thoughts(reply, cut=cut))
    if cut:
        raise AnswerError(f"it was cut off{_length(reply)} before it was complete; answer more briefly.")
    if reply.finish_reason == "content_filter":
        raise AnswerError("the provider's content filter stopped it before it was complete.")
    return said.text


def quoted(reply: Reply) -> str:
    """What the model said, for its own conversation: without thoughts, of limited length, and never empty."""
    said = spoken(reply.text).text
    return said[:MAX_QUOTED] if said.strip() else NO_TEXT


def _only_thoughts(reply: Reply, *, cut: bool) -> str:
    story = f"it was cut off{_length(reply)} while you were still thinking" if cut else "it holds nothing but thoughts"
    cap = reply.settings.get("max_tokens")
    limit = "" if cap is None else f" (a cap of {cap} tokens for thoughts and answer together may be too low)"
    return f"{story}: you thought but did not answer{limit}; think less, and give the answer itself."


def _length(reply: Reply) -> str:
    tokens = reply.usage.output
    return f" at {tokens} {'token' if tokens == 1 else 'tokens'}" if tokens else ""
