"""Reads points from CSV, JSON and SVG files, by the names of their columns; refuses what could be read in two ways."""

from __future__ import annotations

import cmath
import csv
import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias, cast
from xml.etree import ElementTree

from llm_flock.arrays import Point
from llm_flock.errors import InputError

MAX_LETTERS = 1 << 20  #: Letters of a file of points: far more than those of a team of any size.
MAX_DEPTH = 64  #: Deepest nesting of a drawing's elements.

Row: TypeAlias = tuple[str, Sequence[str] | None, list[Any]]
"""Where a row is, the names of its cells if it has some, and the cells."""

Affine: TypeAlias = tuple[float, float, float, float, float, float]
"""A map of the plane, as `matrix` of an SVG: where it takes the directions of x and y, and the origin."""

_AXIS = re.compile(r"(?:p|pos|position|initial)?[ _.]?([xyz])[ _]?(?:m|[\[(]m[\])]|units?|\[units?\])?", re.IGNORECASE)
_WHO = re.compile("(?:drone|robot|agent|uav|point|place)?[ _]?(?:id|name|no|nr|number|index|label)?|unnamed: 0", re.I)
_COLOUR = re.compile("red|green|blue|white|colou?r", re.IGNORECASE)
_SCALED = re.compile(r"(.+)@([\d.]{1,30}(?:e[-+]?\d{1,3})?)", re.IGNORECASE | re.DOTALL)
_DECIMAL = re.compile(r"[-+]?\d{1,20}(?:,\d{1,20})?(?:e[-+]?\d{1,3})?", re.IGNORECASE)
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_CALL = re.compile(r"\b([a-zA-Z]{4,9})\s{0,9}\(([^()]{0,300})\)")
_TEXTS = {"name", "title", "description", "comment"}
_BARE = "2 or 3 finite numbers in each row, or a first line that names the columns"
_JSON = 'a JSON list of [x, y] lists or of {"x": .., "y": ..} objects, or an object with such points by name'
_HIDES = {"display": ("none",), "visibility": ("hidden", "collapse"), "opacity": ("0", "0.0", "0%")}
_UNDRAWN = {"defs", "clipPath", "mask", "marker", "symbol", "pattern", "metadata", "style", "title", "desc", "text"}


class NotRead(Exception):
    """A file cannot be read; the message follows "expected"."""


def load_points(name: str | Path, field: str = "points") -> tuple[Point, ...]:
    """Read points from a file in UTF-8: JSON if its name ends in `.json`, SVG if in `.svg`, CSV otherwise.

    `FILE@SCALE` multiplies all coordinates by a positive number. `field` names the setting in errors. Columns and keys
    are known by their names: coordinates, the robot's id or name, and colours; rows with whole ids are put in their
    order. Rows without names are x,y or x,y,z. CSV may have commas, semicolons, tabs or spaces between its cells;
    where these are no commas, numbers may have decimal commas. An SVG gives the centres of its circles, or the corners
    of its polygons and polylines, in the units of the drawing, with y upwards.

    Raises:
        InputError: the file cannot be read, or in two ways, or its rows are not all 2 or all 3 finite numbers.
    """
    scaled = _SCALED.fullmatch(str(name))
    path, scale = (Path(scaled[1]), _number(scaled[2])) if scaled else (Path(name), 1.0)
    if not (isinstance(scale, float) and 0.0 < scale < math.inf):
        raise InputError(field, str(name), "FILE@SCALE with a positive scale")
    text = file_text(path, field, str(name))
    read = {".json": _json_rows, ".svg": _svg_rows}.get(path.suffix.lower(), _csv_rows)
    try:
        return tuple(_point(str(point), [scale * axis for axis in point]) for point in _points(read(text)))
    except NotRead as error:
        raise InputError(field, str(name), str(error)) from None


def file_text(path: Path, field: str, given: str) -> str:
    """The text of a file in UTF-8; InputError for `field` as it was given if there is none, or too much."""
    try:
        if path.exists() and not path.is_file():
            raise ValueError("not a pipe, device or folder")
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(MAX_LETTERS + 1)
        if len(text) > MAX_LETTERS:
            raise ValueError(f"of at most {MAX_LETTERS >> 20} million letters")
    except (OSError, ValueError) as error:  # no UTF-8, or no name of a file
        raise InputError(field, given, f"a readable file ({getattr(error, 'strerror', None) or error})") from None
    return text


def _points(rows: Iterable[Row]) -> list[Point]:
    points, ids = list[Point](), dict[str, str]()
    known, axes, who = None, list[int](), None
    for where, names, cells in rows:
        if names is not None:
            if names != known:
                known, (axes, who) = names, _columns(names)
            if len(cells) != len(names):
                raise NotRead(f"{len(names)} cells, one for each name of a column, not {cells!r} ({where})")
            if who is not None and ids.setdefault(repr(cells[who]), where) != where:
                raise NotRead(f"one row for each robot; {cells[who]!r} is in {ids[repr(cells[who])]} and {where}")
            cells = [cells[axis] for axis in axes]
        point = _point(where, cells)
        if points and len(point) != len(points[0]):
            raise NotRead(f"{len(points[0])} numbers, as in the first row, not {cells!r} ({where})")
        points.append(point)
    if not points:
        raise NotRead("a file with at least one point")
    for column in list(zip(*points, strict=True))[::2] if known is None and len(points[0]) == 3 else []:
        if len(column) > 1 and all(here == min(column) + k for k, here in enumerate(sorted(column))):
            raise NotRead("names of the columns: the first or last ones count the rows, and could be ids")
    numbers = [_number(one) for one in ids]
    if len(numbers) == len(points) and not any(isinstance(one, str) for one in numbers):
        points = [points[k] for k in sorted(range(len(points)), key=numbers.__getitem__)]
    return points


def _point(where: str, cells: Sequence[Any]) -> Point:
    if len(cells) in (2, 3) and all(type(cell) in (int, float) and abs(cell) < 1e300 for cell in cells):
        return tuple(map(float, cells))
    raise NotRead(f"{_BARE}, not {cells!r} ({where})")


def _columns(names: Sequence[str]) -> tuple[list[int], int | None]:
    """Where x, y and perhaps z are, and where the id or name is. NotRead if a name is not known, or an axis twice."""
    found: dict[str, int] = {}
    for k, name in enumerate(names):
        axis = _AXIS.fullmatch(name)
        if axis and axis[1].lower() in found:
            raise NotRead(f"one column for {axis[1].lower()}, not both {names[found[axis[1].lower()]]!r} and {name!r}")
        if axis:
            found[axis[1].lower()] = k
        elif _WHO.fullmatch(name) and (name or k == 0):  # tables are often written with an unnamed first column
            found.setdefault("id", k)
        elif not _COLOUR.fullmatch(name):
            raise NotRead(f"columns x, y and perhaps z, an id or name, and colours; not {name!r}")
    if not {"x", "y"} <= found.keys():
        raise NotRead(f"columns x and y, not {', '.join(names)}")
    return [found[axis] for axis in "xyz" if axis in found], found.get("id")


def _csv_rows(text: str) -> Iterator[Row]:
    lines = [line.removeprefix("#") if _names(line) else line.partition("#")[0] for line in text.splitlines()]
    first = next((line for line in lines if line.strip()), "")
    mark = next((mark for mark in ";\t," if mark in first), None)
    reader = csv.reader(lines, delimiter=mark or ",")
    spaced = ((number, line.split()) for number, line in enumerate(lines, 1))
    rows: list[tuple[str, list[str]]] = []
    try:
        for number, row in ((reader.line_num, row) for row in reader) if mark else spaced:
            cells = [cell.strip() for cell in row]
            while cells and not cells[-1]:  # marks at the end of lines
                cells.pop()
            if cells:
                rows.append((f"line {number}", cells))
    except csv.Error as error:
        raise NotRead(f"comma-separated values (line {reader.line_num}: {error})") from None
    every = [cell for _, cells in rows for cell in cells]
    comma = next((cell for cell in every if mark != "," and "," in cell and _DECIMAL.fullmatch(cell)), "")
    point = next((cell for cell in every if "." in cell and isinstance(_number(cell), float)), "")
    if comma and point:
        raise NotRead(f"decimal commas or decimal points, not both {comma!r} and {point!r}")
    read = [(where, [_number(cell.replace(",", ".") if comma else cell) for cell in cells]) for where, cells in rows]
    names = rows[0][1] if rows and all(isinstance(cell, str) for cell in read[0][1]) else None
    for where, cells in read[names is not None :]:
        yield where, names, cells


def _names(line: str) -> bool:
    """Whether a line that begins as a comment names columns, as tables of numpy do."""
    cells = re.split(r"[;,\t ]+", line.removeprefix("#").strip())
    return line.startswith("#") and {"x", "y"} <= {axis[1].lower() for axis in map(_AXIS.fullmatch, cells) if axis}


def _number(text: str) -> float | str:
    """The number that is written, or else the text."""
    try:
        return float(text)
    except ValueError:
        return text


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(found := dict(pairs)) < len(pairs):
        raise NotRead("each name once in an object")
    return found


def _json_rows(text: str) -> Iterator[Row]:
    try:
        data: Any = json.loads(text, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise NotRead(f"{_JSON} ({error})") from None
    if isinstance(data, dict):
        data = {key: value for key, value in cast("dict[str, Any]", data).items() if key not in _TEXTS}
        data = data["points"] if data.keys() == {"points"} else data
    if isinstance(data, list):
        data = dict(enumerate(cast("list[Any]", data), 1))
    if not isinstance(data, dict) or any(map(_AXIS.fullmatch, map(str, cast("dict[Any, Any]", data)))):
        raise NotRead(_JSON)
    for key, row in cast("dict[Any, Any]", data).items():
        where = f"row {key}" if isinstance(key, int) else repr(key)
        cells: dict[str, Any] = {"id": _number(key)} if isinstance(key, str) else {}
        if not isinstance(row, list | dict):
            raise NotRead(f"{_BARE}, not {row!r} ({where})")
        if isinstance(row, list) and not cells:
            yield where, None, cast("list[Any]", row)
        else:
            cells |= cast("Any", row if isinstance(row, dict) else zip("xyzw", cast("list[Any]", row), strict=False))
            yield where, [*cells], [*cells.values()]


def _svg_rows(text: str) -> Iterator[Row]:
    drawing = _Places()
    drawing.read(text)
    if drawing.centers and drawing.corners:
        raise NotRead("circles or polygons, not both: it is not clear which are the points")
    for number, (x, y) in enumerate(drawing.centers or drawing.corners, 1):
        yield f"point {number}", None, [x, 0.0 - y]


class SvgReader:
    """Reads the elements of an SVG that are drawn; a subclass takes what it wants in `found`."""

    def __init__(self) -> None:
        self._styled = False
        self._maps: list[Affine | None] = [(1.0, 0.0, 0.0, 1.0, 0.0, 0.0)]  # None: what is inside is not drawn

    def read(self, text: str) -> None:
        """Read a whole SVG; NotRead if it is none."""
        if "<!ENTITY" in text:  # a few could grow without end
            raise NotRead("an SVG without entities")
        parser = ElementTree.XMLParser(target=self)  # noqa: S314 - it builds no tree
        try:
            parser.feed(text)
            parser.close()
        except ElementTree.ParseError as error:
            raise NotRead(f"an SVG ({error})") from None

    def found(self, kind: str, given: dict[str, str], here: Affine) -> None:
        """Take an element that is drawn, with its attributes and its map to the drawing."""
        raise NotImplementedError

    def start(self, tag: str, given: dict[str, str]) -> None:
        """Called by the parser at the beginning of an element."""
        kind, outer = tag.removeprefix("{http://www.w3.org/2000/svg}"), self._maps[-1]
        if len(self._maps) > MAX_DEPTH or (kind == "svg") != (len(self._maps) == 1):
            raise NotRead(f"one SVG, its elements nested at most {MAX_DEPTH} times, not {kind}")
        style = given.get("style", "").replace(" ", "")
        self._styled = kind == "style"
        said = {name: given.get(name, "") for name in _HIDES} | dict(re.findall(r"([a-z]+):([^;]*)", style))
        hidden = kind in _UNDRAWN or "{" in kind or any(said[name] in values for name, values in _HIDES.items())
        if hidden or outer is None:
            self._maps.append(None)
            return
        here = _composed(outer, given.get("transform", style if "transform:" in style else ""))
        self._maps.append(here)
        if kind not in ("svg", "g", "a", "switch") and given.get("width") != "100%":  # that is a background
            self.found(kind, given, here)

    def data(self, text: str) -> None:
        """Called by the parser for the text of an element."""
        if self._styled and re.search("display|visibility|opacity", text):
            raise NotRead("an SVG whose style sheet hides nothing")

    def end(self, tag: str) -> None:
        """Called by the parser at the end of an element."""
        self._styled = False
        self._maps.pop()


class _Places(SvgReader):
    """Centres of circles, and corners of polygons."""

    def __init__(self) -> None:
        super().__init__()
        self.centers, self.corners = list[Point](), list[Point]()

    def found(self, kind: str, given: dict[str, str], here: Affine) -> None:
        if kind in ("circle", "ellipse"):
            self.centers += placed(here, numbers_of(given, "cx", "cy"))
        elif kind in ("polygon", "polyline"):
            corners = placed(here, floats(given.get("points", "")))
            self.corners += corners[: len(corners) - (len(corners) > 1 and corners[0] == corners[-1])]  # closed
        else:
            raise NotRead(f"circles, ellipses, polygons and polylines, not {kind}")


def numbers_of(given: dict[str, str], *names: str) -> list[float]:
    """One number for each attribute, 0 for one that is missing."""
    numbers = [floats(given.get(key, "0").removesuffix("px")) for key in names]
    if any(len(one) != 1 for one in numbers):
        raise NotRead(f"one number each as {' and '.join(names)}, not {numbers!r}")
    return [one[0] for one in numbers]


def placed(here: Affine, numbers: Sequence[float]) -> list[Point]:
    """Points of a list x, y, x, y, ... under a map."""
    if len(numbers) % 2:
        raise NotRead(f"pairs of numbers as points, not {len(numbers)} numbers")
    a, b, c, d, e, f = here
    pairs = zip(numbers[::2], numbers[1::2], strict=True)
    return [(a * x + c * y + e, b * x + d * y + f) for x, y in pairs]


def floats(text: str) -> list[float]:
    """All numbers of a list; nothing else may be in it."""
    numbers, rest = [float(number) for number in _NUMBER.findall(text)], _NUMBER.sub("", text).replace(",", " ").strip()
    if rest or math.inf in map(abs, numbers):
        raise NotRead(f"finite numbers without units, not {(rest or text)[:40]!r}")
    return numbers


def _composed(here: Affine, text: str) -> Affine:
    """A map after the transforms of an attribute, in their order."""
    unread = _CALL.sub("", text).replace(",", " ").strip()
    for name, given in [*_CALL.findall(text), *([(unread, "")] if unread else [])]:
        match name, floats(given):
            case "translate", [x, *more]:
                six = [1.0, 0.0, 0.0, 1.0, x, *(more or [0.0])]
            case "scale", [x, *more]:
                six = [x, 0.0, 0.0, *(more or [x]), 0.0, 0.0]
            case "rotate", [angle, *center] if len(center) in (0, 2):
                turn, about = cmath.rect(1.0, math.radians(angle)), complex(*center)
                still = about - turn * about
                six = [turn.real, turn.imag, -turn.imag, turn.real, still.real, still.imag]
            case _, numbers:
                six = numbers * (name == "matrix")
        if len(six) != 6:
            raise NotRead(f"translate, scale, rotate and matrix as transforms, not {name} {given[:40]}")
        (a, b), (c, d), (e, f) = *placed((*here[:4], 0.0, 0.0), six[:4]), *placed(here, six[4:])
        here = (a, b, c, d, e, f)
    return here
