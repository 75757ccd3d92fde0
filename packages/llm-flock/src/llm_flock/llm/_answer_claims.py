"""Finds what an answer claims: the values in answer position, and which of them counts.

A claim is a label with a value: `Position: [x, y]`, "I move to [x, y]", `my plan: a`. Its clause, the heading above it
and the sentences between two claims tell drafts, rejected alternatives and options from the answer. Two claims that
differ, of which no word takes one back, are refused.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

from llm_flock.errors import AnswerError
from llm_flock.llm._answer_items import EXPRESSION, PLACEHOLDERS, UNITS, Item, row_of

POSITION = frozenset({"position", "waypoint", "answer", "boxed", "option", "candidate"})
POSITION_OR_PATH = POSITION | {"path"}
PLAN = frozenset({"plan", "answer", "boxed"})
PATH = frozenset({"path", "answer", "boxed"})

Rows: TypeAlias = tuple[tuple[str, ...], ...]
"""Numbers as they are spelled: one row a point."""


Value: TypeAlias = tuple[Rows, str, int]
"""Rows, what is wrong with them, and where the value ends."""

_REACH = 14
"""How far a label's words are looked at [items]."""

_VALUES = ("point", "points", "bad", "axes")

_SAID = {
    name: frozenset(text.split())
    for name, text in tomllib.loads(Path(__file__).with_name("answer_words.toml").read_text(encoding="utf-8")).items()
}
"""The words that decide, by their meaning."""

CERTAIN = _SAID["revised"] | _SAID["final"] | _SAID["own"]
_FINAL = _SAID["revised"] | _SAID["final"]
_PLAIN_BEFORE = CERTAIN | _SAID["before"]
_SOFT = _SAID["soft"] | _SAID["first"]


@dataclass(slots=True)
class AnswerClaim:
    """A value in answer position: its rows as spelled, or what is `wrong` with it.

    `begin` and `end` count items. `misfit`: it has not the form that the question asks for.
    `strength`: 0 within a sentence, 1 a line of its own, 2 called final or corrected.
    """

    rows: Rows
    wrong: str
    begin: int
    end: int
    strength: int = 0
    revises: bool = False
    rejected: bool = False
    soft: bool = False
    option: str = ""
    misfit: bool = False

    @property
    def value(self) -> object:
        """What two claims must share to be the same."""
        try:
            return tuple(tuple(map(float, row)) for row in self.rows) or self.wrong
        except ValueError:
            return self.rows


class Items:
    """The items of an answer, with safe access behind both ends."""

    def __init__(self, items: Sequence[Item], text: str) -> None:
        self.all = items
        self.text = text

    def kind(self, at: int) -> str:
        """The kind of an item; empty outside."""
        return self.all[at].kind if 0 <= at < len(self.all) else ""

    def word(self, at: int) -> str:
        """A word in small letters; empty for anything else."""
        return self.all[at].text.lower() if self.kind(at) == "word" else ""

    def words(self, begin: int, end: int) -> Iterator[str]:
        """The words of a part."""
        return (word for at in range(max(0, begin), min(end, len(self.all))) if (word := self.word(at)))

    def sentence(self, at: int, limit: int = _REACH) -> int:
        """Where the sentence from here ends."""
        end = at
        while end < at + limit and self.kind(end) not in ("", "stop", "line", *_VALUES):
            end += 1
        return end


def claims(items: Items, labels: frozenset[str], *, many: bool) -> list[AnswerClaim]:
    """All claims under these labels, in their order; `many`: several points make one value."""
    found: list[AnswerClaim] = []
    taken = -1
    for at in range(len(items.all)):
        if items.kind(at) != "word":
            continue
        word = items.word(at)
        moves = not many and word in ("to", "at", "from") and not _SAID["verbs"].isdisjoint(items.words(at - 2, at))
        if not moves and word not in labels:
            continue
        claim = _claim(items, at, moves=moves, many=many)
        if claim is not None and claim.end > taken:
            found.append(claim)
            taken = claim.end
    return found


def _claim(items: Items, at: int, *, moves: bool, many: bool) -> AnswerClaim | None:
    label = items.word(at)
    certain = moves or label in ("answer", "boxed", "option", "candidate") or items.word(at - 1) in CERTAIN
    named = items.kind(at + 2) == "sign" and len(items.all[at + 1].text) == 1 and items.all[at + 1].text.isalnum()
    value = _value(items, at + 1 + named, certain=certain or (many and label != "answer"), many=many, label=label)
    if value is None or (many and items.word(at - 1) in ("my", "own") and len(value[0]) == 1):
        return None
    begin = start_of_clause(items, at)
    clause, heading = list(items.words(begin, at)), _heading(items, begin)
    option = items.all[at + 1].text.lower() if named else _option(items, at, begin, heading)
    if moves:
        stands = len(clause) <= 1 or not {"i", "i'll"}.isdisjoint(clause)
    else:
        stands = not foreign(clause) if many else bool(option) or label == "boxed" or _stands(items, at)
    if not stands:
        return None
    rows, wrong, end, stated = value
    around = {*clause, *heading, label}
    behind = items.sentence(end, 10)
    after = list(items.words(end, behind))
    asks = items.kind(behind) == "stop" and items.all[behind].text == "?"
    return AnswerClaim(
        rows,
        wrong,
        begin,
        end,
        strength=2 if around & _FINAL else int(stated and set(clause) <= _PLAIN_BEFORE),
        revises=bool(around & _SAID["revised"]),
        rejected=bool(around & _SAID["hard"]) or asks or _dismissed(after),
        soft=bool(({*clause, label, *_SAID["first"].intersection(heading)} | ({"would"} & set(after))) & _SOFT)
        and not around & _SAID["revised"],
        option=option,
    )


def _dismissed(spoken: Sequence[str]) -> bool:
    """Whether the words behind a value, or a sentence about it, say that it is not the answer."""
    pairs = set(pairwise(spoken))
    wrong = {("not", word) for word in ("safe", "allowed", "possible", "valid", "good", "free", "ok", "right", "it")}
    if _SAID["denials"].isdisjoint(spoken):
        wrong |= {("too", word) for word in ("close", "far", "near", "short", "long")}
        kept = not {"safe", "safety", "minimum", "required", "spacing"}.isdisjoint(spoken)  # exceeds the safe distance
        if not (_SAID["faulty"] - ({"exceeds"} if kept else set())).isdisjoint(spoken):
            return True
    begins = tuple(spoken[:2]) in (("is", "not"), ("was", "not"), ("from", "here"), ("from", "me"))
    return begins or bool(pairs & wrong)


def start_of_clause(items: Items, at: int) -> int:
    begin = at
    while begin > 0 and at - begin < _REACH and items.kind(begin - 1) not in ("stop", "line", "comma", *_VALUES):
        begin -= 1
    return begin


def _heading(items: Items, begin: int) -> list[str]:
    """The words of the line above, if the clause begins its line and the line above announces it."""
    end = begin
    while items.kind(end - 1) in ("operator", "number"):
        end -= 1
    if items.kind(end - 1) != "line":
        return []
    while items.kind(end - 1) == "line":
        end -= 1
    start = end
    while start > 0 and end - start < _REACH and items.kind(start - 1) not in ("stop", "line", *_VALUES):
        start -= 1
    announces = items.kind(end - 1) == "sign" or (end - start <= 6 and items.kind(start - 1) in ("line", ""))
    return list(items.words(start, end)) if announces and items.kind(end - 1) != "stop" else []


def _option(items: Items, at: int, begin: int, heading: Sequence[str]) -> str:
    """The name of the option that a claim belongs to, in its clause or heading: `Option B`, `(b) Position:`."""
    words = [item.text.lower() for item in items.all[begin:at] if item.kind in ("word", "number")]
    if len(words) == 1 and len(words[0]) == 1 and words[0] in "abcdefgh":
        return words[0]
    for spoken in (words, list(heading)):
        for label, name in pairwise(spoken):
            if label in _SAID["option"] and len(name) == 1:
                return name
    if heading and heading[0] in _SAID["option"]:  # a number is no word
        up = begin - 1
        while up > 0 and items.kind(up) != "number" and begin - up < _REACH:
            up -= 1
        return items.all[up].text if items.kind(up) == "number" else ""
    return ""


def foreign(spoken: Sequence[str]) -> bool:
    """Whether words before a value give it to others, or to another time."""
    return any(word.removesuffix("'s") in _SAID["foreign"] | _SAID["no_place"] for word in spoken)


def _stands(items: Items, at: int) -> bool:
    """Whether a label of a position is its own: "Your position:" and "Goal position:" only repeat the question."""
    before = at - 1
    word = items.word(before)
    if word and word not in _PLAIN_BEFORE:
        return False
    while word := items.word(before):
        if word.removesuffix("'s") in _SAID["foreign"]:
            return False
        before -= 1
        if at - before > 6:
            break
    number = items.kind(before) == "number"
    return not (number and items.word(before - 1).removesuffix("s") in ("robot", "neighbor", "neighbour"))


def _value(items: Items, at: int, *, certain: bool, many: bool, label: str) -> tuple[Rows, str, int, bool] | None:
    """Rows, fault, end and whether a sign stands before the value that follows a label; None if none follows."""
    stated, order, limit, moved = False, "", at + _REACH, False
    while at < limit:
        kind, word = items.kind(at), items.word(at)
        if kind in ("sign", "equals", "to"):
            stated = True
        elif kind == "axes" and not order and items.kind(at + 1) in ("sign", "equals", "point", "word"):
            order = items.all[at].text
        elif kind == "line" and not (stated or label in ("answer", "boxed")):
            return None
        elif word and word not in _SAID["links"]:
            break
        elif word == "from":
            moved = True
        elif kind not in ("line", "word") and not (kind == "operator" and items.kind(at + 1) != "number"):
            break
        at += 1
    if not (stated or certain):
        return None
    if many:
        found = points_from(items, at, int(label == "path"))
        if found is None or (len(found[0]) == 1 and not stated):
            return None
        return *_checked(items, found, order), stated
    if items.kind(at) in _VALUES:
        item, end = _result(items, at)
        if items.kind(at - 1) == "operator" and items.all[at - 1].end == items.all[at].start:
            item = Item("bad", EXPRESSION, item.start, item.end)
        if moved and end == at + 1:
            return None
        wrong = item.text if item.kind == "bad" else PLACEHOLDERS if item.kind == "axes" else ""
        return *_checked(items, (item.rows, wrong, end), order), stated
    end = _end_of_row(items, at)
    if end == at or not stated or moved:
        return None
    row = row_of([item for item in items.all[at:end] if item.kind != "operator"])  # bullets
    if items.kind(end) in ("point", "points", "operator"):
        row = EXPRESSION
        end += 1
    return ((row,), "", end, True) if isinstance(row, tuple) else ((), row, end, True)


def _checked(items: Items, value: Value, order: str = "") -> Value:
    """A value; wrong if its axes are said to be in another `order`, or if another value follows that may be meant."""
    rows, wrong, end = value
    for at in range(end, items.sentence(end, 6) + 1):
        if items.kind(at) == "axes" or (items.word(at) in ("y", "z") and items.word(at + 1) == "first"):
            order = order or items.all[at].text.lower()
    if order and order != "xyz"[: len(order)]:
        return (), f"is in the order {', '.join(order)}; x comes first", end
    follows = end + (items.kind(end) == "comma" or items.word(end) in ("or", "and", "vs", "versus"))
    if follows > end and items.kind(follows) in ("point", "points"):
        return (), "gives two values", follows + 1
    return rows, wrong, end


def _end_of_row(items: Items, at: int) -> int:
    """The end of a position without brackets: `45.5, 51`, or `x = 45.5` and so on, which may take lines."""
    end = at
    while (kind := items.kind(end)) in ("number", "comma", "sign", "equals", "line", "operator", "word"):
        word = items.word(end)
        if word and not (word in "xyz" and len(word) == 1) and word not in UNITS:
            break
        if kind in ("line", "operator"):
            behind = end + 1
            while items.kind(behind) in ("line", "operator"):
                behind += 1
            if kind == "operator" and items.kind(behind) == "number":
                break
            if items.word(behind) not in ("x", "y", "z"):
                break
        end += 1
    return end if any(items.kind(k) == "number" for k in range(at, end)) else at


def _result(items: Items, at: int) -> tuple[Item, int]:
    """The last value of `a + b = c`, `a -> c` or `a to c`, and its end; an expression without a result is bad."""
    value, end, summed = items.all[at], at + 1, False
    while True:
        here = end + (items.kind(end) == "line" and items.kind(end + 1) == "equals")
        kind = "to" if items.word(here) == "to" else items.kind(here)
        if kind not in ("operator", "equals", "to"):
            break
        here += 1
        numbers = 0
        while items.kind(here) in ("number", "operator"):
            numbers += items.kind(here) == "number"
            here += 1
        if items.kind(here) not in _VALUES:
            scaled = numbers > 0 or (bool(items.word(here)) and items.all[here - 1].text.strip() in "+\u00d7\u00b7")
            summed = summed or (kind == "operator" and scaled)
            break
        summed = kind == "operator"
        value, end = items.all[here], here + 1
    if summed:
        value = Item("bad", EXPRESSION, value.start, value.end)
    return value, end


def points_from(items: Items, at: int, first: int = 0) -> Value | None:
    """Points in one bracket, or one after the other, which may be numbered from `first` or from 0."""
    rows: list[tuple[str, ...]] = []
    numbers: list[str] = []
    end = at
    while True:
        here, number = _past_label(items, end)
        kind = items.kind(here)
        if kind in ("bad", "axes"):
            return (), items.all[here].text if kind == "bad" else PLACEHOLDERS, here + 1
        if kind == "points" and not rows:
            value, end = _result(items, here)
            wrong = value.text if value.kind == "bad" else EXPRESSION if number is not None else ""
            return _checked(items, (value.rows, wrong, end))
        if kind != "point":
            break
        rows += items.all[here].rows
        numbers += [] if number is None else [number]
        end = here + 1
    if not rows:
        return None
    fits = any(numbers == [str(base + k) for k in range(len(numbers))] for base in (0, first))
    return tuple(rows), "" if fits else f"numbers its points from {numbers[0]}; points count from 0", end


def _past_label(items: Items, at: int) -> tuple[int, str | None]:
    """Past what may stand between two points: commas, bullets, arrows, `place 3:`; and the number there."""
    number = None
    limit = at + 8
    while at < limit:
        kind = items.kind(at)
        if kind == "number" and number is None:
            number = items.all[at].text
        elif items.word(at) not in _SAID["numbered"] and (
            kind not in ("comma", "line", "to", "sign", "stop") and items.all[at : at + 1] and items.all[at].text != "-"
        ):
            break
        at += 1
    return at, number


def chosen(
    found: Sequence[AnswerClaim], items: Items, what: str, others: Sequence[AnswerClaim] = ()
) -> AnswerClaim | None:
    """The claim that counts, None if there is none; AnswerError if the answer does not decide.

    A sentence that corrects one of the `others` takes nothing back.
    """
    current: AnswerClaim | None = None
    rival: AnswerClaim | None = None
    options: list[AnswerClaim] = []
    turned, seen = False, 0
    for claim in found:
        if claim.option:
            options.append(claim)
            continue
        if claim.rejected and not claim.revises:
            continue
        if current is None:
            current, seen = claim, claim.end
            continue
        turned = turned or _turns(items, seen, claim.begin)
        seen = claim.end
        if claim.wrong == PLACEHOLDERS:
            continue
        if claim.value == current.value and not turned:
            current.end, current.soft = claim.end, current.soft and claim.soft
            current.strength = max(current.strength, claim.strength)
        elif not claim.soft and (claim.revises or turned or _outdoes(claim, current)):
            current, rival, turned = claim, None, False
        elif not claim.soft or turned:
            rival = claim
    if options:
        current = _picked(options, current, items, what)
    if rival is not None and current is not None:
        raise AnswerError(f"it gives two different {what}s and does not say which one counts; give one only.")
    if current is not None and not current.option:
        current = _not_taken_back(current, items, what, {other.begin for other in others})
    return current


def _outdoes(claim: AnswerClaim, earlier: AnswerClaim) -> bool:
    """Whether a claim counts more than one before it, though no word takes that one back."""
    misfit = earlier.misfit or claim.misfit or bool(earlier.wrong)  # the last word counts, also if it will be refused
    return misfit or (earlier.soft and claim.strength > 0) or claim.strength == 2 > earlier.strength


def _picked(options: Sequence[AnswerClaim], current: AnswerClaim | None, items: Items, what: str) -> AnswerClaim:
    """The option that the answer chooses; a claim outside all options counts more."""
    if current is not None and (current.begin > options[-1].end or current.strength == 2):
        return current
    if len({option.value for option in options}) == 1 and current is None:
        return options[-1]
    names = {option.option for option in options}
    picked: set[str] = set()
    for at in range(options[0].begin, len(items.all)):
        if items.word(at) in _SAID["choose"] and "not" not in items.words(at - 3, at):
            near = items.all[at + 1 : items.sentence(at + 1, 8)]
            picked |= {item.text.lower() for item in near if item.text.lower() in names and _named(item, near)}
    picks = [option for option in options if option.option in picked]
    if len(picked) != 1 or len({option.value for option in picks}) != 1:
        raise AnswerError(f"it names options and does not say which one counts; give one {what} only.")
    return picks[-1]


def _named(item: Item, near: Sequence[Item]) -> bool:
    """Whether a short word names an option: "a" may be an article."""
    at = next(k for k, other in enumerate(near) if other is item)
    return (
        item.text.lower() != "a"
        or (at > 0 and near[at - 1].text.lower() in _SAID["option"])
        or item.text == "A"
        or at <= 1
    )


def _turns(items: Items, begin: int, end: int) -> bool:
    """Whether a sentence between two claims takes back what stands before it."""
    fresh = False
    for at in range(begin, end):
        word = items.word(at)
        if word and fresh:
            following = items.word(at + 1)
            if word in _SAID["turns"] and following not in ("of", "than", "other", "robot", "robots"):
                return True
            if word in ("on", "let", "after") and _again(items, at):
                return True
            if word in ("that", "this", "it", "which", "i"):
                rest = set(items.words(at, items.sentence(at, 20)))
                if (rest & _SAID["faults"] and not rest & {"not", "no", "never"}) or {"mistake", "apologize"} & rest:
                    return True
        if word or items.kind(at) in _VALUES:
            fresh = False
        elif items.kind(at) in ("stop", "line", "operator", "comma", "sign"):
            fresh = True
    return False


def _again(items: Items, at: int) -> bool:
    """Whether "on second thought", "on reflection", "let me redo" or "after checking" begins here."""
    following, third = items.word(at + 1), items.word(at + 2)
    return following in ("second", "reflection", "checking", "rechecking") or (
        following == "me" and third in _SAID["again"]
    )


def _not_taken_back(current: AnswerClaim, items: Items, what: str, others: Set[int]) -> AnswerClaim:
    """The claim, unless later words take it back; a value in that sentence replaces it."""
    fresh = False
    for at in range(current.end, len(items.all)):
        word = items.word(at)
        faulty = word in ("this", "that", "it") and _dismissed(list(items.words(at, items.sentence(at))))
        back = word in _SAID["back"] and items.word(at + 1) not in ("for", "until")
        if word and fresh and (faulty or back or (word == "on" and _again(items, at))):
            if not others.isdisjoint(range(at, items.sentence(at) + 1)):
                continue
            values = [item for item in items.all[at:] if item.rows or item.kind == "bad"]
            if (
                len(values) == 1
                and values[0].rows
                and not set(items.words(at, len(items.all))) & (_SAID["hard"] | {"close"})
            ):
                return replace(current, rows=values[0].rows, wrong="", end=len(items.all))
            raise AnswerError(f"it takes its {what} back and gives no other; give one {what} only.")
        fresh = items.kind(at) in ("stop", "line", "operator", "comma") or (fresh and not word)
    return current


def index_claims(items: Items) -> list[AnswerClaim]:
    """All claims of the model's own place: `my plan: a`, "my place is a", "I take place a"."""
    found: list[AnswerClaim] = []
    for at in range(len(items.all)):
        word = items.word(at)
        if word not in ("my", "i", "my_plan", "my_place", "my_index", "my_slot"):
            continue
        end = _index_label(items, at)
        claim = None if end < 0 else _index(items, at, end)
        if claim is not None:
            found.append(claim)
    return found


def _index_label(items: Items, at: int) -> int:
    """Where the label of an index ends; -1 if this is none."""
    word, here = items.word(at), at + 1
    if word == "i":
        if items.word(here) == "will":
            here += 1
        if items.word(here) not in ("take", "choose", "pick", "select", "occupy"):
            return -1
        here += 1
    elif word != "my":
        return here
    while items.word(here) in ("chosen", "own", "the", "final") or items.kind(here) == "operator":
        here += 1
    return here + 1 if items.word(here) in _SAID["place"] else -1


def _index(items: Items, begin: int, at: int) -> AnswerClaim | None:
    """The claim of an index whose label ends here."""
    start = begin
    while begin - start < 20 and items.kind(start - 1) not in ("", "stop", "line"):
        start -= 1
    hypothetical = not {"if", "were", "would"}.isdisjoint(items.words(start, begin))
    limit = at + 8
    stated = False
    while at < limit:
        kind = items.kind(at)
        if kind in ("sign", "equals"):
            stated = True
        elif (
            kind == "operator"
            or items.word(at) in _SAID["place"] | _SAID["filler"]
            or (kind == "line" and stated and items.kind(at + 1) == "number" and items.kind(at + 2) in ("", "line"))
        ):
            pass
        elif kind == "number" and items.kind(at + 1) == "operator" and items.word(at + 2) in ("based", "indexed"):
            at += 2
        else:
            break
        at += 1
    if items.kind(at) == "point":
        return AnswerClaim(items.all[at].rows, "", begin, at + 1, 1, rejected=hypothetical)
    if items.kind(at) in ("bad", "axes"):
        return AnswerClaim((), PLACEHOLDERS, begin, at + 1, 1)
    if items.kind(at) != "number":
        return None
    value, end, summed = items.all[at], at + 1, False
    while items.kind(end) in ("operator", "equals") and items.kind(end + 1) == "number":
        summed = items.kind(end) == "operator"
        value, end = items.all[end + 1], end + 2
    behind = items.text[value.end : items.all[end].start if end < len(items.all) else len(items.text)]
    wrong = ""
    if summed or (items.kind(end) == "operator" and items.all[end].text != "-"):
        wrong = "my plan holds an expression"
    elif not behind and items.kind(end) == "word":
        wrong = f"my plan is {value.text}{items.all[end].text}"
    elif _another(items, end):
        wrong = "my plan gives more than one number"
    elif items.kind(end) == "word" and not behind.strip("*_`\"'$ \t") and items.word(end) not in _SAID["because"]:
        return None  # "my plan is 4 corners"
    place: Rows = ()
    pointed = end + (items.kind(end) == "comma")
    pointed += items.word(pointed) == "at" or items.kind(pointed) in ("to", "equals")
    if pointed > end and items.kind(pointed) == "point":
        place = items.all[pointed].rows
    asks = items.kind(end) == "stop" and items.all[end].text == "?"
    strength = 1 if stated else 0
    return AnswerClaim(((value.text,), *place), wrong, begin, end, strength, rejected=hypothetical or asks)


def _another(items: Items, at: int) -> bool:
    """Whether another place is named in the rest of a line: any number but that of a robot, and the 0 of a base."""
    limit = at + 2 * _REACH
    while at < limit and items.kind(at) not in ("", "line", "stop"):
        if items.word(at) in _SAID["ordinals"]:
            return True
        based = items.word(at - 1) in ("from", "at", "robot") or items.word(at + 2) in ("based", "indexed")
        if items.kind(at) == "number" and not based:
            return True
        at += 1
    return False


_FROM_ONE = re.compile(
    r"\b(?:1|one)[- ](?:based|index)|\b(?:count|number|indices|index|start)\w*+ (?:\w++ ){0,2}(?:from|at) (?:1|one)\b"
    r"|\b(?:numbered|numbering|labell?ed|counted) 1\b",
    re.IGNORECASE,
)


def counts_from_one(text: str) -> bool:
    """Whether the answer says that it counts places from 1; "if counted from 1" says nothing."""
    for found in _FROM_ONE.finditer(text):
        begin = max(text.rfind("\n", 0, found.start()), text.rfind(". ", 0, found.start()), found.start() - 200)
        if {"if", "were", "would", "not"}.isdisjoint(text[begin + 1 : found.start()].lower().split()):
            return True
    return False
