"""The conformance tests of shapes, prompt sets and models find what is wrong, and pass what is shipped."""

from __future__ import annotations

from pathlib import Path

import pytest

from llm_flock import shapes as formations
from llm_flock.llm import _prompting as prompting
from llm_flock.testing import check_model, check_prompts, check_shape

PACKAGED = Path(prompting.__file__).parent / "prompts"


@pytest.mark.parametrize(
    "shape", [info.name.replace(":K", ":5") for info in formations.shapes() if ":D" not in info.name]
)
def test_every_named_shape_conforms(shape: str) -> None:
    if shape != "points":
        check_shape(shape, fly=False)


def test_a_shape_is_flown() -> None:
    check_shape("triangle", [3])


def test_check_shape_takes_a_file_of_points(tmp_path: Path) -> None:
    file = tmp_path / "arrow.csv"
    file.write_text("0,0\n10,0\n5,8\n5,16\n")
    check_shape(f"points:{file}", fly=False)
    file.write_text("0,0\n1,0\n")
    with pytest.raises(AssertionError, match=r"arrow\.csv is refused: shape = 'points'"):
        check_shape(f"points:{file}", fly=False)


def test_check_shape_rejects_what_is_no_shape() -> None:
    with pytest.raises(AssertionError, match="no shape"):
        check_shape("heart")
    with pytest.raises(AssertionError, match=r"triangle with 4 robots is refused: .* a triangle takes 3, 6"):
        check_shape("triangle", [4])
    with pytest.raises(AssertionError, match="cannot be measured"):
        check_shape("text:the letter S", [5])


def test_the_packaged_prompts_conform() -> None:
    check_prompts(PACKAGED)


@pytest.mark.parametrize(
    ("name", "text", "missing"),
    [
        ("step.j2", "Go to {{ goal }}.", "own and observed positions"),
        ("step.j2", "From {{ position }}, past {{ neighbors }}.", "the goal"),
        ("plan.j2", "Make a plan.", "own id"),
        ("system.j2", "You are a robot.", "safe_distance"),
        ("retry.j2", "Try again.", "the reason"),
        ("plan.j2", "{{ nonsense }}", "refused"),
    ],
)
def test_prompts_that_leave_something_out(tmp_path: Path, name: str, text: str, missing: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(AssertionError, match=missing):
        check_prompts(tmp_path)


def test_models() -> None:
    check_model("simulated:ideal")
    with pytest.raises(AssertionError, match="refused"):
        check_model("nobody:nothing")
    with pytest.raises(AssertionError, match="could be used"):
        check_model("simulated:malformed")
    with pytest.raises(AssertionError, match="gave no answer"):
        check_model("simulated:flaky", max_tries=1)
