"""Reads programs from TOML and JSON files, and the outlines of SVG drawings as programs."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

from llm_flock.bounds import MAX_PROGRAM_BYTES
from llm_flock.errors import InputError
from llm_flock.formation._paths import Stroke, strokes_of
from llm_flock.formation._program import Program, parse_program
from llm_flock.point_files import Affine, NotRead, SvgReader, file_text, floats, numbers_of, placed

KINDS = (".toml", ".json", ".svg")
WIDE = 1000  #: Width or height of an outline's drawing, whichever is larger: its coordinates are whole numbers.


def load_program(name: str, field: str = "program", kinds: Sequence[str] = KINDS) -> Program:
    """The program in a file: TOML if its name ends in `.toml`, JSON if in `.json`, outlines of a drawing if in `.svg`.

    The outlines are simplified until the program is small enough. `field` names the setting in errors, and `kinds`
    are the endings that are allowed.

    Raises:
        InputError: the file cannot be read, or holds no program.
    """
    path = Path(name)
    if path.suffix.lower() not in kinds:
        raise InputError(field, name, f"the name of a file that ends in {' or '.join(kinds)}")
    text = file_text(path, field, name)
    try:
        if path.suffix.lower() == ".svg":
            return parse_program({"name": _letters(path.stem), "draw": [{"path": _outlines(text)}]}, field)
        if path.suffix.lower() == ".toml":
            return parse_program(tomllib.loads(text), field)
    except NotRead as error:
        raise InputError(field, name, str(error)) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(field, name, f"TOML ({error})") from None
    return parse_program(text, field)


def _letters(stem: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in stem)[:40]


class _Outlines(SvgReader):
    """All lines of a drawing; what is filled counts by its outline."""

    def __init__(self) -> None:
        super().__init__()
        self.strokes: list[Stroke] = []

    def found(self, kind: str, given: dict[str, str], here: Affine) -> None:
        path = _path_of(kind, given)
        if path is None:
            raise NotRead(f"paths, rectangles, circles, ellipses, lines and polygons, not {kind}")
        for stroke in strokes_of(path, kind):
            corners = placed(here, [axis for z in stroke for axis in (z.real, z.imag)])
            self.strokes.append([complex(*corner) for corner in corners])


def _path_of(kind: str, given: dict[str, str]) -> str | None:
    """The path data of an SVG element."""
    if kind == "path":
        return given.get("d", "")
    if kind == "line":
        return "M{} {}L{} {}".format(*numbers_of(given, "x1", "y1", "x2", "y2"))
    if kind in ("polygon", "polyline"):
        numbers = " ".join(map(str, floats(given.get("points", ""))))
        return f"M{numbers}{'Z' * (kind == 'polygon')}" if numbers else ""
    if kind == "rect":
        x, y, width, height = numbers_of(given, "x", "y", "width", "height")
        return f"M{x} {y}H{x + width}V{y + height}H{x}Z"
    if kind in ("circle", "ellipse"):
        radii = ("r", "r") if kind == "circle" else ("rx", "ry")
        x, y, rx, ry = numbers_of(given, "cx", "cy", *radii)
        return f"M{x + rx} {y}A{rx} {ry} 0 1 1 {x - rx} {y}A{rx} {ry} 0 1 1 {x + rx} {y}Z"
    return None


def _outlines(text: str) -> str:
    """The lines of an SVG as path data that fits into a program."""
    import numpy as np
    import shapely

    drawing = _Outlines()
    drawing.read(text)
    strokes = [stroke for stroke in drawing.strokes if len(set(stroke)) > 1]
    every = np.array([(z.real, z.imag) for stroke in strokes for z in stroke]).reshape(-1, 2)
    if not len(every):
        raise NotRead("an SVG with at least one line")
    low, grown = every.min(axis=0), WIDE / float(np.ptp(every, axis=0).max())
    lines = [(np.array([(z.real, z.imag) for z in stroke]) - low) * grown for stroke in strokes]
    tolerance, room = 1.0, MAX_PROGRAM_BYTES - 100
    while tolerance <= WIDE / 20:
        simple = (shapely.simplify(shapely.LineString(line), tolerance) for line in lines)
        path = "".join(_data(shapely.get_coordinates(line).round().astype(int).tolist()) for line in simple)
        if len(path) <= room:
            return path
        tolerance *= 1.3
    raise NotRead(f"fewer or simpler lines: a program has at most {MAX_PROGRAM_BYTES:,} bytes")


def _data(corners: list[list[int]]) -> str:
    closed = corners[0] == corners[-1]
    return "M" + "L".join(f"{x} {y}" for x, y in corners[: len(corners) - closed]) + "Z" * closed
