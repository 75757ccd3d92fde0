"""Target points from CSV and JSON files, and what is said about a bad one."""

from pathlib import Path

import pytest

from llm_flock.errors import InputError
from llm_flock.shapes import load_points


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
    ],
)
def test_forms_of_the_same_points(tmp_path: Path, name: str, text: str) -> None:
    assert load_points(written(tmp_path, name, text)) == ((1.0, 2.0), (3.5, -40.0))


def test_three_dimensions(tmp_path: Path) -> None:
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
        ("a.csv", "1;2\n3;4\n", "not ['3;4'] (line 2)", "2 or 3 finite numbers"),
        ("a.csv", "1;2\n", "a.csv", "at least one point"),
        ("a.csv", "", "a.csv", "at least one point"),
        ("a.csv", "x,y\n", "a.csv", "at least one point"),
        ("a.json", "[]", "a.json", "at least one point"),
        ("a.json", "[[1, 2], [3]]", "row 2", "2 or 3 finite numbers"),
        ("a.json", "[[1, 2], 3]", "row 2", "2 or 3 finite numbers"),
        ("a.json", '[[1, "2"]]', "row 1", "2 or 3 finite numbers"),
        ("a.json", "[[1, true]]", "row 1", "2 or 3 finite numbers"),
        ("a.json", "[[1, NaN]]", "row 1", "2 or 3 finite numbers"),
        ("a.json", "[[1, 1" + "0" * 400 + "]]", "row 1", "2 or 3 finite numbers"),
        ("a.json", '{"points": [[1, 2]]}', "a.json", "a JSON list of [x, y] lists"),
        ("a.json", "[[1, 2]", "a.json", "a JSON list of [x, y] lists"),
    ],
)
def test_error_of_a_bad_file_names_the_place(tmp_path: Path, name: str, text: str, where: str, allowed: str) -> None:
    with pytest.raises(InputError) as caught:
        load_points(written(tmp_path, name, text))
    assert (caught.value.field, caught.value.value) == ("points", str(tmp_path / name))
    assert where in str(caught.value)
    assert allowed in caught.value.says


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path, written(tmp_path, "latin.csv", "é,1", "latin-1")):
        with pytest.raises(InputError, match="a readable file"):
            load_points(path)


def test_the_field_can_be_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="start_positions = "):
        load_points(tmp_path / "none.csv", field="start_positions")
