"""The nearest move that keeps all sides, and the one that remains where sides are violated."""

import math

import pytest

from llm_flock.protocol._motion.projection import HalfSpace, nearest_move, relaxed_move


def axis(dim: int, k: int, sign: float = 1.0) -> tuple[float, ...]:
    return tuple(sign if i == k else 0.0 for i in range(dim))


@pytest.mark.parametrize("dim", [2, 3])
def test_sides_farther_away_than_the_longest_move_cannot_be_met(dim: int) -> None:
    both = [HalfSpace(axis(dim, 0), -5.0), HalfSpace(axis(dim, 1), -5.0)]
    wish = (0.0,) * dim
    assert nearest_move(wish, both, 6.0) is None
    assert nearest_move(wish, both, 7.1) == pytest.approx((-5.0, -5.0, *wish[2:]))
    assert nearest_move(wish, [HalfSpace(axis(dim, 0), -9.0)], 6.0) is None


@pytest.mark.parametrize("dim", [2, 3])
def test_as_much_of_the_way_back_as_there_is(dim: int) -> None:
    wish = (0.0,) * dim
    both = [HalfSpace(axis(dim, 0), -5.0, violated=True), HalfSpace(axis(dim, 1), -5.0, violated=True)]
    move = relaxed_move(wish, both, 6.0)
    assert move[:2] == pytest.approx((-6 / 2**0.5, -6 / 2**0.5), rel=1e-5)
    assert relaxed_move(wish, both, 8.0)[:2] == pytest.approx((-5.0, -5.0))


@pytest.mark.parametrize("dim", [2, 3])
def test_a_side_that_is_not_violated_is_never_eased(dim: int) -> None:
    wish = (0.0, 3.0, *(0.0 for _ in range(dim - 2)))
    squeezed = [HalfSpace(axis(dim, 0), -2.0, violated=True), HalfSpace(axis(dim, 0, -1.0), 1.0)]
    assert relaxed_move(wish, squeezed, 6.0) == pytest.approx((-1.0, *wish[1:]), abs=1e-5)
    doubtful = [HalfSpace(axis(dim, 0), -2.0), HalfSpace(axis(dim, 0, -1.0), 1.0)]
    assert relaxed_move(wish, doubtful, 6.0) == (0.0,) * dim
    hopeless = [HalfSpace(axis(dim, 0), -2.0), HalfSpace(axis(dim, 0, -1.0), -1.0, violated=True)]
    assert relaxed_move(wish, hopeless, 6.0) == (0.0,) * dim


@pytest.mark.parametrize("more", [(), (0.0,)])
def test_too_long_wish_within_all_sides_ends_on_side_and_ball(more: tuple[float, ...]) -> None:
    """Clipped to three units it would leave the cell."""
    side = HalfSpace((-1.0, 0.0, *more), -2.0)
    assert nearest_move((3.0, 12.0, *more), [side], 3.0) == pytest.approx((2.0, math.sqrt(5.0), *more))
