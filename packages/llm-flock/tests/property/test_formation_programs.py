"""Any formation program is placed by one rule, or refused with a reason."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from llm_flock.errors import InputError
from llm_flock.formation import parse_program, program_points
from llm_flock.formation._placement import _places, largest_remainder
from llm_flock.shapes import rotated

numbers = st.integers(-40, 40).map(lambda k: k / 4)
vectors = st.lists(numbers, min_size=2, max_size=2)
modifiers: dict[str, st.SearchStrategy[Any]] = {
    "scale": st.sampled_from([0.5, 2, [1, 3]]),
    "mirror": st.sampled_from("xy"),
    "turn": st.sampled_from([30, 90, 200]),
    "move": vectors,
    "repeat": st.fixed_dictionaries({"times": st.integers(2, 3)}, optional={"move": vectors, "turn": numbers}),
}
lines: list[dict[str, st.SearchStrategy[Any]]] = [
    {"shape": st.sampled_from(["line", "circle", "triangle", "square", "star", "cross", "wedge", "grid"])},
    {"text": st.text("AEOX18", min_size=1, max_size=3)},
    {"points": st.lists(vectors, min_size=2, max_size=5)},
    {"path": st.sampled_from(["M0 0L3 1L1 4Z", "M0 0A2 1 20 1 0 3 1", "M0 0C1 3 4-2 5 1M2 2h1"])},
]
strokes = st.one_of([st.fixed_dictionaries(kind, optional=modifiers) for kind in lines])
spatial = st.fixed_dictionaries(
    {"shape": st.sampled_from(["sphere", "dome", "cylinder", "helix", "cube", "pyramid"])},
    optional={"move": st.lists(numbers, min_size=3, max_size=3), "tilt": numbers, **modifiers},
)
areas = st.fixed_dictionaries(
    {"shape": st.sampled_from(["circle", "triangle", "square", "star"]), "fill": st.just(True)}, optional=modifiers
)
drawings = st.lists(st.one_of(strokes, areas, spatial), min_size=1, max_size=3)

relaxed = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def placed(drawing: list[Any], n: int, dim: int = 3) -> np.ndarray | None:
    """The places, or None where they are refused for a reason in words."""
    try:
        return program_points(parse_program({"draw": drawing}), n, dim, 2.0)
    except InputError as error:
        refused = error
    assert refused.says and refused.field in ("n_robots", "draw", "fill", "program")
    return None


odd = st.one_of(
    st.floats(), st.sampled_from([1e-300, 5e-324, 4.9e-7, 5e-7, 1.0000004, 1 - 4e-7, -0.0, 1e6, 0.1 + 0.2, 359.9999999])
)
factors = st.one_of(odd, st.lists(odd, min_size=2, max_size=3))
tuples = st.lists(odd, min_size=2, max_size=3)
odd_modifiers: dict[str, st.SearchStrategy[Any]] = {
    "scale": factors,
    "turn": odd,
    "tilt": odd,
    "move": tuples,
    "repeat": st.fixed_dictionaries({"times": st.integers(2, 3)}, optional={"move": tuples, "scale": odd, "turn": odd}),
}
odd_kinds: list[dict[str, st.SearchStrategy[Any]]] = [
    {"shape": st.just("circle"), "arc": st.tuples(odd, odd).map(sorted)},
    {"shape": st.just("helix"), "turns": odd},
    {"text": st.text("aß\u00b5 1", min_size=1, max_size=3)},
    {"path": st.text(min_size=1, max_size=9)},
    {"points": st.lists(tuples, min_size=1, max_size=3)},
]
odd_elements = st.lists(
    st.one_of([st.fixed_dictionaries(kind, optional=odd_modifiers) for kind in odd_kinds]), max_size=2
)
odd_groups = st.lists(
    st.fixed_dictionaries({"role": st.text(max_size=3), "draw": odd_elements}, optional={"share": odd, "at": tuples}),
    min_size=1,
    max_size=2,
)
odd_programs = st.one_of(
    st.fixed_dictionaries({"draw": odd_elements}, optional={"size": odd, "name": st.text(max_size=3)}),
    st.fixed_dictionaries({"groups": odd_groups}),
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much])
@given(program=odd_programs)
def test_a_program_can_be_read_back_from_its_text(program: dict[str, Any]) -> None:
    try:
        read = parse_program(program)
    except InputError:
        return
    again = parse_program(read.text)
    assert (again, again.text, again.digest) == (read, read.text, read.digest)


@relaxed
@given(drawing=drawings, n=st.integers(1, 60))
def test_places_are_spaced_and_the_same_on_every_call(drawing: list[Any], n: int) -> None:
    points = placed(drawing, n)
    if points is None:
        return
    assert points.shape == (n, 3) and np.isfinite(points).all()
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-6)
    if n > 1:
        assert cdist(points, points)[np.triu_indices(n, 1)].min() >= 2.0 - 1e-9
    _places.cache_clear()
    again = program_points(parse_program(json.dumps({"draw": drawing})), n, 3, 2.0)
    assert again.tobytes() == points.tobytes()


@settings(relaxed, max_examples=20)
@given(drawing=st.lists(strokes, min_size=1, max_size=3), n=st.integers(2, 60), angle=st.sampled_from([30, 90, 145]))
def test_a_turned_drawing_has_turned_places(drawing: list[Any], n: int, angle: int) -> None:
    plain = placed(drawing, n, dim=2)
    whole = placed([{"union": drawing, "turn": angle}], n, dim=2)
    assert (plain is None) == (whole is None)
    if plain is None or whole is None:
        return
    back = rotated(whole, (0.0, 0.0), -math.radians(angle))
    size = float(np.linalg.norm(plain, axis=1).max())
    assert cdist(back, plain).min(axis=1).max() < 1e-3 * size


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.sampled_from(["circle", "A", "M0 0L1 1", ""]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                ["draw", "shape", "path", "points", "union", "fill", "text", "scale", "move", "groups", "size"]
            ),
            inner,
            max_size=3,
        )
    ),
    max_leaves=12,
)


@settings(max_examples=100, deadline=None)
@given(value=json_values)
def test_anything_is_a_program_or_refused(value: Any) -> None:
    with suppress(InputError):
        points = program_points(parse_program(value), 12, 3, 1.0)
        assert len(points) == 12 and np.isfinite(points).all()


@given(st.lists(st.floats(0.01, 100), min_size=1, max_size=8), st.integers(0, 300))
def test_largest_remainder_is_off_by_less_than_one(shares: list[float], n: int) -> None:
    parts = largest_remainder(shares, n)
    assert sum(parts) == n
    assert all(abs(part - n * share / sum(shares)) < 1 + 1e-6 for part, share in zip(parts, shares, strict=True))
