"""Requests in words with their right answers: missions, questions back and refusals, and edits of programs.

They are put together from the pieces in `curriculum.toml`, or are whole sentences of `written.jsonl`, whose writers saw
neither the exam nor the pieces. An answer that cannot be flown is not taught.

A line of `written.jsonl` has wordings of one request (`say`), the program that an edit changes, and the answer. Slots
in braces vary all three: `{x}` a number, `{x:words}` the same in words, `{shape}` a shape, `=100-{x}` a sum.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.lessons import pick

from llm_flock.errors import AnswerError, InputError
from llm_flock.formation import parse_program
from llm_flock.llm import Call, draft_of, edit_call, edited, mission_call
from llm_flock.mission import Mission, build_mission
from llm_flock_onboard._distill.curriculum import CURRICULUM
from llm_flock_onboard._distill.examples import Example, Kind

WORDS: dict[str, Any] = CURRICULUM["missions"]
SIDES = {"north": (0, 1), "east": (1, 0), "south": (0, -1), "west": (-1, 0)}
UNASKED = 0.3
"""Share of requests that a reader has to refuse, or to ask about; half each."""
ASIDES, SLIPS = 0.25, 0.1
"""Shares of requests with a sentence beside that asks for nothing, and with a slip of the keys."""
WRITTEN = 0.8
"""Share of whole sentences among requests, and among edits."""

LENGTHS = {"s": (4, 14), "w": (18, 70), "n": (5, 20), "t": (10, 170), "k": (3, 60), "k2": (3, 60), "r": (3, 14)}
"""Slots of whole numbers, with the least and the largest one; coordinates are 15 to 85."""

TENS = ("", "", "twenty", "thirty", "forty", "fifty", "sixty", "seventy", "eighty", "ninety")
UNITS = (
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen "
    "eighteen nineteen"
)


@cache
def written(kind: Kind) -> tuple[dict[str, Any], ...]:
    """The whole sentences for missions, or for edits."""
    lines = Path(__file__).with_name("written.jsonl").read_text(encoding="utf-8").splitlines()
    return tuple(given for given in map(json.loads, lines) if ("program" in given) == (kind == "edit"))


def filled(rng: np.random.Generator, given: dict[str, Any]) -> tuple[str, dict[str, Any], dict[str, Any] | None]:
    """One wording of a request, its answer and its program, with the slots filled."""
    side, other = (str(one) for one in rng.choice(list(SIDES), 2, replace=False))
    named = [name for name in WORDS["shapes"] if not name.startswith(("text:", "letters:"))]
    shapes = [str(one) for one in rng.choice(named, 2, replace=False)]
    pace, step = int(rng.integers(1, 7)) / 2, 5 if rng.random() < 0.6 else 1
    real: dict[str, Any] = {k: step * int(rng.integers(15 // step, 85 // step + 1)) for k in ("x", "y", "x2", "y2")}
    real |= {name: int(rng.integers(low, high + 1)) for name, (low, high) in LENGTHS.items()}
    real |= dict(zip("ij", map(int, rng.choice(10, 2, replace=False)), strict=True))
    real |= {"t": 5 * (real["t"] // 5), "v": _whole(pace), "side": side, "side2": other}
    real |= {"velocity": [_whole(pace * k) if k else 0 for k in SIDES[side]], "shape": shapes[0], "shape2": shapes[1]}
    said = real | {f"shape{k}": pick(rng, WORDS["shapes"][name]) for k, name in zip(("", "2"), shapes, strict=True)}

    def say(found: re.Match[str]) -> str:
        return _in_words(said[found[1]]) if found[2] else str(said[found[1]])

    def fill(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: fill(one) for name, one in value.items()}
        if isinstance(value, list):
            return [fill(one) for one in value]
        if not isinstance(value, str):
            return value
        if value[:1] == "{" and value[1:-1] in real:
            return real[value[1:-1]]
        text = re.sub(r"\{(\w+)\}", lambda found: str(real[found[1]]), value)
        return _whole(round(eval(text[1:], {"__builtins__": {}}), 2)) if text[:1] == "=" else text

    words = re.sub(r"\{(\w+)(:words)?\}", say, pick(rng, given["say"]))
    return words, fill(given["answer"]), fill(given.get("program"))


def _whole(value: float) -> float:
    return int(value) if value == int(value) else value


def _in_words(value: float) -> str:
    if value != int(value):
        return f"{_in_words(int(value))} and a half"
    tens, units = divmod(int(value), 10)
    small = UNITS.split()
    if value < len(small):
        return small[int(value)]
    return "a hundred" if tens > 9 else TENS[tens] + (f"-{small[units]}" if units else "")


def _example(kind: Kind, call: Call, answer: dict[str, Any], topic: str) -> Example:
    messages = tuple((message.role, message.text) for message in call.messages)
    return Example(kind=kind, messages=messages, answer=json.dumps(answer), topic=topic)


def draw_request(rng: np.random.Generator) -> Example | None:
    """A request for a mission, by a team that is set up or flies; its answer has the order of the schema."""
    flying, base, given = bool(rng.random() < 0.3), Mission(), None
    if rng.random() < WRITTEN:
        given = pick(rng, written("mission"))
        flying = given.get("flying", False)
    if flying:
        n = 10 if given else int(rng.choice([6, 8, 10]))
        base = build_mission(shape=pick(rng, ["circle", "line", "grid"]), n_robots=n)
    if given is not None:
        words, answer, _ = filled(rng, given)
    elif rng.random() < UNASKED:
        if rng.random() < 0.5:
            about = pick(rng, list(WORDS["ask"]))
            words, answer = pick(rng, WORDS["ask"][about]), {"answer": "ask", "about": about}
        else:
            words, answer = pick(rng, WORDS["refuse"]["train"]), {"answer": "refuse"}
    else:
        words, answer = _mission(rng, flying=flying)
    try:
        if answer["answer"] == "mission":
            draft_of(json.dumps(answer), base, flying=flying)
    except (InputError, AnswerError):
        return None
    return _example(
        "mission", mission_call(_worn(rng, words, answer), base, flying=flying, brief=True), answer, "words"
    )


def _worn(rng: np.random.Generator, words: str, answer: dict[str, Any]) -> str:
    """Words as people write them: with a phrase or a sentence beside them, slips of the keys, or in small letters."""
    words = words[0].upper() + words[1:] if rng.random() < 0.5 else words
    words += pick(rng, WORDS["close"]["train"]) if words[-1] not in ".!?" else ""
    if rng.random() < ASIDES:
        aside, last = pick(rng, WORDS["aside"]["train"]).format(v=int(rng.integers(2, 90))), rng.random() < 0.5
        words = f"{words}{'' if words[-1] in '.!?' else '.'} {aside}" if last else f"{aside} {words}"
    kept = json.dumps(answer).lower()
    long = [found for found in re.finditer("[a-z]{6,}", words) if found[0] not in kept]
    if long and rng.random() < SLIPS:
        at = pick(rng, long).end() - 2
        swapped = "" if rng.random() < 0.5 else words[at : at + 1]
        words = f"{words[:at]}{words[at + 1 : at + 2]}{swapped}{words[at + 2 :]}"
    return words.lower() if rng.random() < 0.25 else words


def _mission(rng: np.random.Generator, *, flying: bool) -> tuple[str, dict[str, Any]]:
    answer: dict[str, Any] = {"answer": "mission"}
    words, after = "", ""
    if not flying and rng.random() < 0.15:
        answer["robots"] = int(rng.integers(4, 31))
        words = pick(rng, WORDS["robots"]["train"]).format(n=answer["robots"])
    if not flying and rng.random() < 0.15:
        x, y, v = (int(k) for k in rng.integers(5, 90, 3))
        if rng.random() < 0.5:
            answer["keep_out"] = [{"center": [x, y], "radius": 3 + v % 12}]
            after += pick(rng, WORDS["disc"]["train"]).format(x=x, y=y, v=3 + v % 12)
        else:
            x2, y2 = x + 4 + v % 20, y + 5 + v % 7
            answer["keep_out"] = [{"polygon": [[x, y], [x2, y], [x2, y2], [x, y2]]}]
            after += pick(rng, WORDS["box"]["train"]).format(x=x, y=y, x2=x2, y2=y2)
    if not flying and rng.random() < 0.08:
        answer["gaps"] = pick(rng, ["replan", "report"])
        after += pick(rng, WORDS[answer["gaps"]]["train"])
    if rng.random() < 0.1:
        said, parts = _parts(rng)
        words, answer["stages"] = words + said, [{"parts": parts}]
    else:
        said, stage = _stage(rng, pick(rng, WORDS["open"]["train"]))
        words, answer["stages"] = words + said, [stage]
        while len(answer["stages"]) < 3 and rng.random() < 0.25:
            said, stage = _stage(rng, pick(rng, WORDS["then"]["train"]))
            if rng.random() < 0.3:
                key = pick(rng, ["order", "round"])
                v = int(rng.integers(10, 60))
                stage["when"] = "order" if key == "order" else {"round": v}
                said += pick(rng, WORDS[key]["train"]).format(v=v)
            words, answer["stages"] = words + said, [*answer["stages"], stage]
    if rng.random() < 0.08:
        wish = {"robot": int(rng.integers(6)), "way": pick(rng, list(WORDS["prefer"]))}
        answer["prefer"] = [wish]
        after += pick(rng, WORDS["prefer"][wish["way"]]).format(i=wish["robot"])
    return words + after, answer


def _stage(rng: np.random.Generator, opening: str) -> tuple[str, dict[str, Any]]:
    """One formation: its words, and the stage, fields in the order of the schema."""
    shape = pick(rng, list(WORDS["shapes"]))
    said: dict[str, tuple[str, Any]] = {}

    def add(name: str, share: float, value: Any, **values: Any) -> None:
        if rng.random() < share:
            said[name] = (pick(rng, WORDS[name]["train"]).format(**values), value)

    x, y = (int(k) for k in rng.integers(2, 9, 2) * 10 + (rng.random() < 0.3) * rng.integers(-4, 5, 2))
    v, side, way = float(rng.integers(7, 41)) / 2, pick(rng, list(SIDES)), pick(rng, list(SIDES))
    number: Any = int(v) if v == int(v) else v
    plain = not shape.startswith("text:")
    add("fill", 0.06 * plain, True)
    add("center", 0.45, [x, y], x=x, y=y)
    add("spacing", 0.25, number, v=number)
    if "spacing" not in said:
        add("size", 0.12 * plain, 10 + int(rng.integers(4, 45)), v="{v}")
        if "size" in said:
            said["size"] = (said["size"][0].format(v=said["size"][1]), said["size"][1])
    add("point", 0.1 * (shape in ("wedge", "triangle", "line")), side, side=side)
    if "point" not in said:
        turn = 5 * int(rng.integers(2, 18))
        add("turn", 0.08 * plain, turn, v=turn)
    pace = int(rng.integers(1, 4)) / 2
    pace = int(pace) if pace == int(pace) else pace
    add("velocity", 0.06, [pace * k + 0 if k else 0 for k in SIDES[way]], side=way, v=pace)
    words = opening.format(shape=pick(rng, WORDS["shapes"][shape]))
    names = [name for name in ("center", "spacing", "size", "fill", "point", "turn", "velocity") if name in said]
    words += "".join(said[names[k]][0] for k in rng.permutation(len(names)))
    part = {
        "shape": shape,
        **{n: said[n][1] for n in ("fill", "center", "spacing", "size", "point", "turn", "velocity") if n in said},
    }
    stage: dict[str, Any] = {"parts": [part]}
    if rng.random() < 0.12:
        stage["hold"] = int(rng.integers(2, 30))
        words += pick(rng, WORDS["hold"]["train"]).format(v=stage["hold"])
    return words, stage


def _parts(rng: np.random.Generator) -> tuple[str, list[dict[str, Any]]]:
    """Two sub-teams."""
    shapes = [shape for shape in WORDS["shapes"] if not shape.startswith(("text:", "letters:"))]
    one, two = pick(rng, shapes), pick(rng, shapes)
    ids, wording = (
        sorted(int(i) for i in rng.choice(9, int(rng.integers(3, 6)), replace=False)),
        pick(rng, WORDS["parts"]["train"]),
    )
    who: dict[str, Any] = {"ids": ids} if "{ids}" in wording else {"count": len(ids)}
    listed = ", ".join(map(str, ids[:-1])) + f" and {ids[-1]}"
    words = wording.format(
        ids=listed, count=len(ids), one=pick(rng, WORDS["shapes"][one]), two=pick(rng, WORDS["shapes"][two])
    )
    return words, [{"who": who, "shape": one}, {"shape": two}]


def _element(rng: np.random.Generator) -> dict[str, Any]:
    shape = pick(rng, ["circle", "square", "triangle", "star", "cross", "wedge", "line", "polygon"])
    sides = {"sides": int(rng.integers(5, 11))} if shape == "polygon" else {}
    more: dict[str, Any] = {}
    if rng.random() < 0.3:
        more["scale"] = pick(rng, [0.5, 2, 1.5, [1, 2], [2, 1], [1.5, 1]])
    if rng.random() < 0.2:
        more["turn"] = int(rng.choice([15, 30, 45, 90]))
    return {"shape": shape, **sides, **more}


def draw_edit(rng: np.random.Generator) -> Example | None:
    """A program, a wish, and the changed program, as programs are shown."""
    if rng.random() < WRITTEN:
        words, wanted, program = filled(rng, pick(rng, written("edit")))
        return _edited(rng, words, program or {}, wanted, "written")
    kinds, says = list(CURRICULUM["edits"]), CURRICULUM["edits"]
    kind, v, first = pick(rng, kinds), pick(rng, [2, 3, 1.5, 0.5, 4]), _element(rng)
    values: dict[str, Any] = {"v": v}
    given: dict[str, Any] = {"draw": [first]}
    if kind in ("role", "count", "at"):
        roles = [str(r) for r in rng.choice(["pilots", "guides", "runners", "carriers", "singers"], 3, replace=False)]
        ats = (rng.integers(2, 9, (3, 2)) * 10).tolist()
        counts = rng.integers(3, 9, 3).tolist()
        groups = [
            {
                "role": roles[k],
                "count": counts[k],
                "at": ats[k],
                "draw": [{"shape": pick(rng, ["circle", "line", "square"])}],
            }
            for k in range(2)
        ]
        given, k = {"groups": groups}, int(rng.integers(2))
        field = {"role": "role", "count": "count", "at": "at"}[kind]
        new = {"role": roles[2], "count": counts[2], "at": ats[2]}[kind]
        wanted: dict[str, Any] = {"groups": [{**g, field: new} if i == k else g for i, g in enumerate(groups)]}
        values = {"role": roles[k], "new": roles[2], "v": counts[2], "x": ats[2][0], "y": ats[2][1]}
    elif kind == "refuse":
        wanted = {"refuse": "It cannot be drawn."}
    elif kind in ("drop_last", "drop_first"):
        draws = [first, _element(rng), _element(rng)][: int(rng.integers(2, 4))]
        given, wanted = {"draw": draws}, {"draw": draws[:-1] if kind == "drop_last" else draws[1:]}
    elif kind == "size":
        values["v"] = 5 * int(rng.integers(4, 20))
        given, wanted = {"draw": [first], "size": 70}, {"draw": [first], "size": values["v"]}
        given = given if rng.random() < 0.4 else {"draw": [first]}
    else:
        changed = dict(first)
        if kind in ("scale_x", "scale_y"):
            scale = first.get("scale", 1)
            x, y = np.broadcast_to(scale, 2).tolist()
            changed["scale"] = [x * v, y] if kind == "scale_x" else [x, y * v]
        elif kind in ("turn", "turn_back"):
            values["v"] = int(rng.choice([10, 20, 30, 45, 60, 90]))
            changed["turn"] = first.get("turn", 0) + (values["v"] if kind == "turn" else -values["v"])
        elif kind == "shape":
            changed["shape"] = values["shape"] = pick(rng, ["circle", "square", "triangle", "star", "cross"])
            changed.pop("sides", None)
        elif kind == "sides":
            values["v"] = int(rng.integers(3, 13))
            first = {"shape": "polygon", "sides": int(rng.integers(5, 11))}
            changed = {**first, "sides": values["v"]}
        elif kind == "text":
            first = {"text": pick(rng, ["HI", "OK", "A", "FLY"])}
            values["word"] = pick(rng, ["BYE", "NO", "B", "GO", "ZOO"])
            changed = {"text": values["word"]}
        elif kind in ("mirror_x", "mirror_y"):
            changed["mirror"] = kind[-1]
        elif kind == "times":
            first = {**first, "repeat": {"times": int(rng.integers(2, 5)), "move": [3, 0]}}
            values["v"] = int(rng.integers(2, 9))
            changed = {**first, "repeat": {**first["repeat"], "times": values["v"]}}
        elif kind == "fill":
            changed["fill"] = True
        else:
            first = {"points": rng.integers(0, 9, (int(rng.integers(3, 6)), 2)).tolist()}
            changed = {**first, "closed": True}
        given, wanted = {"draw": [first]}, {"draw": [changed]}
    return _edited(rng, pick(rng, says[kind]).format(**values), given, wanted, kind)


def _edited(
    rng: np.random.Generator, words: str, given: dict[str, Any], wanted: dict[str, Any], topic: str
) -> Example | None:
    """The example of an edit, or None if one of its programs cannot be drawn."""
    try:
        program = parse_program(given)
        said = "refuse" in wanted or parse_program(wanted)
        right = wanted if said is True else dict(changes("", json.loads(program.spoken), json.loads(said.spoken)))
    except InputError:
        return None
    if not 0 < len(right) < 9:  # as it was, or more changes than the grammar allows
        return None
    assert said is True or edited(json.dumps(right), program) == said, right
    n = sum(group.get("count", 0) for group in given.get("groups", ())) or 12
    call = edit_call(_worn(rng, words, right), program, n, brief=True)
    messages = tuple((message.role, message.text) for message in call.messages)
    return Example(kind="edit", messages=messages, answer=json.dumps(right, ensure_ascii=False), topic=topic)


def changes(path: str, old: Any, new: Any) -> Iterator[tuple[str, Any]]:
    """What makes one JSON value another: paths and new values, None for what goes; a list changed all over, whole."""
    if old == new:
        return
    if isinstance(old, dict) and isinstance(new, dict) and (not path or next(iter(old)) == next(iter(new))):
        for key in [*(key for key in new if key in old), *(key for key in new if key not in old)]:
            yield from changes(f"{path}/{key}", old.get(key), new[key])
        yield from ((f"{path}/{key}", None) for key in old if key not in new)
    elif isinstance(old, list) and isinstance(new, list) and any(isinstance(one, (dict, list)) for one in new):
        gone = [i for i, one in enumerate(old) if one not in new]
        if len(old) == len(new) and len(gone) < max(2, len(old)):
            yield from (pair for i, one in enumerate(new) for pair in changes(f"{path}/{i}", old[i], one))
        elif new[:-1] == old:
            yield f"{path}/-", new[-1]
        elif [one for i, one in enumerate(old) if i not in gone] == new:
            yield from ((f"{path}/{i}", None) for i in reversed(gone))
        else:
            yield path, new
    else:
        yield path, new
