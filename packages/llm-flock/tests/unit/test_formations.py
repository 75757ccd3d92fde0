"""Named shapes: exact spacing and centre, legal team sizes, words, and the paper's examples."""

import math

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from llm_flock import shapes as formations
from llm_flock.errors import InputError

CENTER, SPACING = (50.0, 50.0), 10.0

LEGAL = {
    "line": range(2, 60),
    "triangle": range(3, 60, 3),
    "square": range(4, 60, 4),
    "circle": range(2, 60),
    "polygon:3": range(3, 60, 3),
    "polygon:5": range(5, 60, 5),
    "polygon:7": range(7, 60, 7),
    "cross": range(5, 60, 4),
    "wedge": range(3, 60),
    "grid": range(2, 60),
    "star": range(10, 60, 10),
}
NAMED = [
    info.name.replace(":K", sides)
    for info in formations.shapes()
    if info.name.partition(":")[0] not in ("points", "text")
    for sides in ((":3", ":5", ":7", ":100") if ":K" in info.name else ("",))
]
"""Every listed shape that has places of its own: one that is added to the list is tested."""


def takes(spec: str, n: int) -> bool:
    try:
        return formations.ideal_points(spec, n, CENTER, SPACING) is not None
    except InputError:
        return False


def ideal(spec: str, n: int) -> np.ndarray:
    points = formations.ideal_points(spec, n, CENTER, SPACING)
    assert points is not None
    return points


@pytest.mark.parametrize(("spec", "sizes"), LEGAL.items())
def test_legal_sizes(spec: str, sizes: range) -> None:
    assert [n for n in range(2, 60) if takes(spec, n)] == list(sizes)


@pytest.mark.parametrize("spec", NAMED)
def test_nearest_neighbours_are_one_spacing_apart_round_centre(spec: str) -> None:
    largest = next(n for n in range(1001, 1, -1) if takes(spec, n))
    for n in (*(n for n in range(2, 60) if takes(spec, n)), largest):
        points = ideal(spec, n)
        assert points.shape == (n, 2)
        assert points.dtype == np.float64
        np.testing.assert_allclose(points.mean(axis=0), CENTER, rtol=0, atol=1e-9)
        apart = cdist(points, points)
        np.fill_diagonal(apart, math.inf)
        # For every robot, not only for the closest pair.
        np.testing.assert_allclose(apart.min(axis=1), SPACING, rtol=0, atol=1e-9, err_msg=f"{n} robots")


@pytest.mark.parametrize("spec", ["line", "circle", "grid"])
def test_one_robot_stands_at_the_centre(spec: str) -> None:
    np.testing.assert_array_equal(ideal(spec, 1), [CENTER])


def on_outline(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance of each point from the closed outline through the corners."""
    best = np.full(len(points), math.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        best = np.minimum(best, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return best


@pytest.mark.parametrize(("spec", "sides", "n"), [("triangle", 3, 12), ("square", 4, 8), ("polygon:6", 6, 18)])
def test_outlined_shapes_fill_a_regular_outline(spec: str, sides: int, n: int) -> None:
    points = ideal(spec, n)
    corners = points[:: n // sides]
    np.testing.assert_allclose(np.linalg.norm(corners - CENTER, axis=1), np.linalg.norm(corners[0] - CENTER))
    np.testing.assert_allclose(np.linalg.norm(corners[1] - corners[0]), SPACING * n / sides)
    np.testing.assert_allclose(on_outline(points, corners), 0, atol=1e-9)


def test_the_papers_triangle() -> None:
    """The worked example of the appendix: 55.77, 50, and two corners at 47.11."""
    np.testing.assert_allclose(ideal("triangle", 3), [[55.7735, 50], [47.1132, 55], [47.1132, 45]], atol=1e-4)


def test_the_papers_square_of_eight() -> None:
    expected = {(x, y) for x in (40, 50, 60) for y in (40, 50, 60)} - {(50, 50)}
    assert {tuple(row) for row in ideal("square", 8).round(9).tolist()} == expected


def test_the_papers_cross() -> None:
    expected = {(50, 50), (60, 50), (50, 60), (40, 50), (50, 40)}
    assert {tuple(row) for row in ideal("cross", 5).round(9).tolist()} == expected


def test_circle_radius_comes_from_the_chord() -> None:
    radii = np.linalg.norm(ideal("circle", 10) - CENTER, axis=1)
    np.testing.assert_allclose(radii, 10 / (2 * math.sin(math.pi / 10)))


@pytest.mark.parametrize("n", [3, 10, 11])
def test_wedge_opens_at_a_right_angle(n: int) -> None:
    points = ideal("wedge", n)
    arms = points[1:] - points[0]
    directions = {tuple(row) for row in (arms / np.linalg.norm(arms, axis=1, keepdims=True)).round(9).tolist()}
    half = round(math.sqrt(0.5), 9)
    assert directions == {(half, -half), (-half, -half)}
    right = int((arms[:, 0] > 0).sum())
    assert right - (len(arms) - right) in (0, 1)


@pytest.mark.parametrize(
    ("n", "rows"), [(9, [3, 3, 3]), (10, [4, 4, 2]), (11, [4, 4, 3]), (5, [3, 2]), (17, [5] * 3 + [2])]
)
def test_grid_is_nearly_square(n: int, rows: list[int]) -> None:
    heights = ideal("grid", n)[:, 1].round(6)
    assert [int((heights == y).sum()) for y in sorted(set(heights.tolist()), reverse=True)] == rows


def test_last_row_of_a_grid_is_centred_by_whole_columns() -> None:
    points = ideal("grid", 10)
    across = np.sort(points[:4, 0])
    np.testing.assert_allclose(np.sort(points[8:, 0]), across[1:3])


def test_star_has_five_tips() -> None:
    points = ideal("star", 20)
    radii = np.linalg.norm(points - CENTER, axis=1)
    assert int((radii > radii.max() - 1e-9).sum()) == 5
    assert formations.rotational_symmetry(points) == 5


@pytest.mark.parametrize(
    ("spec", "n", "allowed"),
    [
        ("triangle", 10, "a triangle takes 3, 6, 9, 12, ... robots"),
        ("triangle", 1, "3, 6, 9, 12"),
        ("square", 6, "4, 8, 12, 16"),
        ("polygon:5", 11, "a polygon:5 takes 5, 10, 15, 20, ... robots"),
        ("polygon:5", 1, "5, 10"),
        ("cross", 1, "5, 9, 13"),
        ("cross", 8, "5, 9, 13"),
        ("wedge", 2, "3, 4, 5, 6"),
        ("star", 5, "10, 20, 30, 40"),
        ("circle", 0, "1, 2, 3, 4"),
        ("text:a heart", 0, "1, 2, 3, 4"),
    ],
)
def test_illegal_team_size(spec: str, n: int, allowed: str) -> None:
    with pytest.raises(InputError) as caught:
        formations.ideal_points(spec, n, CENTER, SPACING)
    assert (caught.value.field, caught.value.value) == ("n_robots", n)
    assert allowed in caught.value.says


@pytest.mark.parametrize(
    ("spec", "allowed"),
    [
        ("blob", "one of line, triangle, square, circle, polygon:K"),
        ("", "one of"),
        ("Circle", "unknown shape; did you mean 'circle'?"),
        ("trinagle", "did you mean 'triangle'?"),
        ("circle:5", "'circle' alone"),
        ("points:x.csv", "'points' alone"),
        ("polygon", "polygon:K with a whole number K >= 3"),
        ("polygon:2", "K >= 3"),
        ("polygon:5.5", "K >= 3"),
        ("polygon:-5", "K >= 3"),
        ("polygon:²", "K >= 3"),
        ("polygon:" + "9" * 5000, "K >= 3"),
        ("text:", "description"),
        ("text:  ", "description"),
        ("text", "description"),
    ],
)
def test_illegal_specification(spec: str, allowed: str) -> None:
    for ask in (formations.describe, lambda s: formations.ideal_points(s, 12, CENTER, SPACING)):
        with pytest.raises(InputError) as caught:
            ask(spec)
        assert (caught.value.field, caught.value.value) == ("shape", spec)
        assert allowed in caught.value.says


def test_named_shapes_live_in_the_plane() -> None:
    with pytest.raises(InputError, match=r"center = .* 2 coordinates for shape 'circle'"):
        formations.ideal_points("circle", 5, (0, 0, 0), SPACING)


def test_free_text_has_no_ideal() -> None:
    assert formations.ideal_points("text:a heart", 5, (0, 0, 0), SPACING) is None


def test_custom_points_are_only_moved_to_the_centre() -> None:
    rows = [(0.0, 0.0, 0.0), (3.0, 0.0, 1.0), (0.0, 6.0, 2.0)]
    points = formations.ideal_points("points", 3, (1, 2, 3), SPACING, rows)
    assert points is not None
    np.testing.assert_allclose(points, np.array(rows) - [1, 2, 1] + [1, 2, 3])


@pytest.mark.parametrize(
    ("n", "custom", "field"),
    [(3, None, "points"), (3, [], "points"), (3, [(0, 0), (1, 1)], "n_robots"), (2, [(0, 0), (1, 1, 1)], "points")],
)
def test_custom_points_must_fit_the_team_and_the_space(n: int, custom: list[tuple[float, ...]], field: str) -> None:
    with pytest.raises(InputError) as caught:
        formations.ideal_points("points", n, CENTER, SPACING, custom)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("circle", "a circle"),
        ("triangle", "an equilateral triangle (robots along its perimeter)"),
        ("polygon:5", "a regular polygon with 5 sides (robots along its perimeter)"),
        ("text: a  heart\nwith an arrow ", "a heart with an arrow"),
    ],
)
def test_words_for_a_shape(spec: str, words: str) -> None:
    assert formations.describe(spec) == words


def test_every_listed_shape_keeps_its_word() -> None:
    listed = formations.shapes()
    assert len({info.name for info in listed}) == len(listed)
    for info in listed:
        spec = info.name.replace("K", "5").replace("DESCRIPTION", "a heart")
        assert formations.shape_name(spec) == spec.partition(":")[0]
        assert formations.describe(spec)
        for n in info.examples:
            rows = [(float(k), 0.0) for k in range(n)] if spec == "points" else None
            points = formations.ideal_points(spec, n, CENTER, SPACING, rows)
            assert (points is None) == spec.startswith("text:")


def test_smallest_distance() -> None:
    rng = np.random.default_rng(3)
    assert formations.smallest_distance([(1.0, 2.0)]) == math.inf
    assert formations.smallest_distance([(0, 0), (3, 4), (100, 0)]) == 5.0
    assert formations.smallest_distance(np.zeros((600, 2))) == 0.0
    many = rng.uniform(0, 100, (700, 3))
    apart = cdist(many, many)
    np.fill_diagonal(apart, math.inf)
    assert formations.smallest_distance(many) == pytest.approx(apart.min(), rel=1e-12)


def test_circumradius_is_the_farthest_point() -> None:
    assert formations.circumradius([(0, 0), (3, 4)], (0, 0)) == 5.0
    assert formations.circumradius([(0, 0, 0), (1, 2, 2)], (0, 0, 0)) == 3.0


def test_rotated_turns_counter_clockwise_about_the_centre() -> None:
    np.testing.assert_allclose(formations.rotated([(2, 1)], (1, 1), math.pi / 2), [[1, 2]], atol=1e-15)


@pytest.mark.parametrize(
    ("spec", "n", "k"),
    [
        ("line", 5, 2),
        ("triangle", 6, 3),
        ("square", 8, 4),
        ("circle", 10, 10),
        ("circle", 2, 2),
        ("circle", 1, 1),
        ("cross", 9, 4),
        ("polygon:5", 15, 5),
        ("wedge", 5, 1),
        ("grid", 9, 4),
        ("grid", 12, 2),
        ("grid", 10, 1),
    ],
)
def test_rotational_symmetry(spec: str, n: int, k: int) -> None:
    assert formations.rotational_symmetry(formations.rotated(ideal(spec, n), (3, 4), 1.0)) == k


def test_bent_circle_has_no_rotational_symmetry() -> None:
    bent = ideal("circle", 10)
    bent[3] += 0.01
    assert formations.rotational_symmetry(bent) == 1
    assert formations.rotational_symmetry(bent, tolerance=0.01) == 10
    assert formations.rotational_symmetry(np.zeros((4, 2))) == 1
    assert formations.rotational_symmetry(np.eye(3)) == 1
