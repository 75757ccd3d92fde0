"""Formation programs: what is read and refused, the canonical form, files, and path data."""

from __future__ import annotations

import cmath
import json
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from llm_flock.bounds import MAX_PROGRAM_BYTES
from llm_flock.errors import InputError
from llm_flock.formation import drawn_points, load_program, parse_program, program_of, program_points, program_schema
from llm_flock.formation._letters import GLYPHS
from llm_flock.formation._paths import strokes_of
from llm_flock.plan import Drawing, Plan

CIRCLE = {"shape": "circle"}
ZIGZAG = [[9 * (k % 2), 7 * k % 10] for k in range(49)]
FAN = '{"shape":"line","repeat":{"times":100,"turn":1.8}}'


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, r"draw: either draw or groups is needed, not both"),
        ({"draw": [CIRCLE], "groups": [{"role": "a", "draw": [CIRCLE]}]}, "either draw or groups"),
        ({"draw": [{}]}, r"draw = \[\]: expected exactly one of shape, text, path, points, union"),
        ({"draw": [{"shape": "circle", "text": "A"}]}, r"draw = \['shape', 'text'\]: expected exactly one"),
        ({"draw": [{"shape": "heart"}]}, r"program\.draw\.0\.shape = 'heart': unknown choice"),
        ({"draw": [{"shape": "circle", "colour": "red"}]}, "colour"),
        ({"draw": [{"shape": "circle", "scale": -1}]}, r"program\.draw\.0\.scale = -1: expected more than 0"),
        ({"draw": [{"shape": "circle", "repeat": {"times": 101}}]}, r"repeat\.times = 101: expected at most 100"),
        ({"draw": [{"shape": "circle", "scale": True}]}, r"program\.draw\.0\.scale = True: expected a number"),
        ({"draw": [{"shape": "circle", "turn": "90"}]}, r"program\.draw\.0\.turn = '90': expected a number"),
        ({"draw": [{"shape": "circle", "repeat": {"times": "2"}}]}, r"times = '2': expected a whole number"),
        ({"draw": [{"shape": "circle", "fill": 1}]}, r"fill = 1: expected true or false"),
        ({"draw": [{"shape": "polygon"}]}, "sides: expected a number from 3 to 100 for a polygon"),
        ({"draw": [{"shape": "circle", "sides": 5}]}, "sides = 5: does not go with shape = 'circle'"),
        ({"draw": [{"text": "HI", "fill": True}]}, "fill = True: does not go with text = 'HI'"),
        ({"draw": [{"shape": "circle", "arc": [90, 0]}]}, r"arc = \[90.0, 0.0\]: expected from less than to"),
        ({"draw": [{"text": "naïve"}]}, "text = 'NAÏVE': expected one or more of A"),
        ({"draw": [{"shape": "line", "turn": 5, "point": "east"}]}, "turn = 5.0: point or turn, not both"),
        ({"draw": [CIRCLE], "size": math.inf}, r"program\.size = inf: expected"),
        ({"groups": [{"role": "a", "draw": [CIRCLE]}], "size": 9}, "size = 9.0: has no effect on groups"),
        ([1, 2], "expected an object with draw or groups"),
        ("{", "program: broken JSON"),
        (" " * (MAX_PROGRAM_BYTES + 1), r"program: expected at most 3,072 bytes of JSON \(here 3,073\)"),
        ({"draw": [{"points": [[k, 0.123456] for k in range(400)]}]}, r"program: expected at most 3,072 bytes in JSON"),
    ],
)
def test_what_is_no_program_is_refused_by_field(given: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        parse_program(given)  # type: ignore[arg-type]


def test_deep_nesting_is_refused() -> None:
    deep: dict[str, object] = {**CIRCLE}
    for _ in range(60):
        deep = {"union": [deep]}
    with pytest.raises(InputError, match="at most 8 unions inside each other"):
        parse_program({"draw": [deep]})
    for levels in (300, 900, 1400):
        with pytest.raises(InputError, match=r"at most 8 unions|broken JSON"):
            parse_program('{"draw":' + "[" * levels + "0" + "]" * levels + "}")


def test_equal_programs_have_equal_texts_and_digests() -> None:
    one = parse_program('{"draw": [{"shape": "circle", "turn": 0.0, "scale": 2.0, "move": [1.0, -0.0]}], "name": ""}')
    two = parse_program({"draw": [{"move": [1, 0], "scale": 2, "shape": "circle"}]})
    assert one.text == two.text == '{"draw":[{"move":[1,0],"scale":2,"shape":"circle"}]}'
    assert one.digest == two.digest
    assert parse_program(one.text) == one
    assert parse_program({"draw": [{"shape": "circle", "scale": 2.1}]}).digest != one.digest


def test_shapes_of_a_mission_stand_for_programs() -> None:
    assert program_of("circle") is None and program_of("text:a heart") is None
    letters = program_of("letters:hi")
    assert letters is not None and letters.text == '{"draw":[{"text":"HI"}]}'
    sphere = program_of("sphere")
    assert sphere is not None and sphere.in_space and program_of(sphere.spec) == sphere
    with pytest.raises(InputError, match="a program in JSON; a configuration or flag reads program:FILE"):
        program_of("program:arrow.toml")


def test_the_schema_fits_into_a_prompt() -> None:
    schema = program_schema()
    text = json.dumps(schema)
    assert len(text) < 4000
    assert "title" not in text and "null" not in text and "draw" in schema["properties"]


def test_programs_are_read_from_toml_and_json(tmp_path: Path) -> None:
    toml, plain = tmp_path / "a.toml", tmp_path / "a.json"
    toml.write_text('name = "arrow"\n[[draw]]\npoints = [[0, 0], [0, 2]]\n', encoding="utf-8")
    plain.write_text('{"draw": [{"points": [[0, 0], [0, 2]]}], "name": "arrow"}', encoding="utf-8")
    assert load_program(str(toml)) == load_program(str(plain))
    toml.write_text("draw = [", encoding="utf-8")
    with pytest.raises(InputError, match=r"shape = .*expected TOML"):
        load_program(str(toml), "shape")
    with pytest.raises(InputError, match=r"expected the name of a file that ends in \.svg"):
        load_program(str(toml), kinds=(".svg",))


def svg(*elements: str) -> str:
    return f'<svg xmlns="http://www.w3.org/2000/svg">{"".join(elements)}</svg>'


def test_an_outline_keeps_its_transforms(tmp_path: Path) -> None:
    file = tmp_path / "two words.svg"
    file.write_text(
        svg('<g transform="translate(10 0)"><rect width="4" height="2"/></g>', '<line x1="10" y1="4" x2="14" y2="4"/>'),
        encoding="utf-8",
    )
    program = load_program(str(file))
    assert program.name == "two-words" and program.draw is not None
    assert program.draw[0].path == "M0 0L1000 0L1000 500L0 500ZM0 1000L1000 1000"


def test_a_long_outline_is_simplified_until_it_fits(tmp_path: Path) -> None:
    corners = " ".join(f"{math.cos(k / 500) * 99:.6f},{math.sin(k / 500) * 99:.6f}" for k in range(3142))
    file = tmp_path / "circle.svg"
    file.write_text(svg(f'<polygon points="{corners}"/>'), encoding="utf-8")
    program = load_program(str(file))
    assert len(program.text) <= MAX_PROGRAM_BYTES and program.draw is not None
    rim = [abs(z - (500 + 500j)) for z in strokes_of(program.draw[0].path or "")[0]]
    assert len(rim) > 20 and min(rim) > 495 and max(rim) < 505


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (svg(), "an SVG with at least one line"),
        (svg('<image width="3"/>'), "not image"),
        (svg('<path d="M0 0L1"/>'), "path = 'M0 0L1': expected SVG path data"),
        ("<svg", "expected an SVG"),
    ],
)
def test_other_drawings_are_refused(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "x.svg"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=says):
        load_program(str(file))


@pytest.mark.parametrize(
    ("data", "corners"),
    [
        ("M1 2L3 4", [[1 + 2j, 3 + 4j]]),
        ("m1,2 2,2-1-1", [[1 + 2j, 3 + 4j, 2 + 3j]]),
        ("M0 0H4V3h-4z", [[0, 4, 4 + 3j, 3j, 0]]),
        ("M0 0 1 0 1 1Zm2 0h1", [[0, 1, 1 + 1j, 0], [2, 3]]),
        ("M0 0L1 0ZL0 1", [[0, 1, 0], [0, 1j]]),
        ("M.5.5L1e1-2E0", [[0.5 + 0.5j, 10 - 2j]]),
        ("M5 5Z", [[5 + 5j]]),
        ("", []),
    ],
)
def test_straight_path_data_is_read(data: str, corners: list[list[complex]]) -> None:
    assert strokes_of(data) == corners


@pytest.mark.parametrize(
    "data", ["M1 0A1 1 0 0 1 0 1", "M1 0a1 1 0 01-1 1", "M1 0A1 1 0 0,1,0,1", "M1 0A1 1 33 0 1 0 1"]
)
def test_arcs_are_round(data: str) -> None:
    (stroke,) = strokes_of(data)
    assert stroke[-1] == 1j
    assert all(math.isclose(abs(z), 1.0) for z in stroke)
    assert all(math.isclose(cmath.phase(z), math.pi / 2 * k / 12, abs_tol=1e-9) for k, z in enumerate(stroke))


def test_arcs_choose_side_and_size() -> None:
    long_way = strokes_of("M1 0A1 1 0 1 1 0 1")[0]
    assert max(z.real for z in long_way) > 1.9 and math.isclose(abs(long_way[5] - (1 + 1j)), 1.0)
    grown = strokes_of("M0 0A1 1 0 0 1 4 0")[0]  # too small: the radius grows to 2
    assert math.isclose(min(z.imag for z in grown), -2.0)


def test_curves_pass_through_their_middle() -> None:
    cubic, smooth = strokes_of("M0 0C0 4 4 4 4 0")[0], strokes_of("M0 0C0 4 4 4 4 0S8-4 8 0")[0]
    assert cubic[6] == 2 + 3j and smooth[18] == 6 - 3j
    quadratic, mirrored = strokes_of("M0 0Q2 4 4 0")[0], strokes_of("M0 0Q2 4 4 0T8 0")[0]
    assert abs(quadratic[6] - (2 + 2j)) < 1e-9 and abs(mirrored[18] - (6 - 2j)) < 1e-9


@pytest.mark.parametrize(
    ("data", "place"),
    [("L1 1Lx", "'L1 1L'"), ("M0 0Q1 1", "'M0 0Q1 1'"), ("0 0", "its beginning"), ("M0 0Z3 4", "'M0 0Z'"),
     ("M0 0A1 1 0 2 0 1 1", "A1 1 0 "), ("M1e99 0", "M"), ("M", "'M'")],
)  # fmt: skip
def test_broken_path_data_names_the_place(data: str, place: str) -> None:
    with pytest.raises(InputError, match="SVG path data") as caught:
        strokes_of(data)
    assert place in str(caught.value)


@pytest.mark.parametrize("letter", GLYPHS)
def test_glyphs_stay_in_their_boxes(letter: str) -> None:
    width, path = GLYPHS[letter]
    for z in (z for stroke in strokes_of(path) for z in stroke):
        assert -0.5 <= z.real <= width + 0.5
        assert -0.5 <= z.imag <= 11.5


@pytest.mark.parametrize(
    ("element", "says"),
    [
        ('{"points":[[0,0],[1,1],[1,1.000001]],"fill":true}', "too thin"),
        ('{"shape":"helix","turns":55,"repeat":{"times":10,"move":[3,0,0]}}', "2,000 corners"),
        ('{"shape":"helix","turns":1e6}', "at most 55"),
        (f"{FAN},{FAN[:-1]}" + ',"move":[0.1,0.1]}', "at most 16,000 times"),
        (f'{{"points":{ZIGZAG},"repeat":{{"times":40,"turn":9}}}}', "too many of its lines cross"),
        ('{"path":""}', "draws nothing"),
        ('{"path":"M0 0A1e-320 1e8 30 0 0 5 5"}', "cannot be drawn"),
        ('{"shape":"sphere","repeat":{"times":100,"scale":1e6}}', "coordinates up to"),
    ],
)
def test_what_would_take_all_memory_or_is_no_number_is_refused(element: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        program_points(parse_program(f'{{"draw":[{element}]}}'), 30, 3, 1.0)


def test_hundreds_of_lines_through_one_point_are_cut_once_each() -> None:
    points = program_points(parse_program(f'{{"draw":[{",".join([FAN] * 5)}]}}'), 201, 2, 1.0)
    assert np.linalg.norm(points, axis=1).round(6).min() == 0.0, "one robot stands where they meet"


@pytest.mark.parametrize(
    "element", ['{"points":[[0,0,0],[0,0,1]]}', '{"shape":"line","tilt":30}', '{"shape":"sphere"}']
)
def test_a_plane_has_no_drawings_in_space(element: str) -> None:
    for place in (partial(program_points, parse_program(f'{{"draw":[{element}]}}')), None):
        with pytest.raises(InputError, match="needs robots in space"):
            drawn_points(f'{{"draw":[{element}]}}', 12, 2) if place is None else place(12, 2, 1.0)


@pytest.mark.parametrize(
    "element", ['{"shape":"line","scale":4e-7}', '{"shape":"line","repeat":{"times":2,"scale":1e-9}}']
)
def test_numbers_that_would_round_to_nothing_are_refused(element: str) -> None:
    with pytest.raises(InputError, match="at least 1e-06"):
        parse_program(f'{{"draw":[{element}]}}')


def test_places_stay_apart_in_the_decimals_of_a_plan() -> None:
    with pytest.raises(InputError, match="at least 1e-05"):
        _ = Plan(drawing=Drawing('{"draw":[{"shape":"line"}]}', 9, 5e-324, (0.0, 0.0))).points
