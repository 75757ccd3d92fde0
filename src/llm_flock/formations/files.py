"""Target points from a CSV or JSON file."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any, cast

from llm_flock.arrays import Point
from llm_flock.errors import InputError


def load_points(path: Path, field: str = "points") -> tuple[Point, ...]:
    """Read rows of coordinates from a file: JSON (a list of lists) if its name ends in `.json`, CSV otherwise.

    Each line of a CSV file holds x,y or x,y,z. A first line without numbers is a header; empty lines are skipped. Files
    are in UTF-8; `field` names the setting in errors.

    Raises:
        InputError: the file cannot be read, or its rows are not all 2 or all 3 finite numbers.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:  # no UTF-8, or no name of a file
        raise InputError(field, str(path), f"a readable file ({getattr(error, 'strerror', None) or error})") from None
    rows = _json_rows(text, path, field) if path.suffix.lower() == ".json" else _csv_rows(text, path, field)
    points: list[Point] = []
    for where, row in rows:
        point = _point(row)
        if point is None:
            raise InputError(field, f"{path}, {where}: {row!r}", "2 or 3 finite numbers in each row")
        if points and len(point) != len(points[0]):
            raise InputError(field, f"{path}, {where}: {row!r}", f"{len(points[0])} numbers, as in the first row")
        points.append(point)
    if not points:
        raise InputError(field, str(path), "a file with at least one point")
    return tuple(points)


def _json_rows(text: str, path: Path, field: str) -> list[tuple[str, Any]]:
    try:
        data: Any = json.loads(text)
    except ValueError as error:
        raise InputError(field, str(path), f"a JSON list of [x, y] lists ({error})") from None
    if not isinstance(data, list):
        raise InputError(field, str(path), "a JSON list of [x, y] lists")
    return [(f"row {i + 1}", row) for i, row in enumerate(cast("list[Any]", data))]


def _csv_rows(text: str, path: Path, field: str) -> list[tuple[str, list[Any]]]:
    reader = csv.reader(text.splitlines())
    try:
        rows = [(f"line {reader.line_num}", [_cell(cell) for cell in row]) for row in reader if "".join(row).strip()]
    except csv.Error as error:
        raise InputError(field, f"{path}, line {reader.line_num}", f"comma-separated values ({error})") from None
    has_header = bool(rows) and all(isinstance(cell, str) for cell in rows[0][1])
    return rows[1:] if has_header else rows


def _cell(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text.strip()


def _point(row: Any) -> Point | None:
    """The row as 2 or 3 finite numbers, or None."""
    if not isinstance(row, list) or len(cells := cast("list[Any]", row)) not in (2, 3):
        return None
    if any(isinstance(cell, bool) or not isinstance(cell, int | float) for cell in cells):
        return None
    try:
        point = tuple(float(cell) for cell in cells)
    except OverflowError:
        return None
    return point if all(map(math.isfinite, point)) else None
