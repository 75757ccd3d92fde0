"""Places of robots on what programs draw: known layouts, least numbers, shares, sizes and what is refused."""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from llm_flock import shapes
from llm_flock.errors import InputError
from llm_flock.formation import parse_program, program_points
from llm_flock.formation._letters import GLYPHS


def placed(n: int, *elements: dict[str, Any], dim: int = 2, spacing: float = 1.0, **more: Any) -> np.ndarray:
    return program_points(parse_program({"draw": elements, **more}), n, dim, spacing)


def nearest(points: np.ndarray) -> np.ndarray:
    apart = cdist(points, points)
    np.fill_diagonal(apart, math.inf)
    return apart.min(axis=1)


def same_set(one: np.ndarray, other: np.ndarray, tolerance: float = 2e-3) -> bool:
    return one.shape == other.shape and bool((cdist(one, other).min(axis=1) <= tolerance).all())


@pytest.mark.parametrize(
    ("spec", "n", "element"),
    [
        ("square", 8, {"shape": "square"}),
        ("square", 20, {"points": [[0, 0], [3, 0], [3, 3], [0, 3]], "closed": True}),
        ("circle", 10, {"shape": "circle"}),
        ("circle", 7, {"path": "M9 5A4 4 0 1 1 1 5A4 4 0 1 1 9 5Z"}),
        ("triangle", 12, {"shape": "triangle", "turn": -90}),
        ("polygon:5", 15, {"shape": "polygon", "sides": 5, "turn": -90}),
        ("star", 20, {"shape": "star"}),
        ("cross", 13, {"shape": "cross"}),
        ("line", 6, {"shape": "line", "scale": 3}),
        ("wedge", 9, {"shape": "wedge"}),
        ("wedge", 12, {"shape": "wedge"}),
        ("grid", 11, {"shape": "grid"}),
        ("grid", 16, {"shape": "grid", "scale": 2}),
    ],
)
def test_outlines_are_placed_as_the_named_shapes(spec: str, n: int, element: dict[str, Any]) -> None:
    ideal = shapes.ideal_points(spec, n, (0.0, 0.0), 1.0)
    assert ideal is not None
    assert same_set(placed(n, element), ideal, tolerance=0.02 if "circle" in spec else 2e-3)


@pytest.mark.parametrize(
    ("element", "n"),
    [
        ({"text": "HELLO"}, 30),
        ({"text": "A"}, 30),
        ({"text": "8"}, 30),
        ({"shape": "star"}, 17),
        ({"shape": "square"}, 7),
    ],
)
def test_no_pair_is_nearer_than_the_spacing(element: dict[str, Any], n: int) -> None:
    points = placed(n, element, spacing=7.0)
    apart = nearest(points)
    assert len(points) == n and apart.min() == pytest.approx(7.0, abs=1e-9) and apart.max() < 7.0 * 1.7
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-9)


def test_every_end_and_junction_of_a_letter_has_a_robot() -> None:
    points = placed(6, {"text": "H"})
    assert same_set(points - points.min(axis=0), np.array([(x, y) for x in (0, 7.4) for y in (0, 5.2, 10)]) / 4.8, 1e-5)
    with pytest.raises(InputError, match="n_robots = 5: expected at least 6, which show every part"):
        placed(5, {"text": "H"})


@pytest.mark.parametrize("letter", sorted(set(GLYPHS) - set(" .:!-")))
def test_strokes_of_a_letter_meet_where_they_should(letter: str) -> None:
    """A stroke that ran past another by a little would need two robots there, and make the whole huge."""
    assert np.ptp(placed(30, {"text": letter}), axis=0).max() < 30


def test_crossing_strokes_share_a_robot() -> None:
    points = placed(5, {"points": [[0, 0], [2, 2]]}, {"points": [[0, 2], [2, 0]]})
    assert same_set(points, np.array([(0, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)]) / math.sqrt(2), 1e-5)


def test_strokes_that_lie_on_each_other_count_once() -> None:
    twice = placed(7, {"points": [[0, 0], [4, 0]]}, {"points": [[1, 0], [6, 0]]}, {"points": [[0, 0], [4, 0]]})
    assert np.ptp(twice, axis=0).tolist() == pytest.approx([6.0, 0.0], abs=0.7)
    assert nearest(twice).max() < 2.1


def test_corners_have_robots_where_that_pays() -> None:
    corners = np.array([(x, y) for x in (-4, 4) for y in (-4, 4)])
    assert (cdist(corners, placed(31, {"shape": "square"})).min(axis=1) < 1.0).all()
    assert (cdist(corners / 4, placed(8, {"shape": "square"})).min(axis=1) < 1e-5).all()


def test_points_slide_where_strokes_run_side_by_side() -> None:
    # Two circles that touch: evenly placed, the points beside the place where they touch are nearly one.
    points = placed(30, {"shape": "circle"}, {"shape": "circle", "move": [0, 2]})
    assert np.median(nearest(points)) < 1.25


def test_unions_share_robots_by_length() -> None:
    points = placed(30, {"shape": "line"}, {"shape": "line", "scale": 4, "move": [0, 3]})
    assert 6 <= int((points[:, 1] < points[:, 1].max() - 0.1).sum()) <= 7


def test_mirror_turn_scale_and_repeat() -> None:
    half = {"points": [[0, 0], [1, 2], [3, 2]]}
    both = placed(21, half, {**half, "mirror": "x"})
    assert same_set(both * [-1, 1], both, 1e-3)
    ring = placed(24, {"shape": "square", "move": [4, 0], "repeat": {"times": 3, "turn": 120}})
    assert same_set(shapes.rotated(ring, (0, 0), math.tau / 3), ring, 1e-3)
    ellipse = np.ptp(placed(40, {"shape": "circle", "scale": [2, 1]}), axis=0)
    assert ellipse[0] / ellipse[1] == pytest.approx(2.0, abs=0.05)
    growing = placed(12, {"shape": "line", "repeat": {"times": 3, "move": [0, 1], "scale": 2}})
    assert len(np.unique(growing[:, 1].round(3))) == 3


def test_to_point_east_is_a_turn() -> None:
    arrow = {"points": [[-1, 0], [0, 3], [1, 0]]}
    north, east = placed(9, arrow), placed(9, {**arrow, "point": "east"})
    np.testing.assert_allclose(shapes.rotated(north, (0, 0), -math.pi / 2), east, atol=1e-5)
    assert same_set(east, placed(9, {**arrow, "turn": -90}))


@pytest.mark.parametrize("n", [4, 16, 50])
def test_areas_are_filled_evenly(n: int) -> None:
    points = placed(n, {"shape": "square", "fill": True})
    assert nearest(points).max() < 1.5
    side = np.ptp(points, axis=0).mean() / np.median(nearest(points)) + 1
    assert side**2 == pytest.approx(n, rel=0.3)


def test_holes_stay_empty() -> None:
    ring = placed(40, {"path": "M0 0H9V9H0ZM3 3H6V6H3Z", "fill": True})
    width = np.ptp(ring, axis=0).mean()
    assert np.abs(ring).max(axis=1).min() > 0.12 * width
    assert placed(9, {"union": [{"shape": "square"}, {"shape": "square", "move": [1, 0]}], "fill": True}).shape == (
        9,
        2,
    )


@pytest.mark.parametrize(
    ("element", "says"),
    [
        ({"path": "M0 0L4 0L4 4", "fill": True}, r"the outline is open: it begins at \[0, 0\] and ends at \[4, -4\]"),
        ({"points": [[0, 0], [2, 2], [2, 0], [0, 2]], "closed": True}, "a closed outline crosses itself at 1 1"),
        ({"points": [[0, 0], [2, 2], [2, 0], [0, 2]], "fill": True}, "a closed outline crosses itself at 1 1"),
        ({"points": [[0, 0], [1, 1], [2, 2]], "fill": True}, "crosses itself|no area"),
        ({"points": [[0, 0, 1], [1, 1, 0], [2, 0, 3]], "fill": True}, "outlines of the plane only"),
        ({"shape": "circle", "repeat": {"times": 60}}, "at most 2,000 corners in all"),
        ({"shape": "line", "repeat": {"times": 100}}, "n_robots = 12|at least"),
        ({"union": [{"shape": "line", "repeat": {"times": 99}}], "repeat": {"times": 99}}, "at most 500 elements"),
        ({"text": "..."}, "n_robots = 12: expected at most 3, one for each dot"),
        ({"shape": "helix", "turns": 999}, "turns = 999.0: expected at most 55"),
    ],
)
def test_what_cannot_be_drawn_has_a_reason(element: dict[str, Any], says: str) -> None:
    if element.get("shape") == "line":
        assert placed(12, element).shape == (12, 2)  # copies on one another are one line
        return
    with pytest.raises(InputError, match=says):
        placed(12, element, dim=3)


def test_a_size_is_kept_or_refused() -> None:
    assert np.ptp(placed(8, {"shape": "square"}, spacing=10, size=50), axis=0).tolist() == pytest.approx([50, 50])
    with pytest.raises(InputError, match=r"size = 19\.0: expected at least 20, the width that 8 robots need"):
        placed(8, {"shape": "square"}, spacing=10, size=19)


SCOUTS = {"role": "scouts", "count": 2, "at": [0, 20], "draw": [{"shape": "line"}]}


def test_groups_have_their_robots_and_places() -> None:
    program = parse_program({"groups": [{"role": "main", "draw": [{"shape": "wedge"}]}, SCOUTS]})
    points = program_points(program, 9, 2, 5.0)
    main, scouts = points[:7], points[7:]
    assert same_set(main - main.mean(axis=0), shapes.ideal_points("wedge", 7, (0, 0), 5.0))  # type: ignore[arg-type]
    np.testing.assert_allclose(scouts.mean(axis=0) - main.mean(axis=0), [0, 20], atol=1e-6)
    assert nearest(scouts).tolist() == pytest.approx([5.0, 5.0])


@pytest.mark.parametrize(
    ("groups", "n", "says"),
    [
        ([SCOUTS], 3, "n_robots = 3: expected 2, the robots of all groups"),
        ([SCOUTS, {**SCOUTS, "role": "b"}], 4, "places of two groups are 0 apart"),
        ([SCOUTS, {"role": "b", "draw": [{"shape": "line"}]}], 2, "so that each of the 2 groups gets a robot"),
    ],
)
def test_groups_that_cannot_be_placed_are_refused(groups: list[Any], n: int, says: str) -> None:
    with pytest.raises(InputError, match=says):
        program_points(parse_program({"groups": groups}), n, 2, 5.0)


def test_shares_are_kept_by_largest_remainder() -> None:
    groups = [{"role": r, "share": s, "at": [k * 99, 0], "draw": [{"shape": "line"}]} for k, (r, s) in enumerate(
        (("a", 1), ("b", 2), ("c", 4)))]  # fmt: skip
    points = program_points(parse_program({"groups": groups}), 12, 2, 5.0)
    x = points[:, 0] - points[:, 0].min()
    assert [int(((x > k * 99 - 50) & (x < k * 99 + 50)).sum()) for k in range(3)] == [2, 3, 7]


def test_a_sphere_of_twelve_is_nearly_an_icosahedron() -> None:
    points = placed(12, {"shape": "sphere"}, dim=3)
    radius = np.linalg.norm(points, axis=1)
    assert radius.max() / radius.min() < 1.05
    assert radius.mean() == pytest.approx(1 / 1.05146, rel=0.08) and nearest(points).max() < 1.06


@pytest.mark.parametrize(
    ("spec", "n", "layers"), [("cube", 27, [9, 9, 9]), ("pyramid", 14, [9, 4, 1]), ("cube", 8, [4, 4])]
)
def test_cubes_and_pyramids_have_layers(spec: str, n: int, layers: list[int]) -> None:
    points = placed(n, {"shape": spec}, dim=3)
    assert np.unique(points[:, 2].round(4), return_counts=True)[1].tolist() == layers
    np.testing.assert_allclose(nearest(points), 1.0, atol=1e-5)


def test_an_unfinished_cube_keeps_its_corners() -> None:
    points = placed(20, {"shape": "cube"}, dim=3)
    far = np.abs(points - (points.max(axis=0) + points.min(axis=0)) / 2)
    assert int((far > 0.99 * far.max()).all(axis=1).sum()) == 8


@pytest.mark.parametrize("spec", ["dome", "cylinder", "helix"])
def test_surfaces_and_curves_in_space_are_even(spec: str) -> None:
    points = placed(24, {"shape": spec}, dim=3)
    assert points.shape == (24, 3) and nearest(points).max() < 1.5


def test_a_plane_tilted_stands_upright() -> None:
    lying, upright = placed(8, {"shape": "square"}, dim=3), placed(8, {"shape": "square", "tilt": 90}, dim=3)
    np.testing.assert_allclose(upright, lying[:, [0, 2, 1]] * [1, -1, 1], atol=1e-6)
    filled = placed(12, {"shape": "circle", "fill": True, "tilt": 30}, dim=3)
    np.testing.assert_allclose(filled[:, 2], filled[:, 1] * math.tan(math.pi / 6), atol=1e-3)


def test_two_layers_lie_above_each_other() -> None:
    points = placed(20, {"shape": "circle", "repeat": {"times": 2, "move": [0, 0, 0.8]}}, dim=3)
    low, high = points[points[:, 2] < 0], points[points[:, 2] > 0]
    assert len(low) == len(high) == 10 and same_set(low[:, :2], high[:, :2], 1e-4)


@pytest.mark.parametrize(
    ("n", "dim", "element", "digest"),
    [
        (30, 2, {"text": "HELLO"}, "4db02267b533"),
        (30, 2, {"shape": "circle", "fill": True}, "0481481b0367"),
        (30, 3, {"shape": "sphere"}, "fd5677a3a261"),
        (17, 2, {"shape": "star"}, "cfec2d9d1ece"),
    ],
)
def test_places_do_not_depend_on_the_machine(n: int, dim: int, element: dict[str, Any], digest: str) -> None:
    points = placed(n, element, dim=dim).round(4) + 0.0
    assert hashlib.blake2b(points.astype("<f8").tobytes(), digest_size=6).hexdigest() == digest
