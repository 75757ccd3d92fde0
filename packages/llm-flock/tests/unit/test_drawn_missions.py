"""Missions whose shape a program draws: the same as with named shapes, from the words to the record."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import llm_flock
from llm_flock import shapes
from llm_flock.cli import app
from llm_flock.errors import InputError
from llm_flock.formation import parse_program
from llm_flock.llm import frame_plan
from llm_flock.llm._prompt_values import shape_text
from llm_flock.llm._prompting import PromptSet
from llm_flock.llm._simulated.prompt_reader import formation, read_task
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanQuestion
from llm_flock.printable import shape_title
from llm_flock.protocol._verification.plans import PlanClass, check_plan, plan_class
from llm_flock.record import read_record
from llm_flock.runtime import build_config
from llm_flock.testing import check_shape

ARROW = parse_program({"name": "arrow", "draw": [{"points": [[0, 0], [0, 3]]}, {"points": [[-1, 2], [0, 3], [1, 2]]}]})
SCOUTS = parse_program(
    {"groups": [{"role": "main", "draw": [{"shape": "wedge"}]},
                {"role": "scouts", "count": 2, "at": [0, 30], "draw": [{"shape": "line"}]}]}
)  # fmt: skip


def upright(mission: Mission) -> Plan:
    return Plan.of(mission.ideal or ())


@pytest.mark.parametrize("shape", [info.name.replace("TEXT", "HI") for info in shapes.drawn_shapes()])
def test_drawn_shapes_conform(shape: str) -> None:
    if not shape.endswith(":FILE"):
        check_shape(shape, fly=False)


@pytest.mark.parametrize(
    ("shape", "n", "more"),
    [
        ("letters:HI", 14, {"comm_range": 20}),
        (ARROW.spec, 10, {}),
        ("pyramid", 14, {}),
        (SCOUTS.spec, 7, {"comm_range": 25}),
    ],
)
def test_a_team_flies_what_a_program_draws(shape: str, n: int, more: dict[str, Any], tmp_path: Path) -> None:
    flown = llm_flock.run(Mission(shape=shape, n_robots=n, **more), seed=3, out=tmp_path)
    assert flown.formed and (flown.summary.min_separation or 0.0) >= 3.0
    record = read_record(tmp_path)
    assert record.mission.ideal is not None and len(record.mission.ideal) == n
    assert record.mission.mission["shape"] == Mission(shape=shape, n_robots=n, **more).shape


def test_plans_are_checked_against_the_places() -> None:
    mission = Mission(shape="letters:F", n_robots=12)
    plan = upright(mission)
    assert check_plan(mission, plan) is None and plan_class(mission, plan) is PlanClass.EXACT
    mirrored = Plan.of((plan.array * [-1, 1] + [100, 0]).tolist())
    reason = check_plan(mission, mirrored)
    assert reason is not None and "this is not letters:F" in reason
    drawn = Mission(shape=ARROW.spec, n_robots=10)
    bent = drawn.resized(10).change(shape="line").ideal or ()
    assert "this is not program:arrow" in (check_plan(drawn, Plan.of(bent)) or "")


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"shape": "letters:HELLO", "n_robots": 10}, "n_robots = 10: expected at least 17, which show every part"),
        ({"shape": "letters:HELLO", "n_robots": 10, "places": 9}, "places = 9: expected at least 17"),
        (
            {"shape": "letters:HELLO", "n_robots": 30, "comm_range": 19},
            r"arena = .*the radius of 'letters:HELLO' of 30 robots",
        ),
        ({"shape": "letters:HI", "n_robots": 8}, "comm_range = 15.0: expected at least 23.12, so that all robots"),
        ({"shape": "letters:ä", "n_robots": 8}, "text = 'Ä': expected one or more of A"),
        ({"shape": "sphere", "n_robots": 9, "center": (50, 50)}, r"center = \[50.0, 50.0\]: expected 3 coordinates"),
        ({"shape": "sphere:3", "n_robots": 9}, "'sphere' alone: it takes no argument"),
        ({"shape": "outline:x.svg"}, "only configurations and flags read outline:FILE"),
        ({"shape": "program:x.toml"}, "a configuration or flag reads program:FILE, too"),
        ({"shape": 'program:{"draw":[{"shape":"heart"}]}'}, r"shape\.draw\.0\.shape = 'heart': unknown choice"),
        (
            {"shape": 'program:{"draw":[{"shape":"square"}],"size":9}', "n_robots": 8},
            "size = 9.0: expected at least 20",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused(fields: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        build_mission(**fields)


def test_a_shape_in_space_brings_its_own_space() -> None:
    mission = Mission(shape="helix", n_robots=12)
    assert mission.dim == 3 and mission.center == (50.0, 50.0, 50.0)
    tilted = parse_program({"draw": [{"text": "A", "tilt": 90}]})
    assert Mission(shape=tilted.spec, n_robots=12, spacing=5).dim == 3
    assert Mission(shape="letters:A", n_robots=12).dim == 2


def test_equal_programs_are_equal_missions() -> None:
    spelled = 'program:{"draw": [{"shape": "square", "turn": 0.0}]}'
    one, two = Mission(shape=spelled, n_robots=8), Mission(shape='program:{"draw":[{"shape":"square"}]}', n_robots=8)
    assert one == two and one.shape == two.shape


def test_fewer_places_are_placed_anew() -> None:
    mission = Mission(shape="letters:L", n_robots=12)
    fewer = mission.resized(11)
    assert fewer.shape == mission.shape and len(fewer.ideal or ()) == 11
    assert shapes.smallest_distance(fewer.ideal or ()) >= mission.spacing - 1e-9


def test_the_prompt_gives_the_places() -> None:
    mission = Mission(shape=ARROW.spec, n_robots=10)
    text = shape_text(mission)
    assert text.startswith("the program arrow, turned in any direction; relative to its centre its places are [[")
    task = read_task(PromptSet.load("full", json=False).system(mission))
    np.testing.assert_allclose(formation(task), mission.ideal or (), atol=2e-3)


def test_the_prompt_says_how_heights_count() -> None:
    mission = Mission(shape="sphere", n_robots=12, downwash=2.5)
    said = PromptSet.load("full", json=False).system(mission)
    assert "closer together than 3 (with differences of z divided by 2.5)" in said
    task = read_task(said)
    assert (task.safe_distance, task.downwash) == (3.0, 2.5)


def test_a_frame_of_its_own_keeps_the_places() -> None:
    mission = Mission(shape=SCOUTS.spec, n_robots=7, comm_range=25)
    asked = PlanQuestion(mission=mission, robot=0, round=1, position=(20.0, 20.0), neighbors=())
    framed = frame_plan(asked, "own")
    ideal = np.array(framed.framed.mission.ideal)
    np.testing.assert_allclose(ideal * mission.spacing + 50.0, mission.ideal or (), atol=1e-9)


def test_files_are_read_by_configurations_alone(tmp_path: Path) -> None:
    file, drawing = tmp_path / "arrow.json", tmp_path / "bar.svg"
    file.write_text(ARROW.text, encoding="utf-8")
    drawing.write_text('<svg xmlns="http://www.w3.org/2000/svg"><rect width="4" height="4"/></svg>', encoding="utf-8")
    changes = [{"round": 9, "robot": 0, "set": {"shape": f"program:{file}"}}]
    config = build_config({}, shape=f"outline:{drawing}", n_robots=10, changes=changes)
    assert config.mission.shape.startswith('program:{"draw":[{"path":"M0 0L1000')
    assert shape_title(config.mission.shape) == "program:bar"
    assert config.trial.changes[0].set["shape"] == ARROW.spec
    with pytest.raises(InputError, match=r"expected the name of a file that ends in \.toml or \.json"):
        build_config({}, shape=f"program:{drawing}", n_robots=10)
    with pytest.raises(InputError, match="program:FILE, with the name of a file"):
        build_config({}, shape="program:")


def test_shapes_are_listed_and_titled() -> None:
    listed = CliRunner().invoke(app, ["shapes"], env={"COLUMNS": "200"}).output
    assert "letters:TEXT" in listed and "pyramid" in listed and "program:FILE" in listed
    assert shape_title('program:{"draw":[{"shape":"line"}]}') == "program"
    assert shape_title("letters:HI") == "letters:HI"


@pytest.mark.parametrize("words", ["the letter S", "a heart", "a circle, please"])
def test_a_stand_in_refuses_words_that_it_cannot_read(words: str, tmp_path: Path) -> None:
    flown = llm_flock.run(Mission(shape=f"text:{words}", n_robots=4), seed=1, rounds=6, out=tmp_path)
    assert not flown.formed and flown.summary.robots_without_plan == 4
    assert re.search(f"a simulated model cannot read words: it draws no '{words}'", str(flown.summary.reason))
