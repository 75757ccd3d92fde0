"""Separates a model's thoughts from its answer: thoughts hold drafts, which must never be read as the answer.

Servers should send thoughts separately, but many leave them in the text, with their marks: `<think>...</think>`
(DeepSeek R1, Qwen3) and its relatives, `[THINK]` (Magistral), `◁think▷` (Kimi), and channels (gpt-oss; Gemma). Some
drop the opening mark, which was part of the prompt. Some drop the special tokens of channels, so that `analysis` and
`assistantfinal` stick to the text. The time is linear in the length of the text.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from llm_flock.errors import AnswerError
from llm_flock.llm._port import Reply

MAX_CHARS = 1_000_000  # longer answers are not read

MAX_QUOTED = 20_000
"""Longest answer that is quoted to the model [characters]; a runaway answer must not fill every later request."""

NO_TEXT = "(no text)"  # replaces an empty answer in the conversation, because providers refuse empty messages
TAIL = 800  # how much of the end of an answer that was cut off is looked at [characters]

REPEATS = 4
MIN_REPEATED = 24
"""How often the same words end an answer that repeats itself, and how long they are together [characters]."""

ECHOED = 30  # shortest line that is a repetition of the question [characters]

_MARK = re.compile(
    r"<(?P<bar>\|?)\s*+(?P<close>/?)\s*+(?P<turn>(?:START|END|begin_of|end_of)_)?(?:[a-z]{1,12}[:_]){0,2}"
    r"(?P<name>(?:ant)?think(?:ing)?|thoughts?|reasoning|scratch_?pad|reflection|analysis|monologue|cot)"
    r"(?:\s[^<>]{0,80})?(?P=bar)>"
    r"|\[(?P<close_1>/?)(?P<name_1>think|thought|reasoning)\]"
    r"|◁(?P<close_2>/?)(?P<name_2>think)▷"
    r"|(?:<\|(?P<name_3>channel)>thought|<(?P<close_3>channel)\|>)"
    r"|(?:<(?P<name_4>unused)94>|<(?P<close_4>unused)95>)"
    r"|<(?P<name_5>details)[^<>]{0,80}>\s{0,20}<summary>[^<>]{0,60}(?:reason|think|thought|work)|<(?P<close_5>/details)>"
    r"|(?P<fence>```+)(?P<name_6>think|thought|reasoning)?",
    re.IGNORECASE,
)
_CHANNEL = "<|channel|>"
_MESSAGE = "<|message|>"
_END = re.compile(r"<\|(?:end|return|start|call)\|>")
_BARE_CHANNEL = re.compile(r"\s*+(?:assistant)?(?:analysis|commentary)(?=[A-Z])")
"""A channel's name without its special tokens; in English no capital follows these words directly."""

_BARE_FINAL = "assistantfinal"

_TURN = re.compile(r"<\|(?:im_(?:start|end)|eot_id|end_?of_?text)\|>|<(?:start|end)_of_turn>")
"""Marks between the turns of a conversation: a base model writes them as text, and the next turns, too."""


@dataclass(frozen=True, slots=True)
class Spoken:
    """The text after the last thought: the whole text without thoughts, none if the last one is `unfinished`."""

    text: str
    thought: bool = False
    unfinished: bool = False


_UNFINISHED = Spoken("", thought=True, unfinished=True)


def spoken(text: str) -> Spoken:
    """Drop the thoughts from a text. Call it on every text that is read as an answer."""
    if _CHANNEL in text:
        return _in_channels(text)
    if _BARE_CHANNEL.match(text):
        _, final, answer = text.rpartition(_BARE_FINAL)
        return Spoken(answer, thought=True) if final else _UNFINISHED
    inside, after = "", -1
    for mark in _MARK.finditer(text):
        closes, kind = _meaning(mark)
        if kind in ("fence", "detai") and closes and kind != inside:
            continue  # the end of something else
        if not inside and not closes:
            inside = kind
        elif not inside or (closes and kind == inside):
            # A closing mark alone ends a thought, too: its opening mark was in the prompt.
            inside, after = "", mark.end()
    if inside:
        return _UNFINISHED
    return Spoken(text) if after < 0 else Spoken(text[after:], thought=True)


def answer_text(text: str) -> str:
    """A text without thoughts; AnswerError if it is too long, or holds only thoughts."""
    if len(text) > MAX_CHARS:
        raise AnswerError(f"it is {len(text)} characters long, {MAX_CHARS} are the limit.")
    answer = spoken(text)
    if answer.unfinished or (answer.thought and not answer.text.strip()):
        raise AnswerError("it holds nothing but thoughts; think less, and give the answer itself.")
    return answer.text


def _meaning(mark: re.Match[str]) -> tuple[bool, str]:
    """Whether a mark closes, and the kind of thought: other marks within a thought do not end it."""
    found = {group: text for group, text in mark.groupdict().items() if text}
    if "fence" in found:
        return "name_6" not in found, "fence"
    turn = found.pop("turn", "").lower()
    closes = turn.startswith("end") or any(group.startswith("close") for group in found)
    name = next((text for group, text in found.items() if group.startswith("name")), "") or found.get("close_5", "")
    return closes, name.lower().lstrip("/")[:5] or ("unuse" if "close_4" in found else "chann")


def _in_channels(text: str) -> Spoken:
    """The last channel of gpt-oss if it is `final`; all others hold thoughts."""
    name, mark, answer = text.rpartition(_CHANNEL)[2].partition(_MESSAGE)
    if not mark or not name.strip().lower().startswith("final"):
        return _UNFINISHED
    end = _END.search(answer)
    return Spoken(answer if end is None else answer[: end.start()], thought=True)


def whole_answer(reply: Reply, question: str = "") -> str:
    """The model's answer without thoughts; AnswerError if it was cut off, or holds only thoughts.

    It ends at a mark of the next turn, and is whole if there is one, even if the next turn was cut off. If it was cut
    off, the reason names what it did instead of answering: the `question` is known again in it.

    The provider's `finish_reason` decides whether it was cut off. `Path: [[51.2, 4], [` or a draft before the answer
    could still be read, and `Position: [51.2, 4]` does not show whether more was to follow.
    """
    answer = spoken(reply.text)
    turn = _TURN.search(answer.text)
    if turn is not None and answer.text[: turn.start()].strip():
        return answer.text[: turn.start()]
    cut = reply.finish_reason == "length"
    empty = answer.unfinished or not answer.text.strip()
    if empty and (cut or reply.thought or answer.thought):
        raise AnswerError(_only_thoughts(reply, cut=cut))
    if cut:
        habit = _habit(answer.text, question)
        raise AnswerError(f"it was cut off{_length(reply)} before it was complete; {habit or 'answer more briefly'}.")
    if reply.finish_reason == "content_filter":
        raise AnswerError("the provider's content filter stopped it before it was complete.")
    return answer.text


def _habit(text: str, question: str) -> str:
    """What a runaway answer does, and what to do instead; empty for an answer that is only long."""
    tail = text[-TAIL:].rstrip()
    if any(form in "".join(tail.split()) for form in ("[x,y", "[...")):
        return "it copies the form: put numbers in place of x and y"
    for size in range(1, len(tail) // REPEATS + 1):
        if tail.endswith(tail[-size:] * REPEATS) and size * REPEATS >= MIN_REPEATED:
            return "it says the same again and again: give the answer once, and stop"
    if any(len(line.strip()) >= ECHOED and line.strip() in question for line in text.splitlines()):
        return "it repeats the question: give only the answer"
    return ""


def quote(reply: Reply) -> str:
    """The answer for the model's own conversation: without thoughts, of limited length, and never empty."""
    answer = spoken(reply.text).text
    return answer[:MAX_QUOTED] if answer.strip() else NO_TEXT


def _only_thoughts(reply: Reply, *, cut: bool) -> str:
    story = f"it was cut off{_length(reply)} while you were still thinking" if cut else "it holds nothing but thoughts"
    cap = reply.settings.get("max_tokens")
    limit = "" if cap is None else f" (a cap of {cap} tokens for thoughts and answer together may be too low)"
    return f"{story}: you thought but did not answer{limit}; think less, and give the answer itself."


def _length(reply: Reply) -> str:
    tokens = reply.usage.output
    return f" at {tokens} {'token' if tokens == 1 else 'tokens'}" if tokens else ""
