"""Points that are written in any form that files may have are read back; what is not clear is never read as others."""

import json
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.errors import InputError
from llm_flock.point_files import load_points

HEADS = {"x": ["x", "X", "px", "pos_x", "x_m", "x [m]", "Pos X (m)"], "y": ["y", "Y", "py", "pos.y", "y_m", "y[m]"]}
IDS = ["id", "drone_id", "Name", "Robot ID", "", "index", "agent_no"]
NUMBERS = st.integers(-10_000, 10_000).map(lambda k: k / 8)
TEAMS = st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=8)


def read(text: str, name: str) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_text(text, encoding="utf-8")
        return load_points(path)


@st.composite
def tables(draw: st.DrawFn, points: list[tuple[float, float]]) -> str:
    """The points as a table: columns in any order, any mark between cells, ids and colours beside them."""
    columns: dict[str, list[Any]] = {
        draw(st.sampled_from(HEADS[axis])): [point[k] for point in points] for k, axis in enumerate("xy")
    }
    if draw(st.booleans()):
        columns[draw(st.sampled_from(["Red", "green", "Color"]))] = [255.0] * len(points)
    names = draw(st.permutations(list(columns)))
    if draw(st.booleans()):
        who = draw(st.sampled_from(IDS))
        columns[who] = list(range(draw(st.integers(0, 5)), 99))[: len(points)]  # in the order of the rows
        names = [who, *names]  # the only place of a column without a name
    mark = draw(st.sampled_from([",", ";", "\t"]))
    comma = mark != "," and draw(st.booleans())
    end = mark * draw(st.integers(0, 2)) + draw(st.sampled_from(["\n", "\r\n"]))
    rows = [[repr(columns[name][k]) for name in names] for k in range(len(points))]
    rows = [[cell.replace(".", ",") for cell in row] for row in rows] if comma else rows
    return "".join(mark.join(row) + end for row in [list(names), *rows])


@given(st.data(), TEAMS)
def test_tables_are_read_back(data: st.DataObject, points: list[tuple[float, float]]) -> None:
    assert read(data.draw(tables(points)), "a.csv") == tuple(points)


@given(st.data(), TEAMS)
def test_other_files_are_read_back(data: st.DataObject, points: list[tuple[float, float]]) -> None:
    rows: list[Any] = [[x, y] if data.draw(st.booleans()) else {"y": y, "x": x} for x, y in points]
    forms = [rows, {"points": rows}, {"name": "a team", "points": rows}, {f"D{k}": row for k, row in enumerate(rows)}]
    assert read(json.dumps(data.draw(st.sampled_from(forms))), "a.json") == tuple(points)
    dx, dy, size = data.draw(st.tuples(st.integers(-9, 9), st.integers(-9, 9), st.sampled_from([0.25, 1, 2])))
    places = [((x - dx) / size, (-y - dy) / size) for x, y in points]
    drawn = "".join(f'<circle cx="{x!r}" cy="{y!r}" r="2"/>' for x, y in places)
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg"><g transform="translate({dx} {dy}) scale({size})">{drawn}</g></svg>'
    )
    assert read(text, "a.svg") == tuple(points)


@given(st.data(), TEAMS, st.sampled_from(["t", "yaw", "lat", "vx", "x_cm", "time_ms", "radius", "h", "x2"]))
def test_a_column_that_is_not_known_is_refused(
    data: st.DataObject, points: list[tuple[float, float]], strange: str
) -> None:
    lines = data.draw(tables(points)).splitlines()
    mark = next(mark for mark in ";\t," if mark in lines[0])
    more = [f"{strange if number == 0 else '7'}{mark}{line}" for number, line in enumerate(lines)]
    with pytest.raises(InputError, match=f"not '{strange}'|not ''"):
        read("\n".join(more), "a.csv")
