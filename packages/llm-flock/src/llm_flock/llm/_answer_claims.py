"""Finds what an answer claims: the values in answer position, and which of them counts.

A claim is a label with a value: `Position: [x, y]`, "I move to [x, y]", `my plan: a`. Its clause, the heading above it
and the sentences between two claims tell drafts, rejected alternatives and options from the answer. Two claims that
differ, of which no word takes one back, are refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

from llm_flock.errors import AnswerError
from llm_flock.llm._answer_items import EXPRESSION, PLACEHOLDERS, SAID, Item, row_of

POSITION, PLAN, PATH = SAID["position"], SAID["plan"], SAID["path"]

_FINAL = SAID["revised"] | SAID["final"]
_CERTAIN = _FINAL | SAID["own"]
_VALUES = ("point", "points", "bad", "axes")
_BETWEEN = frozenset({"comma", "line", "to", "sign", "stop", "number"})
"""What may stand between two points of a list, with a bullet or a word such as "place"."""

_REACH = 14  # how far a label's words are looked at [items]

Value: TypeAlias = tuple[tuple[tuple[str, ...], ...], str, int]
"""Rows of numbers as they are spelled, one a point; what is wrong with them; and where the value ends."""


@dataclass(slots=True)
class AnswerClaim:
    """A value in answer position: its rows as spelled, or what is `wrong` with it.

    `begin` and `end` count items. `misfit`: it has not the form that the question asks for.
    """

    rows: tuple[tuple[str, ...], ...]
    wrong: str
    begin: int
    end: int
    final: bool = False
    revises: bool = False
    rejected: bool = False
    soft: bool = False
    option: str = ""
    misfit: bool = False
    bare: bool = False  #: Without a label, after one that has a label.

    @property
    def value(self) -> object:
        """What two claims must share to be the same."""
        return tuple(tuple(map(float, row)) for row in self.rows) or self.wrong


class Items:
    """The items of an answer, with safe access behind both ends."""

    def __init__(self, items: Sequence[Item], text: str, said: str) -> None:
        self.all = items
        self.text = text  #: In which the items stand.
        self.said = said  #: As the model wrote it.
        self._kinds = {at: item.kind for at, item in enumerate(items)}
        self._words = {at: item.text.lower() for at, item in enumerate(items) if item.kind == "word"}

    def kind(self, at: int) -> str:
        """The kind of an item; empty outside."""
        return self._kinds.get(at, "")

    def word(self, at: int) -> str:
        """A word in small letters; empty for anything else."""
        return self._words.get(at, "")

    def words(self, begin: int, end: int) -> Iterator[str]:
        """The words of a part."""
        return (word for at in range(max(0, begin), min(end, len(self.all))) if (word := self.word(at)))

    def start(self, at: int, *ends: str, reach: int = _REACH) -> int:
        """Where the words before an item begin, in its sentence and after one of these kinds."""
        begin = at
        while begin > 0 and at - begin < reach and self.kind(begin - 1) not in (*ends, "stop", "line"):
            begin -= 1
        return begin

    def past(self, at: int, kinds: Set[str], texts: Set[str] = frozenset()) -> int:
        """Where the items of these kinds, and with these texts, end."""
        while at < len(self.all) and (self.kind(at) in kinds or self.all[at].text.lower() in texts):
            at += 1
        return at

    def sentence(self, at: int, reach: int = _REACH) -> int:
        """Where the sentence from here ends."""
        end = at
        while end < at + reach and self.kind(end) not in ("", "stop", "line", *_VALUES):
            end += 1
        return end


def claims(items: Items, labels: Set[str], *, many: bool) -> list[AnswerClaim]:
    """All claims under these labels, in their order; `many`: several points make one value."""
    found: list[AnswerClaim] = []
    for at in range(len(items.all)):
        word = items.word(at)
        moves = not many and (
            (word in ("to", "at", "from") and not SAID["verbs"].isdisjoint(items.words(at - 2, at)))
            or (word in SAID["takes"] and items.kind(at + 1) in _VALUES)
        )
        labels_itself = word in _FINAL and items.kind(at + 1) == "sign"  # "Updated: [x, y]"
        claim = _claim(items, at, moves=moves, many=many) if moves or labels_itself or word in labels else None
        if found and found[-1].end == at and found[-1].bare and not found[-1].rejected and items.kind(at) == "point":
            found[-1].rows, found[-1].wrong, found[-1].end = (), "gives two values", at + 1
        elif found and found[-1].end <= at and items.kind(at) in ("point", "points"):
            claim = _beside(items, at, found[-1], many=many)
        if claim is not None and (not found or claim.end > found[-1].end):
            found.append(claim)
    return [claim for claim in found if not (claim.bare and claim.rejected)]


def _beside(items: Items, at: int, last: AnswerClaim, *, many: bool) -> AnswerClaim:
    """A value without a label behind a claim; rejected if its sentence or its heading gives it to something else."""
    value = value_at(items, at, many=many)
    assert value is not None  # a point begins here
    claim = AnswerClaim(value[0], value[1], at, value[2], bare=True)
    signs = {items.kind(at - 1), items.kind(at + 1)}
    claim.rejected = bool(value[1]) or many == (len(value[0]) == 1) or not signs.isdisjoint(("operator", "equals"))
    if not claim.rejected:
        begin = at if at == last.end else max(items.start(at), last.end)
        before = [*items.words(*_heading(items, begin)), *items.words(begin, at)]
        spoken = [*before, *items.words(value[2], items.sentence(value[2], 10))]
        claim.rejected = says(spoken, "foreign", "elsewhere") or (not before and last.bare and last.rejected)
        claim.revises = claim.final = not claim.rejected and says(before, "revised")
    return claim


def _claim(items: Items, at: int, *, moves: bool, many: bool) -> AnswerClaim | None:
    label, before = items.word(at), items.word(at - 1)
    named = items.kind(at + 2) == "sign" and len(items.all[at + 1].text) == 1 and items.all[at + 1].text.isalnum()
    certain = moves or label in SAID["announces"] or before in _CERTAIN or (many and label != "answer")
    value = _value(items, at + 1 + named, certain=certain, many=many, label=label)
    if value is None or (many and before in ("my", "own") and len(value[0]) == 1):
        return None
    rows, wrong, end = value
    begin = items.start(at, "comma", *_VALUES)
    head, above = _heading(items, begin)
    clause, heading = [*items.words(begin, at)], [*items.words(head, above)]
    option = _option(items, begin, at + named) or _option(items, head, above - 1)
    near = [*items.words(max(begin, at - 6), at)]
    if moves:
        first = len(clause) <= 1 and items.kind(begin - 1) in ("", "line", "stop")
        stands = first or not {"i", "i'll"}.isdisjoint(clause)
    else:
        plainly = many or option or not before or before in _CERTAIN | SAID["before"]
        stands = label == "boxed" or bool(plainly and not says(near if not many else clause, "foreign"))
    if not stands:
        return None
    around, behind = {*clause, *heading, label}, items.sentence(end, 10)
    new_field = items.kind(end) == "comma" and "sign" in (items.kind(k) for k in range(end, behind))
    after = [] if new_field else [*items.words(end, behind)]
    doubted = says(after, "hypothetical") or says(items.words(items.start(at, reach=20), at), "hypothetical")
    asks = items.kind(behind) == "stop" and items.all[behind].text == "?"
    revises = not around.isdisjoint(SAID["revised"])
    soft = {*clause, label, *SAID["first"].intersection(heading), *{"would"}.intersection(after)}
    return AnswerClaim(
        rows,
        wrong,
        begin,
        end,
        final=revises or not around.isdisjoint(SAID["final"]),
        revises=revises,
        rejected=not around.isdisjoint(SAID["hard"]) or asks or doubted or _dismissed(after),
        soft=not (revises or soft.isdisjoint(SAID["soft"] | SAID["first"])),
        option=option,
    )


def says(spoken: Iterable[str], *names: str) -> bool:
    """Whether one of these lists holds a word, or two words in a row (as `too_close`)."""
    words = [word.removesuffix("'s") for word in spoken]
    words = [*words, *map("_".join, pairwise(words))]
    return any(not SAID[name].isdisjoint(words) for name in names)


def _dismissed(spoken: Sequence[str]) -> bool:
    """Whether the words behind a value, or a sentence about it, say that it is not the answer."""
    faulty = (says(spoken, "faulty") or {"exceeds", "limit"} <= {*spoken}) and not says(spoken, "denials")
    return faulty or says(spoken, "dismissed") or " ".join(spoken[:2]) in ("is not", "was not")


def _heading(items: Items, begin: int) -> tuple[int, int]:
    """Begin and end of the line above, if the clause begins its line and the line above announces it."""
    end = begin
    while items.kind(end - 1) in ("operator", "number"):
        end -= 1
    if items.kind(end - 1) != "line":
        return begin, begin
    while items.kind(end - 1) == "line":
        end -= 1
    start = items.start(end, *_VALUES)
    short = end - start <= 6 and items.kind(start - 1) in ("line", "") and items.kind(end - 1) not in ("stop", "comma")
    return (start, end) if short or items.kind(end - 1) == "sign" else (begin, begin)


def _option(items: Items, begin: int, end: int) -> str:
    """The name of the option that a claim belongs to, in its clause or heading: `Option B`, `(b) Position:`."""
    if end == begin + 1 and items.word(begin) in tuple("abcdefgh"):
        return items.word(begin)
    names = (items.all[at + 1].text.lower() for at in range(begin, end) if items.word(at) in SAID["option"])
    return next((name for name in names if len(name) == 1 and name.isalnum()), "")


def _value(items: Items, start: int, *, certain: bool, many: bool, label: str) -> Value | None:
    """The value that follows a label; None if none follows, or only in the middle of a sentence."""
    stated, moved, order, at = False, False, "", start
    alone = items.kind(start - 2) in ("line", "")  # the label begins its line
    for at in range(start, start + _REACH):
        kind, word = items.kind(at), items.word(at)
        if kind in ("sign", "equals", "to"):
            stated = True
        elif kind == "axes" and not order and items.kind(at + 1) in ("sign", "equals", "point", "word"):
            order = items.all[at].text
        elif word in SAID["links"]:
            moved = moved or word == "from"
        elif kind == "line" and (alone or stated or label in ("answer", "boxed")):
            stated = True
        elif (kind != "operator" or items.kind(at + 1) == "number") and items.word(at - 1) != "round":
            break
    value = value_at(items, at, many=many, first=int(label == "path"), order=order)
    if value is None:
        return None
    stated = stated or label == "boxed" or (alone and items.kind(value[2]) in ("line", "stop", ""))
    if not (stated or certain) or (many and len(value[0]) == 1 and not stated):
        return None
    loose = items.kind(at) not in _VALUES and items.word(at) not in ("x", "y")
    if not many and ((loose and not stated) or (moved and (loose or value[2] == at + 1))):
        return None
    return value


def value_at(items: Items, at: int, *, many: bool, first: int = 0, order: str = "") -> Value | None:
    """The points or the position that begin here; wrong if their axes are said to be in another `order`."""
    value = _points(items, at, first) if many else _position(items, at)
    if value is None:
        return None
    rows, wrong, end = value
    if items.kind(at - 1) == "operator" and items.all[at - 1].end == items.all[at].start:
        wrong = EXPRESSION
    for here in range(end, items.sentence(end, 6) + 1):
        if items.kind(here) == "axes" or (items.word(here) in ("y", "z") and items.word(here + 1) == "first"):
            order = order or items.all[here].text.lower()
        if items.word(here) in SAID["foreign_units"] - {"in"} and items.kind(here - 1) != "number":
            wrong = f"has units ({items.all[here].text}), which are not allowed"
    if order and order != "xyz"[: len(order)]:
        return (), f"is in the order {', '.join(order)}; x comes first", end
    follows = end + (items.kind(end) == "comma" or items.word(end) in ("or", "and", "vs", "versus"))
    while end < follows < end + 3 and items.word(follows) in SAID["links"]:
        follows += 1
    if follows > end and items.kind(follows) in ("point", "points"):
        return (), "gives two values", follows + 1
    return rows, wrong, end


def _position(items: Items, at: int) -> Value | None:
    """A position, in brackets or without: `45.5, 51`, or `x = 45.5` and so on, which may take lines."""
    if items.kind(at) in _VALUES:
        return _result(items, at)
    end = at
    while items.kind(end) in ("number", "comma", "sign", "equals", "line", "operator", "word"):
        if items.word(end) and items.word(end) not in ("x", "y", "z", "and", *SAID["units"]):
            break
        if items.kind(end) in ("line", "operator"):
            behind = items.past(end, {"line", "operator"})
            if items.word(behind) not in {"x", "y", "z"}.difference(items.words(at, end)):
                break
            end = behind
        end += 1
    if "number" not in {items.kind(k) for k in range(at, end)}:
        return None
    row = row_of([item for item in items.all[at:end] if item.kind != "operator" and item.text != "and"])  # bullets
    if items.kind(end) in ("point", "points", "operator"):
        row, end = EXPRESSION, end + 1
    return ((row,), "", end) if isinstance(row, tuple) else ((), row, end)


def _result(items: Items, at: int) -> Value:
    """The last value of `a + b = c`, `a -> c` or `a to c`; an expression without a result is wrong."""
    value, end, summed = items.all[at], at + 1, False
    while True:
        sign = end + (items.kind(end) == "line" and items.kind(end + 1) == "equals")
        kind = items.kind(sign)
        if kind not in ("operator", "equals", "to") and items.word(sign) != "to":
            break
        here = items.past(sign + 1, {"number", "operator"})
        if items.kind(here) not in _VALUES:
            term = items.all[here - 1].kind == "number" or (
                items.word(here) and items.all[here - 1].text in "+\u00d7\u00b7"
            )
            summed = summed or (kind == "operator" and bool(term))
            break
        value, end, summed = items.all[here], here + 1, kind == "operator"
    wrong = EXPRESSION if summed else {"bad": value.text, "axes": PLACEHOLDERS}.get(value.kind, "")
    return value.rows, wrong, end


def _points(items: Items, at: int, first: int) -> Value | None:
    """Points in one bracket, or one after the other, which may be numbered from `first` or from 0."""
    rows: list[tuple[str, ...]] = []
    numbers: list[str] = []
    end = at
    while True:
        here = items.past(end, _BETWEEN, SAID["numbered"])
        label = [item.text for item in items.all[end:here] if item.kind == "number"]
        kind = items.kind(here)
        if kind in ("bad", "axes") or (kind == "points" and not rows):
            rows_here, wrong, end = _result(items, here)
            return ((), wrong or EXPRESSION, end) if label else (rows_here, wrong, end)
        value = (items.all[here].rows, "", here + 1) if kind == "point" else None
        if items.word(here) in ("x", "y"):
            value = _position(items, here)
        if value is None or value[1]:
            break
        rows += value[0]
        numbers += label
        end = value[2]
    if not rows:
        return None
    fits = any(numbers == [str(base + k) for k in range(len(numbers))] for base in (0, first))
    return tuple(rows), "" if fits else f"numbers its points from {numbers[0]}; points count from 0", end


def chosen(
    found: Sequence[AnswerClaim], items: Items, what: str, others: Sequence[AnswerClaim] = ()
) -> AnswerClaim | None:
    """The claim that counts, None if there is none; AnswerError if the answer does not decide.

    A sentence that corrects one of the `others` takes nothing back.
    """
    standing = [claim for claim in found if not claim.option and (claim.revises or not claim.rejected)]
    firm = [claim for claim in standing if not claim.soft]
    standing = firm if any(not claim.bare for claim in firm) else standing
    labelled = next((k for k, claim in enumerate(standing) if not claim.bare), len(standing))
    standing = [claim for claim in standing[labelled:] if not (claim.bare and claim.misfit)]
    current = standing[0] if standing else None
    disputed = turned = False
    for before, claim in pairwise(standing):
        assert current is not None
        turned = turned or _taken_back(items, before.end, claim.begin, SAID["turns"]) >= 0
        unfit = current.misfit or current.wrong or claim.misfit  # the last word counts, also if it will be refused
        if claim.wrong == PLACEHOLDERS or (claim.bare and unfit and not (turned or claim.revises)):
            continue
        if claim.revises or turned or unfit or (claim.final and not current.final):
            current, disputed, turned = claim, False, False
        elif claim.value == current.value:
            claim.final = claim.final or current.final
            current = claim
        else:
            disputed = True
    options = [claim for claim in found if claim.option]
    if options and (current is None or not (current.begin > options[-1].end or current.final)):
        return _picked(options, current, items, what)
    if disputed:
        raise AnswerError(f"it gives two different {what}s and does not say which one counts; give one only.")
    at, begins = -1 if current is None else current.end, {other.begin for other in others}
    while at >= 0 and (at := _taken_back(items, at, len(items.all), SAID["back"])) >= 0:
        if begins.isdisjoint(range(at, items.sentence(at) + 1)):
            raise AnswerError(f"it takes its {what} back and gives no other; give one {what} only.")
        at += 1
    return current


def _picked(options: Sequence[AnswerClaim], current: AnswerClaim | None, items: Items, what: str) -> AnswerClaim:
    """The option that the answer chooses in the end."""
    names = {option.option for option in options}
    picked: set[str] = set()
    for at in range(options[0].begin, len(items.all)):
        if items.word(at) in SAID["choose"] and "not" not in items.words(at - 3, at):
            near = [item.text.lower() for item in items.all[at : items.sentence(at + 1, 8)] if item.kind != "sign"]
            picked |= names.intersection(
                name for before, name in pairwise(near) if before in (near[0], *SAID["option"])
            )
    picks = [option for option in options if option.option in picked or (len(names) == 1 and current is None)]
    if len({option.value for option in picks}) != 1:
        raise AnswerError(f"it names options and does not say which one counts; give one {what} only.")
    return picks[-1]


def _taken_back(items: Items, begin: int, end: int, signs: Set[str]) -> int:
    """Where a sentence in this part begins that takes back what stands before it; -1 if none does."""
    fresh, said = False, POSITION | PLAN | PATH | SAID["place"]
    for at in range(begin, end):
        word, kind = items.word(at), items.kind(at)
        if word and fresh:
            following = {items.word(at + 1), items.word(at + 2)}
            if word in signs and items.word(at + 1) not in SAID["harmless"]:
                if word not in ("on", "upon", "let", "after") or not following.isdisjoint(SAID["again"]):
                    return at
            elif word in ("that", "this", "it", "which", "i") or (
                word in ("my", "the") and said.intersection(following)
            ):
                rest = [*items.words(at, items.sentence(at, 20))]
                if (word != "i" and _dismissed(rest)) or says(rest, "mistakes"):
                    return at
        fresh = kind in ("stop", "line", "operator", "comma", "sign", "dots") or (
            fresh and not word and kind not in _VALUES
        )
    return -1


def index_claims(items: Items) -> list[AnswerClaim]:
    """All claims of the model's own place: `my plan: a`, "my place is a", "I take place a"."""
    found: list[AnswerClaim] = []
    for at in range(len(items.all)):
        if items.word(at) in ("my", "i"):
            end = items.past(at + 1, {"operator"}, SAID["takes"] | SAID["within"])
            taken = items.word(at) == "my" or not SAID["takes"].isdisjoint(items.words(at, end))
            named = items.word(end) in SAID["place"]
            claim = _index(items, at, end + named) if taken and (named or items.kind(end) == "point") else None
            found += [] if claim is None else [claim]
    return found


def _index(items: Items, begin: int, at: int) -> AnswerClaim | None:
    """The claim of an index whose label ends here."""
    hypothetical = not SAID["hypothetical"].isdisjoint(items.words(items.start(begin, reach=20), begin))
    at = items.past(at, {"sign", "equals", "operator"}, SAID["place"] | SAID["filler"])
    if items.kind(at - 1) in ("sign", "equals") and items.kind(items.past(at, {"line"}) + 1) in ("", "line"):
        at = items.past(at, {"line"})
    if items.kind(at) in ("point", "bad", "axes"):
        wrong = "" if items.all[at].rows else PLACEHOLDERS
        return AnswerClaim(items.all[at].rows, wrong, begin, at + 1, rejected=hypothetical)
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
    elif not behind and items.word(end):
        wrong = f"my plan is {value.text}{items.all[end].text}"
    elif _another(items, end):
        wrong = "my plan gives more than one number"
    elif items.word(end) and not behind.strip("*_`\"'$ \t") and items.word(end) not in SAID["because"]:
        return None  # "my plan is 4 corners"
    place = next((item.rows for item in items.all[end : items.sentence(end) + 1] if len(item.rows) == 1), ())
    asks = items.kind(end) == "stop" and items.all[end].text == "?"
    return AnswerClaim(((value.text,), *place), wrong, begin, end, rejected=hypothetical or asks)


def _another(items: Items, at: int) -> bool:
    """Whether another place is named in the rest of a line: any number but that of a robot, and the 0 of a base."""
    for here in range(at, at + 2 * _REACH):
        if items.kind(here) in ("", "line", "stop") or items.word(here) == "my":
            return False
        based = items.word(here - 1) in ("from", "at", "robot") or items.word(here + 2) in ("based", "indexed")
        if items.word(here) in SAID["ordinals"] or (items.kind(here) == "number" and not based):
            return True
    return False


_FROM_ONE = re.compile(
    r"\b(?:1|one)[- ](?:based|index)|\b(?:count|number|indices|index|start)\w*+ (?:\w++ ){0,2}(?:from|at) (?:1|one)\b"
    r"|\b(?:numbered|numbering|labell?ed|counted|places|indices|corners) 1\b(?! (?:and|or) 2\b)",
    re.IGNORECASE,
)


def counts_from_one(text: str) -> bool:
    """Whether the answer says that it counts places from 1; "if counted from 1" says nothing."""
    for found in _FROM_ONE.finditer(text):
        sentence = re.split(r"\n|\. ", text[max(0, found.start() - 200) : found.start()])[-1]
        if {"if", "were", "would", "not"}.isdisjoint(sentence.lower().split()):
            return True
    return False
