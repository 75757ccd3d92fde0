"""A reader of missions by regular expressions: what a program of 430 lines makes of the exam's sentences.

    python -m benchmarks.patterns [--write]

It was written against half of the sentences (tag `open`), and has not been changed since it was scored on the others.
"""

from __future__ import annotations

import argparse
import json
import math
import re
from collections.abc import Iterator
from typing import Any

from benchmarks import figures

UNITS = (
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen"
)
TENS = "twenty thirty forty fifty sixty seventy eighty ninety hundred"
NUMBERS = {word: k for k, word in enumerate(f"{UNITS} eighteen nineteen".split())}
NUMBERS |= {word: 10 * k for k, word in enumerate(TENS.split(), 2)} | {"dozen": 12, "hundred": 100}
NUMBER, PAIR = r"(-?\d+(?:\.\d+)?)", r"[\(\[]?(-?\d+(?:\.\d+)?)(?:\s*,\s*|\s+)(-?\d+(?:\.\d+)?)[\)\]]?"
COMPASS = {"n": (0, 1), "e": (1, 0), "s": (0, -1), "w": (-1, 0)}
DIRECTION = r"\b(north|south|east|west|n|s|e|w)(?:[- ]?(east|west|e|w))?(?:wards?|erly)?\b"
SIDES = {
    "left": "left|west\\w*",
    "right": "right|east\\w*",
    "front": "front\\w*|north\\w*|first",
    "back": "back|rear\\w*|south\\w*",
}
SHAPES = {
    "polygon:5": "pentagon|five[- ]sid|5[- ](?:equal )?(?:sid|corner)",
    "polygon:6": "hexagon|honeycomb|6[- ](?:equal )?(?:sid|corner)",
    "polygon:7": "heptagon|7[- ]sid", "polygon:8": "octagon|8[- ]sid|stop sign", "pyramid": "pyramid",
    "sphere": "sphere|ball|globe",
    "cube": r"cubes?\b|dice", "dome": "dome|hemisphere|igloo", "cylinder": "cylinder|tube|pipe",
    "helix": "helix|corkscrew|spiral",
    "line": r"lines?\b|single file|one row|queue|column", "circle": "circle|ring|disc|disk|encircle|round shape",
    "triangle": "triangle", "square": r"squares?\b|box", "star": r"\bstars?\b", "cross": r"cross\b|plus sign",
    "wedge": r"wedge|geese|\bv\b|arrowhead", "grid": r"grid|rows and columns|matrix|lattice",
}  # fmt: skip
CANNOT = (
    r"\b(push|knock|chase|paint|lift|load|carry|grab|ram|crash|collide|bring|fetch|cook|sing|shout|"
    r"photo\w*|film|open the|"
    r"land on|invisible|teleport|same time|same stage|safety dist\w* off|shoot|spray|pick up|clean|wash)\b"
)
UNCLEAR = {
    "order": r"which (1st|first)|order (is|will|tbc)|(a single|1) after (the )?other|^the \w+ and the \w+\b",
    "robots": r"\bsome of|those 2|a single of the robots|\w+'s robot|team [ab]\b|[ab] team|a few|several|"
        r"you know (who|the)",
    "direction": r"heading (to follow|tbc)|certain angle|that way|ne or nw|emergency|looks wrong|turn (it|"
        r"the \w+)\b(?!.*(\d|north|south|east|west))"
    r"|^(move|shift|go) \d+$",
    "place": r"coords in|beacon|destination given|corner there|a single of the walls|from the wall|over there|"
        r"@ \d+, ?\[|the usual place",
    "size": r"^(wider|spread out|bigger|smaller|closer|tighter)|bigger!|smaller!|a bit (wider|bigger)|different size",
    "shape": r"favourite|tbc|will be communicated|honestly haven't|discussed|enclosed|yesterday|last time|"
        r"of the day|something (else|different)"
    r"|what to do|form up|the usual|\?\?\?|surprise",
}  # fmt: skip
NOT_MEANT = (
    r"(not (?:just )?(?:an? |the )|instead of (?:an? |the )|forget the |i was going to say an? |no |"
    r"rather than (?:an? |the ))[\w-]+",
    r"\b[\w ]+ would be possible, but it is not wanted", r"\b\w+\.\.\. (?:belay that|no|scrap that)", r"\b[\w]+\? no\.",
    r"make a \w+\.\.\. oh[^.?!]*[.?!]", r"that is being flown now", r"the \w+ was lovely",
)  # fmt: skip


def plain(words: str) -> str:
    """Words in lower case, with digits for numbers."""
    text = re.sub(
        r"\b(\w+ty)[- ](one|two|three|four|five|six|seven|eight|nine)\b", _sum, words.lower().replace("\u2019", "'")
    )
    text = re.sub(r"\bone\b(?! unit| per| a round| robot|/)", "a single", text)
    text = re.sub(r"\b[a-z]+\b", lambda word: str(NUMBERS.get(word[0], word[0])), text)
    text = re.sub(r"(\d+) and a half", r"\1.5", text)
    for pattern in NOT_MEANT:
        text = re.sub(pattern, " ", text)
    return text


def _sum(found: re.Match[str]) -> str:
    return str(NUMBERS.get(found[1], 0) + NUMBERS[found[2]]) if found[1] in NUMBERS else found[0]


def _floats(found: re.Match[str], *groups: int) -> list[float]:
    return [float(found[group]) for group in groups]


def _way(found: re.Match[str], first: int) -> tuple[float, float]:
    x, y = COMPASS[found[first][0]]
    if found[first + 1]:
        x, y = COMPASS[found[first + 1][0]][0], y
    length = math.hypot(x, y)
    return x / length, y / length


LETTERS = (
    r"\b(?:[Ww]rite|WRITE|[Ss]pell|[Ll]etters?|[Ww]ord|[Nn]umber)[: ]+(?:out )?(?:the )?(?:letters? |"
    r"word |number )*[\"']?([A-Z0-9]{1,12})\b"
)


def shapes_of(text: str, letters: list[str]) -> Iterator[tuple[int, str]]:
    """The shapes that a text names, with where; `letters` are those for which a sign stands in the text."""
    found = [(m.start(), f"letters:{letters[int(m[1])]}") for m in re.finditer(r"§(\d+)§", text)]
    found += [(m.start(), name) for name, pattern in SHAPES.items() for m in re.finditer(rf"\b(?:{pattern})", text)]
    if not found:
        drawn = re.finditer(r"\b(?:draw|sketch|shape of|look like|outline of|picture of)\s+(?:me )?(an? [a-z]+)", text)
        found = [(m.start(), f"text:{m[1]}") for m in drawn]
    yield from sorted(found)


def center_of(text: str, flown: dict[str, Any] | None) -> list[float] | None:
    """The place that a text names."""
    here = flown["center"] if flown else None
    if m := re.search(
        rf"(?:halfway|middle of the line) between (?:the corner at )?{PAIR} and (?:the corner at )?{PAIR}", text
    ):
        a, b, c, d = _floats(m, 1, 2, 3, 4)
        return [(a + c) / 2, (b + d) / 2]
    if m := re.search(r"(middle|centre) of the (north|south)-?(east|west)", text):
        return [75.0 if m[3] == "east" else 25.0, 75.0 if m[2] == "north" else 25.0]
    off = [
        (float(m[1]), _way(m, 2))
        for m in re.finditer(rf"{NUMBER}(?: units)?(?: to the)? {DIRECTION}(?! wall)(?! side)", text)
    ]
    middle = re.search(r"arena'?s? cent|cent\w+ of the arena|middle of the arena|the cent", text)
    if (
        off
        and (middle or (here and re.search(r"shift|scoot|move|of here|go\b|same", text)))
        and not re.search(r"a round|per round|/rd", text)
    ):
        base = here if here and not middle else [50.0, 50.0]
        return [round(base[k] + sum(d * way[k] for d, way in off), 2) for k in (0, 1)]
    if m := re.search(rf"x ?= ?{NUMBER}.{{1,20}}?y ?= ?{NUMBER}", text):
        return _floats(m, 1, 2)
    wall = (
        rf"{NUMBER}(?: units)? (?:in |off |short of |away |inside )?(?:from |"
        rf"of )?(?:the )?(?:middle of )?(?:the )?{DIRECTION} wall"
    )
    at: list[float | None] = [None, None]
    for m in re.finditer(wall, text):
        x, y = COMPASS[m[2][0]]
        at[0 if x else 1] = float(m[1]) if x + y < 0 else 100 - float(m[1])
    share = r"(quarter|half|3 quarters|third)(?: of the)?(?: way)?(?: from)?(?: the)? (n|s|w|e)\w*(?: wall)? to"
    for m in re.finditer(share, text):
        part = {"quarter": 25.0, "half": 50.0, "3 quarters": 75.0, "third": 33.33}[m[1]]
        at[0 if m[2] in "we" else 1] = part if m[2] in "ws" else 100 - part
    if m := re.search(rf"on y ?= ?{NUMBER}", text):
        at[1] = float(m[1])
    if any(one is not None for one in at):
        return [50.0 if one is None else one for one in at]
    text = re.sub(r"\b(?:ro)?bots? \d+(?:(?:,| and|, and| \+)? \d+)*|team of \d+", " ", text)
    if m := re.search(rf"(?:midway|halfway|half way) along the (north|south|east|west) wall[^.;]*?{NUMBER}", text):
        x, y = COMPASS[m[1][0]]
        return [50 + x * (50 - float(m[2])), 50 + y * (50 - float(m[2]))]
    if m := re.search(rf"(?:\bat|@|around|cent\w+ (?:on|at)?|ctr|here|there|to|\)|^|[a-z],?) ?{PAIR}(?! ?r\b)", text):
        return _floats(m, 1, 2)
    return [50.0, 50.0] if middle else None


def part_of(text: str, letters: list[str], flown: dict[str, Any] | None) -> dict[str, Any] | None:
    """What one sub-team shall do; None if the text names no shape."""
    found = [name for _, name in shapes_of(text, letters)]
    if not found:
        return None
    part: dict[str, Any] = {"shape": found[0]}
    if re.search(r"solid|fill(?!\w* the hole| in)|inside too|not just the rim|filled", text):
        part["fill"] = True
    speed = re.search(rf"{NUMBER}(?: units?)? ?(?:/ ?rd|a round|per round|each round|/ ?round)", text)
    if speed and (m := re.search(DIRECTION, text[: speed.start()] + " " + text[speed.end() :])):
        part["velocity"] = [round(float(speed[1]) * one, 2) for one in _way(m, 1)]
    if (center := center_of(text[: speed.start()] + text[speed.end() :] if speed else text, flown)) is not None:
        part["center"] = center
    gap = (
        rf"(?:\bsp|spacing|\bs)(?: of| is| now)? ?[=:]? ?{NUMBER}|{NUMBER}(?: units)? (?:apart|between|"
        rf"from one|away from each)"
    )
    if m := re.search(
        rf"{gap}|distance between neighbours to {NUMBER}|stand {NUMBER} units|neighbour exactly {NUMBER} away", text
    ):
        part["spacing"] = float(next(filter(None, m.groups())))
    if m := re.search(rf"radius (?:of )?{NUMBER}|\br ?=? ?{NUMBER}", text):
        part["size"] = 2 * float(m[1] or m[2])
    elif m := re.search(
        rf"{NUMBER}(?: units)? (?:wide|across|long|in diameter|in width)|(?:width|diameter) of {NUMBER}", text
    ):
        part["size"] = float(m[1] or m[2])
    if m := re.search(
        rf"(?:\btip|point\w*|facing|aimed?|directed)(?: \w+)?(?: at| to| towards)?(?: the)? {DIRECTION}", text
    ):
        x, y = _way(m, 1)
        part |= (
            {"turn": round(math.degrees(math.atan2(-x, y)))}
            if x and y
            else {"point": m[1] if len(m[1]) > 1 else "north"}
        )
    elif m := re.search(rf"{NUMBER} ?deg\w*( clockwise| cw)?", text):
        part["turn"] = -float(m[1]) if m[2] else float(m[1])
    return part


def who_of(text: str, team: int) -> dict[str, Any] | None:
    if m := re.search(r"(?:robots?|bots?) (\d+)((?:(?:,| and|, and| \+)? \d+)+)", text):
        return {"ids": [int(m[1]), *map(int, re.findall(r"\d+", m[2]))]}
    if m := re.search(r"(?:robots?|bots?) (\d+) (?:to|-) (\d+)", text):
        return {"ids": [*range(int(m[1]), int(m[2]) + 1)]}
    side = next((name for name, pattern in SIDES.items() if re.search(rf"\b(?:{pattern})\b(?! wall)", text[:45])), None)
    side = "nearest" if "nearest" in text else side
    if side and "half" in text[:20]:
        return {"count": team // 2, "side": side}
    m = re.search(r"\b(\d+)\b", re.sub(PAIR, " ", text)[:60])
    return {"count": int(m[1])} | ({"side": side} if side else {}) if m and 0 < int(m[1]) < team else None


def read(words: str, team: int, flown: dict[str, Any] | None = None) -> dict[str, Any]:
    """The typed answer to a mission in words."""
    letters = [m[1] for m in re.finditer(LETTERS, words)]
    signs = iter(range(len(letters)))
    text = plain(re.sub(LETTERS, lambda _: f"§{next(signs)}§", words))
    many = sum(map(int, re.findall(r"\b(\d+) (?:robots|others|bots)\b", text)))
    if (
        re.search(CANNOT, text)
        or many > team
        or any(int(k) >= team for k in re.findall(r"bots? \d+ to (\d+)|bot (\d+)", text) for k in k if k)
    ):
        return {"answer": "refuse"}
    for about, pattern in UNCLEAR.items():
        if re.search(pattern, text):
            return {"answer": "ask", "about": about}
    mission: dict[str, Any] = {"answer": "mission"}
    text = _zones(text, mission)
    if (
        re.search(r"replan|new plan|fill in the hole|close (?:the|up|any) gap|close up", text)
        and "no replan" not in text
    ):
        mission["gaps"] = "replan"
    elif re.search(
        r"no replan|leave (?:the |a )?(?:gap|hole)|hole stays|don't shuffle|just (?:tell|log|report)|gap stays", text
    ):
        mission["gaps"] = "report"
    text = re.sub(
        r"[^.;,]*(?:replan|fill in the hole|new plan|leave (?:the |a )?gap|hole stays|don't shuffle)[^.;,]*", " ", text
    )
    text = _wishes(text, mission)
    if m := re.search(r"(?:team of|there are|all) (\d+)\b|(\d+) (?:robots|of you) (?:in all|strong)", text):
        mission["robots"] = int(m[1] or m[2])
    stages: list[dict[str, Any]] = []
    for piece in _pieces(text):
        stage = _stage(piece, letters, team, flown)
        center = center_of(piece, flown)
        if stage is not None and stages and re.search(r"after (\d+) rounds", piece):
            stages[-1]["hold"] = stage.pop("hold")
        elif (
            stage is None
            and stages
            and (m := re.search(r"(?:hold|stay|wait|keep)\w*[^.;>]*?(\d+) (?:rds?|rounds)", piece))
        ):
            stages[-1]["hold"] = int(m[1])
        elif stage is None and stages and center and len(stages[-1]["parts"]) == 1:
            stage = {"parts": [stages[-1]["parts"][0] | {"center": center}]}
        stages += [stage] if stage else []
    if not stages:
        return {"answer": "ask", "about": "shape"}
    mission["stages"] = stages
    return mission if _flies(mission, team) else {"answer": "refuse"}


def _pieces(text: str) -> list[str]:
    cut = (
        r"\s>\s|[,;.] (?:and |only )?then\b|afterwards|(?=\bafter \d+ rounds)|(?=\b(?:at )?(?:rd|"
        r"round) \d+\b(?! rounds))|(?=\bon (?:my word|order)\b)|continue with"
    )
    return [piece for piece in re.split(cut, text) if piece.strip()]


def _stage(piece: str, letters: list[str], team: int, flown: dict[str, Any] | None) -> dict[str, Any] | None:
    stage: dict[str, Any] = {}
    if m := re.search(r"(?:hold|stay|wait|keep|after)\w*[^.;>]*?(\d+) (?:rds?|rounds)", piece):
        stage["hold"], piece = int(m[1]), piece[: m.start()] + piece[m.end() :]
    if m := re.search(r"\b(?:rd|round) (\d+)", piece):
        stage["when"], piece = {"round": int(m[1])}, piece[: m.start()] + piece[m.end() :]
    elif re.search(r"on (?:my word|order)", piece):
        stage["when"] = "order"
    halves = re.split(
        r"[;.?,:] (?=(?:and |all )?(?:the |every)?(?:others?|rest|remaining|rear|right|everyone|"
        r"everybody|ones left)\b|right half|would you others|other \w+:)",
        piece,
    )
    parts = [part for half in halves if (part := part_of(half, letters, flown))]
    if len(parts) == 1 and "the same" in halves[-1] and len(halves) > 1 and (center := center_of(halves[-1], flown)):
        parts.append(parts[0] | {"center": center})
    if len(parts) > 1:
        for part, half in zip(parts, halves, strict=False):
            if half is halves[-1] and not re.match(r"right half", half):
                continue
            if who := who_of(half, team):
                part["who"] = who
            if m := re.search(
                r"(?:as|=|be|act as|you're)(?: the| my| our)? (?:\d+ )?(\w+s|vanguard|rearguard)\b", half
            ):
                part["role"] = m[1]
    return {"parts": parts, **stage} if parts else None


def _zones(text: str, mission: dict[str, Any]) -> str:
    """Take zones that nobody may enter out of a text."""
    no = (
        r"(?:no-go|keep[- ]out|keep (?:off|away|clear)|stay (?:off|out)|off limits|out of bounds|closed|"
        r"under repair|forbidden|avoid|nobody|must remain empty|no robot may|no entry|prohibited|"
        r"restricted|not enter)"
    )
    zones: list[dict[str, Any]] = []
    for sentence in re.split(r"(?<=[.;!?]) ", text):
        if not re.search(no, sentence):
            continue
        start = re.search(rf"(?:,? )?{no}", sentence)
        piece = (
            sentence
            if re.search(r"closed|repair|bounds|remain|limits", sentence) or start is None
            else sentence[start.start() :]
        )
        if start is not None and not re.search(PAIR, piece):
            piece = text[text.index(sentence) :][:90].partition(". ")[0]
        pairs = [_floats(m, 1, 2) for m in re.finditer(PAIR, piece)]
        radius = re.search(rf"radius (?:of )?{NUMBER}|\br ?=? ?{NUMBER}|{NUMBER} (?:units )?(?:away| of)", piece)
        if m := re.search(rf"y ?([<>=]) ?{NUMBER}", piece):
            y, far = float(m[2]), 100.0 if m[1] == ">" or "north of" in piece else 0.0
            zones.append({"polygon": [[0, far], [100, far], [100, y], [0, y]]})
        elif m := re.search(rf"x ?([<>=]) ?{NUMBER}", piece):
            x, far = float(m[2]), 100.0 if m[1] == ">" or "east of" in piece else 0.0
            zones.append({"polygon": [[far, 0], [far, 100], [x, 100], [x, 0]]})
        elif radius and pairs:
            zones.append({"center": pairs[0], "radius": float(next(filter(None, radius.groups())))})
        elif len(pairs) == 2:
            (a, b), (c, d) = pairs
            zones.append({"polygon": [[a, b], [c, b], [c, d], [a, d]]})
        elif len(pairs) > 2:
            zones.append({"polygon": pairs})
        else:
            continue
        text = text.replace(piece, " ")
    if zones:
        mission["keep_out"] = zones
    return text


def _wishes(text: str, mission: dict[str, Any]) -> str:
    """Take what is said about single robots out of a text."""
    ways = {
        "shortest": r"batt|charge|juice|cell|short",
        "center": r"inside|middle of the|interior",
        "edge": r"edge|rim|outside",
    }
    found: list[dict[str, Any]] = []
    for m in re.finditer(
        r"(?:robots?|bots?|number) (\d+)(?:(?: \+| and|,) (\d+))?(?! (?:and )?\d)((?:(?!bots? \d)[^.;:])*)", text
    ):
        if way := next((way for way, pattern in ways.items() if re.search(pattern, m[3])), None):
            found += [{"robot": int(one), "way": way} for one in (m[1], m[2]) if one]
            text = text.replace(m[0].partition(",")[0], " ")
    if found:
        mission["prefer"] = found
    return text


def _flies(mission: dict[str, Any], team: int) -> bool:
    """Whether numbers are those of a mission that can be flown."""
    takes = {"triangle": (3, 0), "square": (4, 0), "cross": (4, 1), "star": (10, 0), "wedge": (2, 1)}
    if mission.get("robots", team) != team:
        return False
    for part in (part for stage in mission["stages"] for part in stage["parts"]):
        who = part.get("who") or {}
        n = len(who.get("ids", ())) or who.get("count") or team
        n = team - n if not who and len(mission["stages"][0]["parts"]) > 1 else n
        name, _, sides = part["shape"].partition(":")
        by, rest = (int(sides), 0) if name == "polygon" else takes.get(name, (1, 0))
        alone = not who and all(len(stage["parts"]) == 1 for stage in mission["stages"])
        fits = not alone or part.get("fill") or n % by == rest
        reach = part.get("size", 0) / 2 + (part.get("spacing", 0) / 2 if name == "circle" else 0)
        inside = all(reach <= x <= 100 - reach for x in part.get("center", (50, 50)))
        for zone in mission.get("keep_out", []):
            inside = inside and (
                "radius" not in zone or math.dist(zone["center"], part.get("center", (50, 50))) > zone["radius"] - reach
            )
        if name == "line" and "size" in part and "spacing" in part:
            fits = fits and abs(part["size"] - part["spacing"] * (n - 1)) < 1
        slow = math.hypot(*part.get("velocity", (0, 0))) <= 3
        wide = name != "circle" or "size" not in part or part["size"] * math.sin(math.pi / max(2, n)) >= 3
        if not (fits and inside and slow and wide and part.get("spacing", 3) >= 3 and max(who.get("ids", [0])) < team):
            return False
    return True


def score() -> list[dict[str, object]]:
    """Right answers to the exam's sentences, by half of them, style and kind."""
    from llm_flock_lab._exam.score import word_marks
    from llm_flock_lab._exam.splits import paper

    asked = paper(sections="mission")
    right: dict[str, bool] = {}
    for question in asked:
        assert question.words is not None and question.mission is not None
        flown = dict(question.mission) if question.flying else None
        try:
            answer = json.dumps(read(question.words, question.n, flown))
        except (ValueError, LookupError, ArithmeticError):
            answer = ""  # it met what it was not written for
        right[question.id] = word_marks(question, answer).reason is None
    rows: list[dict[str, object]] = []
    for kind in ("all", "plain", "chatty", "terse", "mission", "ask", "refuse"):
        row: dict[str, object] = {"Sentences": kind}
        for half, title in (("open", "Known half"), ("closed", "Other half")):
            found = [right[one.id] for one in asked if half in one.tags and (kind == "all" or kind in one.tags)]
            row[title] = f"{sum(found)} of {len(found)} ({100 * sum(found) / len(found):.0f} %)"
        rows.append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/data/patterns.csv")
    rows = score()
    for row in rows:
        print(row)
    if parser.parse_args().write:
        figures.write("patterns.csv", [list(rows[0]), *(list(row.values()) for row in rows)])


if __name__ == "__main__":
    main()
