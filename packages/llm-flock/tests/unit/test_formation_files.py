"""Target points from CSV and JSON files, and what is said about a bad one."""

import os
from pathlib import Path

import pytest

from llm_flock.errors import InputError
from llm_flock.point_files import load_points


def written(folder: Path, name: str, text: str, encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_text(text, encoding=encoding)
    return path


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "1,2\n3.5,-4e1\n"),
        ("a.csv", "x,y\n1,2\n\n 3.5 , -4e1 \n"),
        ("a.csv", '"x","y"\r\n"1","2"\r\n"3.5","-40"\r\n'),
        ("a.txt", "\ufeffx,y\n1,2\n3.5,-40"),
        ("a.json", "[[1, 2], [3.5, -40]]"),
        ("a.JSON", "[[1, 2],\n [3.5, -4e1]]"),
        ("a.csv", "y,x\n2,1\n-40,3.5\n"),
        ("a.csv", "drone_id,x,y\n0,1,2\n1,3.5,-40\n"),
        ("a.csv", "id,x,y\n7,3.5,-40\n3,1,2\n"),
        ("a.csv", ",x,y\n0,1,2\n1,3.5,-40\n"),
        ("a.csv", "Name,x_m,y_m,Red,Green,Blue\nDrone 2,1,2,255,0,0\nDrone 1,3.5,-40,0,0,9\n"),
        ("a.csv", "Robot ID,Pos X [m],pos_y (m)\n1,1,2\n2,3.5,-40\n"),
        ("a.csv", "x,y,\n1,2,\n3.5,-40,\n,,\n"),
        ("a.csv", "1,2,,\n3.5,-40\n"),
        ("a.csv", "x;y\n1;2\n3,5;-4e1\n"),
        ("a.csv", "1;2;\n3.5;-40;\n"),
        ("a.tsv", "x\ty\n1\t2\n3,5\t-40\n"),
        ("a.txt", "# x y\n1 2\n3.5   -40\n"),
        ("a.json", '[{"x": 1, "y": 2}, {"y": -40, "x": 3.5}]'),
        ("a.json", '[{"id": 4, "y": -40, "x": 3.5}, {"id": 2, "x": 1, "y": 2, "color": "red"}]'),
        ("a.json", '{"name": "two", "points": [[1, 2], [3.5, -40]]}'),
        ("a.json", '{"1": [3.5, -40], "0": [1, 2]}'),
        ("a.json", '{"B": {"x": 1, "y": 2}, "A": {"x": 3.5, "y": -40}}'),
        ("a.svg", '<svg><circle cx="1" cy="-2" r="3"/><ellipse cx="3.5px" cy="40"/></svg>'),
        ("a.svg", '<svg><polyline points="1,-2 3.5,40 1 -2"/></svg>'),
        ("a.csv@0.5", "2,4\n7,-80\n"),
        ("a.json@1e1", "[[0.1, 0.2], [0.35, -4]]"),
    ],
)
def test_forms_of_the_same_points(tmp_path: Path, name: str, text: str) -> None:
    written(tmp_path, name.partition("@")[0], text)
    assert load_points(tmp_path / name) == ((1.0, 2.0), (3.5, -40.0))


def test_three_dimensions(tmp_path: Path) -> None:
    assert load_points(written(tmp_path, "a.csv", "1,2,3\n1,3,3\n")) == ((1.0, 2.0, 3.0), (1.0, 3.0, 3.0))
    assert load_points(written(tmp_path, "a.csv", "1,2,3\n")) == ((1.0, 2.0, 3.0),)
    assert load_points(written(tmp_path, "a.csv", "x,y,z\n1,2,3\n")) == ((1.0, 2.0, 3.0),)


@pytest.mark.parametrize(
    ("name", "text", "where", "allowed"),
    [
        ("a.csv", "x,y\n1,2\n3,oops\n", "not [3.0, 'oops'] (line 3)", "2 or 3 finite numbers"),
        ("a.csv", "x,y\nx,y\n", "line 2", "2 or 3 finite numbers"),
        ("a.csv", "1,2\n3\n", "line 2", "2 or 3 finite numbers"),
        ("a.csv", "1,2,3,4\n", "line 1", "2 or 3 finite numbers"),
        ("a.csv", "1,nan\n", "line 1", "2 or 3 finite numbers"),
        ("a.csv", "1,2\n1,inf\n", "line 2", "2 or 3 finite numbers"),
        ("a.csv", "1,2\n1,2,3\n", "line 2", "2 numbers, as in the first row"),
        ("a.csv", "1,2\n" + "9" * 200_000, "line 2", "comma-separated values"),
        ("a.csv", "1;2\n3:4\n", "not ['3:4'] (line 2)", "2 or 3 finite numbers"),
        ("a.csv", "lat,lon\n1,2\n", "not 'lat'", "columns x, y"),
        ("a.csv", "x,y,t\n1,2,0\n", "not 't'", "columns x, y"),
        ("a.csv", "x_cm,y_cm\n1,2\n", "not 'x_cm'", "columns x, y"),
        ("a.csv", "id,x\n1,2\n", "not id, x", "columns x and y"),
        ("a.csv", "x,px,y\n1,2,3\n", "not both 'x' and 'px'", "one column for x"),
        ("a.csv", "x,y\n1,2,3\n", "[1.0, 2.0, 3.0] (line 2)", "2 cells"),
        ("a.csv", "id,x,y\n1,2,3\n1,4,5\n", "in line 2 and line 3", "one row for each robot"),
        ("a.csv", "0,1,2\n1,3,4\n", "could be ids", "names of the columns"),
        ("a.csv", "5,1,101\n7,3,102\n", "could be ids", "names of the columns"),
        ("a.json", "[[1, 0, 20], [2, 10, 20]]", "could be ids", "names of the columns"),
        ("a.csv", "3,0,0\n1,5,9\n2,10,0\n", "could be ids", "names of the columns"),
        ("a.csv", "A,1,2\nB,3,4\n", "not ['A', 1.0, 2.0] (line 1)", "a first line that names the columns"),
        ("a.csv", "1,5;2\n1.5;3\n", "not both '1,5' and '1.5'", "decimal commas or decimal points"),
        ("a.csv", "1,5;2\n1,000,000;3\n", "line 2", "2 or 3 finite numbers"),
        ("a.json", '{"x": [0, 1], "y": [2, 3]}', "a.json", "a JSON list of [x, y] lists"),
        ("a.json", '{"A": [1, 2, 3, 4]}', "not 'w'", "columns x, y"),
        ("a.json", '[{"x": 1, "y": 2, "yaw": 3}]', "not 'yaw'", "columns x, y"),
        ("a.json", '{"A": "1, 2"}', "'A'", "2 or 3 finite numbers"),
        ("a.json", "[" * 100_000, "a.json", "a JSON list of [x, y] lists"),
        ("a.svg", "<svg><circle/><polygon points='1,2 3,4'/></svg>", "a.svg", "circles or polygons, not both"),
        ("a.svg", "<svg><g><path d='M0 0h1'/></g></svg>", "not path", "circles, ellipses"),
        ("a.svg", "<svg><circle cx='5mm'/></svg>", "'mm'", "numbers without units"),
        ("a.svg", "<svg><circle cx='1e999'/></svg>", "1e999", "finite numbers"),
        ("a.svg", "<svg><circle cx='1 2' cy='3 4'/></svg>", "[[1.0, 2.0], [3.0, 4.0]]", "one number each as cx and cy"),
        ("a.svg", "<svg><circle cx=''/></svg>", "[[], [0.0]]", "one number each as cx and cy"),
        ("a.json", '{"A": [0, 0], "A": [5, 0]}', "a.json", "each name once"),
        ("a.json", '[{"x": 1, "y": 2, "x": 3}]', "a.json", "each name once"),
        ("a.svg", "<svg><polygon points='1 2 3'/></svg>", "3 numbers", "pairs of numbers"),
        ("a.svg", "<svg><g transform='skewX(3)'><circle/></g></svg>", "not skewX 3", "translate, scale, rotate"),
        ("a.svg", "<svg><g transform='scale(1 2 3)'/></svg>", "scale 1 2 3", "translate, scale, rotate"),
        ("a.svg", "<svg><g style='transform: scale(3)x'/></svg>", "transform:", "translate, scale, rotate"),
        ("a.svg", "<svg><style>.old {display: none}</style><circle/></svg>", "a.svg", "hides nothing"),
        ("a.svg", "<svg><svg/></svg>", "not svg", "one SVG"),
        ("a.svg", "<svg>" + "<g>" * 100_000, "not g", "nested at most 64 times"),
        ("a.svg", "<html/>", "not html", "one SVG"),
        ("a.svg", "<svg>", "no element found", "an SVG"),
        ("a.svg", "<!DOCTYPE svg [<!ENTITY a 'b'>]><svg/>", "a.svg", "without entities"),
        ("a.svg", "<svg/>", "a.svg", "at least one point"),
        ("a.csv", "", "a.csv", "at least one point"),
        ("a.csv", "x,y\n", "a.csv", "at least one point"),
        ("a.json", "[]", "a.json", "at least one point"),
        ("a.json", "[[1, 2], [3]]", "row 2", "2 or 3 finite numbers"),
        ("a.json", "[[1, 2], 3]", "row 2", "2 or 3 finite numbers"),
        ("a.json", '[[1, "2"]]', "row 1", "2 or 3 finite numbers"),
        ("a.json", "[[1, true]]", "row 1", "2 or 3 finite numbers"),
        ("a.json", "[[1, NaN]]", "row 1", "2 or 3 finite numbers"),
        ("a.json", "[[1, 1" + "0" * 400 + "]]", "row 1", "2 or 3 finite numbers"),
        ("a.json", "[[1, 2]", "a.json", "a JSON list of [x, y] lists"),
    ],
)
def test_error_of_a_bad_file_names_the_place(tmp_path: Path, name: str, text: str, where: str, allowed: str) -> None:
    with pytest.raises(InputError) as caught:
        load_points(written(tmp_path, name, text))
    assert (caught.value.field, caught.value.value) == ("points", str(tmp_path / name))
    assert where in str(caught.value)
    assert allowed in caught.value.says


def test_a_drawing_is_read_as_it_is_seen(tmp_path: Path) -> None:
    """The groups' transforms hold, y points down in the file, and what is not drawn is no point."""
    text = """<?xml version="1.0" encoding="UTF-8"?><svg xmlns="http://www.w3.org/2000/svg" xmlns:n="other">
    <n:view/><title>a</title><defs><circle cx="8"/><path d="M0 0"/></defs><rect width="100%" height="100%"/>
    <g transform="translate(10,20) rotate(90)"><circle cx="5" cy="0"/><g transform="scale(2)"><circle cy="3"/></g></g>
    <circle cx="1" cy="1" transform="rotate(180 2 3)"/><circle cx="1" cy="2" transform="matrix(0 1 -1 0 4 5)"/>
    <circle visibility="hidden"/><circle style="opacity: 0"/>
    <circle style="fill: red; display: none"/><g display="none"><circle/></g></svg>"""
    points = load_points(written(tmp_path, "a.svg", text))
    assert [tuple(round(axis, 9) for axis in point) for point in points] == [(10, -25), (4, -20), (3, -5), (2, -6)]


def test_a_scale_is_positive(tmp_path: Path) -> None:
    written(tmp_path, "a.csv", "1,2\n")
    for scale in ("0", "1.2.3", "1e999"):
        with pytest.raises(InputError, match="a positive scale"):
            load_points(tmp_path / f"a.csv@{scale}")
    with pytest.raises(InputError, match="2 or 3 finite numbers"):
        load_points(written(tmp_path, "b.csv", "1e299,2\n").with_name("b.csv@10"))
    with pytest.raises(InputError, match="a readable file"):
        load_points(tmp_path / "icon@2x.svg")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path, written(tmp_path, "latin.csv", "é,1", "latin-1")):
        with pytest.raises(InputError, match="a readable file"):
            load_points(path)


def test_the_field_can_be_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="start_positions = "):
        load_points(tmp_path / "none.csv", field="start_positions")


def test_lines_of_comments_are_no_points(tmp_path: Path) -> None:
    """Tables of numpy begin their first lines like comments, and name their columns there."""
    (tmp_path / "a.csv").write_text("# my points\n# y x\n1 2 # first\n\n# second\n3 4\n", encoding="utf-8")
    assert load_points(tmp_path / "a.csv") == ((2.0, 1.0), (4.0, 3.0))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="a system without pipes")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.csv")
    with pytest.raises(InputError, match="not a pipe, device or folder"):
        load_points(tmp_path / "a.csv")
