"""Thoughts are told from answers, as real models and servers write them."""

from __future__ import annotations

import time

import pytest
from answer_readers import parse_plan, parse_step, parse_step_json

from llm_flock.errors import AnswerError
from llm_flock.llm._port import Reply
from llm_flock.llm._thoughts import MAX_CHARS, spoken, whole_answer

SAID = "Position: [1, 2]"
DRAFT = "I could go to Position: [5, 0]. "

NO_ANSWER = "too long|no complete position|nothing but thoughts"


@pytest.mark.parametrize(
    "text",
    [
        SAID,
        f"<think>\n{DRAFT}\n</think>\n\n{SAID}",
        f"<think>\n\n</think>\n\n{SAID}",
        f"{DRAFT}</think>{SAID}",
        f"<THINK>{DRAFT}</THINK>{SAID}",
        f"<thinking>{DRAFT}</thinking> {SAID}",
        f"<reasoning>{DRAFT}</reasoning> {SAID}",
        f"<thought>{DRAFT}</thought> {SAID}",
        f"<seed:think>{DRAFT}</seed:think>{SAID}",
        f"< think >{DRAFT}</ think >{SAID}",
        f"[THINK]{DRAFT}[/THINK]{SAID}",
        f"◁think▷{DRAFT}◁/think▷{SAID}",
        f"<|channel>thought\n{DRAFT}<channel|>{SAID}",
        f"<think>a</think> Position: [3, 3] <think>{DRAFT}</think> {SAID}",
        f"<think>{DRAFT}</think> so </think> {SAID}",
        f"<think>the prompt has no <reasoning> tags. {DRAFT}</think>{SAID}",
        f"<think>one <think> in another {DRAFT}</think>{SAID}",
        f"<|channel|>analysis<|message|>{DRAFT}<|end|><|start|>assistant<|channel|>final<|message|>{SAID}<|return|>",
        f"<|channel|>analysis<|message|>{DRAFT}<|end|><|start|>assistant<|channel|>Final <|message|>{SAID}",
        f"analysisWe head for it. {DRAFT}assistantfinal{SAID}",
        f"analysisWe do. {DRAFT}assistantcommentaryHm.assistantfinal{SAID}",
        f"analysis: a step of 2.\n{SAID}",
        f"My reasoning: a step. 3 < 4 > 2, so I think.\n{SAID}",
    ],
)
def test_text_after_the_last_thought_is_the_answer(text: str) -> None:
    assert parse_step(text, 2) == (1.0, 2.0)
    assert parse_step_json(text.replace(SAID, '{"position": [1, 2]}'), 2) == (1.0, 2.0)


@pytest.mark.parametrize(
    "text",
    [
        f"<think>{DRAFT}",
        f"<Think>\n{DRAFT}",
        f"<thinking>{DRAFT}",
        f"<reasoning>{DRAFT}",
        f"[THINK]{DRAFT}",
        f"<think>{DRAFT}</think>",
        f"{DRAFT}</think>  \n",
        f"<think>{DRAFT}<reasoning>no</reasoning> {DRAFT}",
        f"<think>a</think> {SAID} <think>or rather {DRAFT}",
        f"{SAID}\n<think>{DRAFT}",
        f"<|channel|>analysis<|message|>{DRAFT}",
        f"<|channel|>analysis<|message|>{DRAFT}<|end|><|start|>assistant<|channel|>final",
        f"<|channel|>final<|message|>{SAID}<|end|><|start|>assistant<|channel|>analysis<|message|>{DRAFT}",
        f"analysisWe head for it. {DRAFT}",
        f"<|channel>thought\n{DRAFT}",
    ],
)
def test_a_thought_is_never_an_answer(text: str) -> None:
    for read in (parse_step, parse_step_json):
        with pytest.raises(AnswerError, match="nothing but thoughts"):
            read(text, 2)
    with pytest.raises(AnswerError, match="nothing but thoughts"):
        parse_plan(text.replace(DRAFT, "Plan: [[1, 2]]\nmy plan: 0"), 1, 2)


def test_text_without_thoughts_is_kept_whole() -> None:
    assert spoken(SAID).text is SAID and not spoken(SAID).thought
    closed = spoken(f"<think>hm</think>{SAID}")
    assert (closed.text, closed.thought, closed.unfinished) == (SAID, True, False)
    begun = spoken("<think>hm")
    assert (begun.text, begun.thought, begun.unfinished) == ("", True, True)


UNITS = [
    "<think>", "</think>", "<", "< ", "</", "[THINK]", "◁", "<|channel|>", "<|channel|>final<|message|>", "<|message|>",
    "assistantfinal", "analysis", "<think>a</think>", "<|channel>thought", '{"a":"', '{"reasoning":', '"\\', "{}", '{"',
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("begin", ["", "analysisW", "{", '{"'])
def test_unclosed_thought_marks_are_read_in_linear_time(unit: str, begin: str) -> None:
    text = begin + unit * (MAX_CHARS // 100 // len(unit))
    began = time.process_time()
    spoken(text)
    for read in (parse_step, parse_step_json):
        with pytest.raises(AnswerError, match=NO_ANSWER):
            read(text, 2)
    assert time.process_time() - began < 0.25  # some hundredths; anything quadratic would take half a second or more


@pytest.mark.parametrize(
    ("text", "position"),
    [
        ('{"reasoning": "Position: [5, 0]", "position": [1, 2]}', (1.0, 2.0)),
        ('{"position": [1, 2], "reasoning": "or {5, 0}: Position: [5, 0]"}', (1.0, 2.0)),
        ('{"reasoning": "", "position": [1, 2]} and not {"x": 1}', (1.0, 2.0)),
        ('First {"position": [5, 0]}, rather {"position": [1, 2]}.', (1.0, 2.0)),
        ('The set {a, b}: {"position": [1, 2]}', (1.0, 2.0)),
        ('{"reasoning": 7, "position": [1, 2]}', (1.0, 2.0)),
        ('{"reasoning": "a \\"quoted\\" } brace", "position": [1, 2]}', (1.0, 2.0)),
        ('{"reasoning": oops} {"position": [1, 2]}', (1.0, 2.0)),
        ('{"position": [1, 2],}', (1.0, 2.0)),
        ('{"reasoning": "Position: [5, 0]", "position": [1, 2]', (1.0, 2.0)),
        ("\\boxed{\\text{Position: } [1, 2]}", (1.0, 2.0)),
    ],
)
def test_a_reasoning_in_json_is_not_read(text: str, position: tuple[float, ...]) -> None:
    assert parse_step_json(text, 2) == position


@pytest.mark.parametrize(
    "text",
    [
        '{"reasoning": "Position: [5, 0]", "position": [1, 2',
        '{"reasoning": "Position: [5, 0]", "posi',
        '{"reasoning": "Position: [5, 0] and so',
        '{"position": [5, 0]} {"position": [1, 2',
        'The set {a: {"reasoning": "Position: [5, 0]", "posi',
    ],
)
def test_cut_off_json_object_is_not_read_as_text(text: str) -> None:
    with pytest.raises(AnswerError, match=r"no complete position|two different positions"):
        parse_step_json(text, 2)


@pytest.mark.parametrize("mark", ["<|im_end|>", "<end_of_turn>", "<|eot_id|>", "<|endoftext|>", "\n<|im_start|>user"])
@pytest.mark.parametrize("finish_reason", ["stop", "length"])
def test_the_next_turn_is_not_the_answer(mark: str, finish_reason: str) -> None:
    turns = Reply(text=f"{SAID}{mark}\nWhere now?\nPosition: [5, 0]", model="base", finish_reason=finish_reason)
    assert parse_step(whole_answer(turns), 2) == (1.0, 2.0)


def test_marks_of_turns_alone_are_no_answer() -> None:
    for finish_reason, why in (("length", "cut off"), ("stop", "no complete position")):
        marks = Reply(text="<|im_end|>user\n" * 9, model="base", finish_reason=finish_reason)
        with pytest.raises(AnswerError, match=why):
            parse_step(whole_answer(marks), 2)
