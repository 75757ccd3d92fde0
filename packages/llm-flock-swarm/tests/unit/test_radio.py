"""Ranges, and what is injected on the way."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from llm_flock.errors import MessageError
from llm_flock.links import LinkFaults
from llm_flock.members import OPERATOR
from llm_flock.mission import Mission
from llm_flock.transport._radio import Radio, Seen
from llm_flock_swarm._network.wire import Beacon, BeaconedMessage, Command, WorldState, pack, unpack
from llm_flock_swarm._zenoh import Allowance, PlainSeal, access_control, settings

MISSION = Mission(shape="circle", n_robots=4, comm_range=15.0)
PLACES = [(50.0, 50.0), (60.0, 50.0), (66.0, 50.0), (50.0, 52.0)]


def radio(**faults: float) -> Radio:
    rng = np.random.default_rng(3)
    links = LinkFaults.model_validate(faults)
    own = Radio(0, MISSION, faults=links, rng=rng, beacon_s=0.1, delay_s=0.1, clock_error_s=0.002, speed=10.0)
    own.frame(100.0, PLACES)
    for sender in (1, 2, 3):
        seen = Seen(stamp=100.0, position=PLACES[sender])
        own.place(sender, seen)
        if own.carries(sender):
            own.beacon(sender, seen)
    return own


def test_the_air_carries_within_range_only() -> None:
    own = radio()
    assert [own.carries(sender) for sender in (1, 2, 3)] == [True, False, True]
    own.cut = frozenset({3})
    assert not own.carries(3) and own.neighbors(100.1) == 2


def test_sender_without_a_beacon_is_not_heard() -> None:
    own = Radio(
        0,
        MISSION,
        faults=LinkFaults(),
        rng=np.random.default_rng(0),
        beacon_s=0.1,
        delay_s=0.1,
        clock_error_s=0.0,
        speed=10.0,
    )
    assert not own.carries(1) and own.neighbors(0.0) == 0
    own.frame(0.0, PLACES)
    assert not own.carries(1)


def test_sensors_see_within_their_range_only() -> None:
    own = radio()
    assert own.sensed() == {1: PLACES[1], 3: PLACES[3]}
    own.frame(101.0, [PLACES[0], (90.0, 50.0), PLACES[2], PLACES[3]])
    assert own.sensed() == {3: PLACES[3]}
    assert [s.position for s in own.sightings(101.0)] == [PLACES[3]]


def test_beacons_go_stale() -> None:
    own = radio()
    assert own.neighbors(100.4) == 2 and own.neighbors(100.6) == 0


def test_body_in_sight_is_where_sensors_see_it_despite_beacon() -> None:
    own = radio()
    own.beacon(1, Seen(stamp=100.2, position=(65.0, 50.0)))
    (one, other) = own.sightings(100.3)
    assert {one.position, other.position} == {PLACES[1], PLACES[3]}
    assert one.age_s == other.age_s == pytest.approx(0.302)
    assert own.unseen_s(100.3) == pytest.approx(0.302)
    assert own.contradicted == 1
    own.beacon(3, Seen(stamp=100.2, position=(50.0, 53.0)))
    assert own.contradicted == 1, "as far as it may have flown since"


def test_beacon_helps_out_of_sight_unless_sensors_would_see_it() -> None:
    own = radio()
    own.frame(100.1, [PLACES[0], PLACES[1], (66.0, 50.0), PLACES[3]])
    own.beacon(2, Seen(stamp=100.2, position=(64.5, 50.0)))
    assert (64.5, 50.0) in [s.position for s in own.sightings(100.3)]
    own.beacon(2, Seen(stamp=100.25, position=(51.0, 50.0)))
    assert [s.position for s in own.sightings(100.3)] == [PLACES[1], PLACES[3]]
    assert own.contradicted == 1
    own.beacon(2, Seen(stamp=100.27, position=(64.5, 50.0)))
    own.frame(100.3, [PLACES[0], PLACES[1], (66.0, 50.0), PLACES[3]])
    assert len(own.sightings(100.3)) == 2, "the sensors are newer"
    own.beacon(2, Seen(stamp=100.4, position=(64.5, 50.0)))
    own.forget_beacons()
    assert len(own.sightings(100.4)) == 2


def test_loss_duplicates_and_delays_are_injected() -> None:
    own = radio(loss=0.3, duplicate=0.2, delay=2)
    now: list[int] = []
    later: list[float] = []

    def wait(delay_s: float, _call: Callable[[], None]) -> None:
        later.append(delay_s)

    for k in range(1000):
        own.deliver(1, lambda k=k: now.append(k), wait)
        own.deliver(2, lambda k=k: now.append(k), wait)
    assert len(later) + len(now) == pytest.approx(1000 * 1.2 * 0.7, rel=0.1)
    assert min(later) > 0.0 and 0.15 < max(later) <= 0.2
    radio().deliver(1, lambda: now.append(-1), wait)
    assert now[-1] == -1


def test_received_messages_are_checked() -> None:
    beacon = Beacon(stamp=1.0, position=(1.0, 2.0))
    assert unpack(Beacon, pack(beacon)) == beacon
    assert unpack(BeaconedMessage, pack(BeaconedMessage(beacon=beacon, message=b"abc"))) == BeaconedMessage(
        beacon=beacon, message=b"abc"
    )
    for payload, reason in ((b"", "version"), (b"\x63abc", "version"), (b"\x05abc", "malformed")):
        with pytest.raises(MessageError) as caught:
            unpack(WorldState, payload)
        assert caught.value.reason == reason


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e9])
def test_no_number_that_is_none_comes_over_the_wire(bad: float) -> None:
    near = (1.0, 2.0)
    sent: list[msgspec.Struct] = [
        Beacon(stamp=1.0, position=(1.0, bad)),
        Beacon(stamp=1e4 * bad, position=near),
        BeaconedMessage(beacon=Beacon(stamp=1.0, position=(bad, 2.0)), message=b""),
        Command(number=1, stamp=1.0, origin=near, target=(bad, bad)),
        Command(number=1, stamp=1.0, origin=(bad, bad), target=near),
        Command(number=1, stamp=1e4 * bad, origin=near, target=near),
    ]
    for message in sent:
        with pytest.raises(MessageError, match="malformed"):
            unpack(type(message), pack(message))


def test_the_plain_seal_only_names_the_sender() -> None:
    assert PlainSeal(3).open(PlainSeal(OPERATOR).seal(b"abc", "say/3"), "say/3") == (OPERATOR, b"abc")
    with pytest.raises(MessageError, match="no sender"):
        PlainSeal(0).open(b"\x00", "say/3")


def test_no_multicast_and_a_short_lease() -> None:
    values = settings(listen=["a"], connect=["b"], lease_s=2.0, security={"x": 1})
    assert values["scouting/multicast/enabled"] is False and values["mode"] == "peer"
    assert values["transport/link/tx/lease"] == 2000 and values["x"] == 1


def test_topic_may_bring_its_rate_and_twice_that_at_once() -> None:
    own = Allowance(10.0)
    assert sum(own.spend(100.0) for _ in range(100)) == 20
    assert sum(own.spend(100.0 + 0.01 * k) for k in range(1, 1001)) == pytest.approx(100, abs=1)
    assert sum(own.spend(1000.0) for _ in range(100)) == 20
    seldom = Allowance(0.1)
    assert seldom.spend(0.0) and not seldom.spend(5.0) and seldom.spend(11.0)


def test_access_rules_name_the_keys_of_each_sender() -> None:
    told = access_control({"robot-0": ["flock/say/0"], "watcher": []})["access_control"]
    assert told["enabled"] and told["default_permission"] == "deny"
    ingress = [r for r in told["rules"] if r["flows"] == ["ingress"]]
    assert [(r["id"], r["key_exprs"]) for r in ingress] == [("robot-0", ["flock/say/0"])]
    assert {"rules": ["robot-0"], "subjects": ["robot-0"]} in told["policies"]
    assert [s["cert_common_names"] for s in told["subjects"]] == [["robot-0"], ["watcher"]]
