"""Heartbeats: living, silent and unknown robots, and bodies that only stand there."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from llm_flock.protocol._membership.liveness import CANNOT_FLY, NO_PLAN, Liveness, patience

NOBODY = frozenset[int]()


def counts(beats: Sequence[int]) -> NDArray[np.int64]:
    """Heartbeats as they are read from a message."""
    return np.array(beats, dtype=np.int64)


def test_stalled_counter_is_silent_and_alive_when_moving_again() -> None:
    mine = Liveness(0, 3, time_out=2)
    assert mine.strangers == {1, 2} and mine.alive == 1
    mine.begin_round(1, NOBODY)
    mine.hear([counts((1, 2, 0))])
    assert mine.strangers == {2} and mine.alive == 2
    for number in (2, 3):
        mine.begin_round(number, NOBODY)
        mine.hear([counts((0, 2, 0))])
        assert not mine.silent
    mine.begin_round(4, NOBODY)
    assert mine.silent == {1} and mine.alive == 1
    mine.hear([counts((0, 3, 0))])
    assert not mine.silent and mine.alive == 2


def test_heartbeats_are_passed_on() -> None:
    far, between, near = (Liveness(k, 3, time_out=5) for k in range(3))
    for robot in (far, between, near):
        robot.begin_round(1, NOBODY)
    between.hear([counts(far.beats)])
    near.hear([counts(between.beats)])
    assert near.beats == (4, 4, 4) and not near.strangers


def test_a_restarted_robot_continues_its_former_counter() -> None:
    reborn, other = Liveness(0, 2, time_out=2), Liveness(1, 2, time_out=2)
    reborn.begin_round(1, NOBODY)
    reborn.hear([counts((40, 7))])
    assert reborn.beats[0] == 44
    other.hear([counts((40, 7))])
    other.begin_round(9, NOBODY)
    assert other.silent == {0}
    other.hear([counts(reborn.beats)])
    assert not other.silent


def test_unheard_body_is_silent_and_others_learn_it() -> None:
    mine = Liveness(0, 3, time_out=2)
    for number in range(1, 4):
        assert not mine.silent and 2 in mine.strangers
        mine.begin_round(number, frozenset({2}))
    assert mine.silent == {2} and mine.strangers == {1}
    other = Liveness(1, 3, time_out=2)
    other.hear([counts(mine.beats)])
    assert other.silent == {2}
    mine.hear([counts((0, 0, 1))])
    assert mine.silent == {2}
    mine.hear([counts((0, 0, 2))])
    assert not mine.silent


def test_a_large_team_is_waited_for_longer() -> None:
    assert patience(10, 20) == 10 and patience(10, 100) == 58 and patience(40, 100) == 88
    live = Liveness(0, 100, 10)
    live.begin_round(1, frozenset())
    live.hear([counts([0, 2] + [0] * 98)])
    for number in range(2, 60):
        live.begin_round(number, frozenset())
        assert not live.silent
    live.begin_round(60, frozenset())
    assert live.silent == {1}


def test_newest_heartbeat_tells_the_state_of_its_robot() -> None:
    teller, hearer = Liveness(0, 3, time_out=2), Liveness(1, 3, time_out=2)
    for number, state in enumerate((NO_PLAN | CANNOT_FLY, NO_PLAN, CANNOT_FLY, 0), start=1):
        teller.begin_round(number, NOBODY, state)
        hearer.begin_round(number, NOBODY, NO_PLAN | CANNOT_FLY)
        hearer.hear([counts(teller.beats), counts((4, 0, 0))])
        assert hearer.without_plan == ({0} if state & NO_PLAN else NOBODY), "its own state is not told"


def test_a_restarted_robot_keeps_the_state_of_now() -> None:
    reborn = Liveness(0, 2, time_out=2)
    reborn.begin_round(1, NOBODY, CANNOT_FLY)
    reborn.hear([counts((4 * 9 + NO_PLAN, 0))])
    assert reborn.beats[0] == 4 * 10 + CANNOT_FLY


def test_silence_takes_longer_where_heartbeats_come_rarely() -> None:
    """Heard every sixth round, it is not silent after four; when it falls silent for good, it is noticed in the end."""
    mine = Liveness(0, 2, time_out=4)
    mine.begin_round(1, NOBODY)
    mine.hear([counts((0, 4))])
    suspected: list[int] = []
    for number in range(2, 80):
        mine.begin_round(number, NOBODY)
        if number % 6 == 1:
            mine.hear([counts((0, 4 * number))])
        if mine.silent:
            suspected.append(number)
    assert suspected and max(suspected) < 20, "only until it has learned how rarely they come"
    for number in range(80, 80 + 5 * 4 + 6):
        mine.begin_round(number, NOBODY)
    assert mine.silent == {1}
