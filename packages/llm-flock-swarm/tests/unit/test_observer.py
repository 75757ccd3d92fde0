"""What an observer believes: sensors, the operator, and each robot about itself."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from reports import CONFIG, MISSION, PLACES, PLAN, N, happened, told
from swarms import swarm_config

from llm_flock.arrays import Point
from llm_flock.errors import MessageError
from llm_flock.message import MissionStamp
from llm_flock.plan import Drawing, Plan
from llm_flock.record._schema import Entry, LlmEntry, MetricsRow, PlanInfo, ProtocolEvent
from llm_flock_swarm._network import observer as observers
from llm_flock_swarm._network import swarm
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.self_reports import MAX_LATENCIES, MAX_PLANS
from llm_flock_swarm._network.wire import Body, RobotReport, WorldState, pack, unpack

UNDRAWN = Plan(drawing=Drawing(program="{}", places=N, spacing=1.0, center=(0.0, 0.0)))  # a program that draws nothing


class Sink:
    def __init__(self) -> None:
        self.entries: list[Entry] = []

    def write(self, entry: Entry) -> None:
        self.entries.append(entry)


def observer(
    bodies: tuple[Point, ...] = PLACES, *, signed: Callable[[MissionStamp, bytes], bool] | None = None
) -> Observer:
    now = [50.0]
    seen = Observer(CONFIG, Sink(), signed=signed, clock=lambda: now[0])
    for robot in range(N):
        seen.comes_or_goes(robot, True)
    seen.world(
        WorldState(stamp=1.0, closest=5.0, bodies=tuple(Body(position=x, end=x, command=0) for x in bodies), late=0)
    )
    return seen


def written(seen: Observer) -> list[Entry]:
    return seen._sink._work.__self__.entries  # type: ignore[attr-defined]


def check_at(seen: Observer, now: float) -> None:
    seen._clock = lambda: now
    seen.check()


def call(robot: int = 0, **usage: int) -> LlmEntry:
    """A call of a robot's model, as a report carries it."""
    names = {"round": 0, "kind": "plan", "attempt": 0, "model": "simulated:ideal", "request_hash": "x"}
    rest: dict[str, Any] = {"messages": [], "settings": {}, "usage": usage, "latency_s": 0.1, "faults": []}
    return LlmEntry.model_validate({"robot": robot, **names, **rest})


def formed(seen: Observer, *reports: RobotReport) -> bool:
    """Whether the team has formed by these reports, heard again and again for a while."""
    for k in range(60):
        for robot, report in enumerate(reports):
            seen.report(robot, report)
        check_at(seen, 50.0 + 0.1 * k)
    return seen.formed_s is not None


def test_a_robot_with_a_wrong_clock_is_named(caplog: pytest.LogCaptureFixture) -> None:
    event = ProtocolEvent(round=0, comm_round=None, robot=1, kind="clock", detail={"ahead_s": -7200.0})
    observer().report(1, told(1, happened=(event,)))
    assert "robot 1 stands still: its clock is -7200.0 s ahead of that of its positions" in caplog.text


def test_a_team_at_its_places_has_formed() -> None:
    assert formed(observer(), *map(told, range(N)))


@pytest.mark.parametrize(
    "lie",
    [
        {"goal": 1},
        {"plan_id": "0" * 16},
        {"slot": 0},
        {"slot": None, "blocked": (2,)},
        {"mission": (2**40, MISSION.digest)},
        {"mission": (0, "0" * 16)},
    ],
)
def test_one_member_cannot_say_that_the_team_has_formed(lie: dict[str, Any]) -> None:
    """Robot 2 is not at its place, and no statement of its own changes that."""
    bodies = (*PLACES[:2], (20.0, 20.0))
    last = told(2) if "goal" in lie else told(2, **{"plan": None, **lie})
    assert not formed(observer(bodies), told(0), told(1), last)


def test_place_is_blocked_once_two_robots_report_it() -> None:
    """Robot 2 is dead, bodies that do not move stand on two places, and robot 1 is left without one."""
    spare = told(1, slot=None, blocked=(1, 2))
    for word, expected in (((), False), ((1, 2), True)):
        seen = observer()
        seen.comes_or_goes(2, False)
        assert formed(seen, told(0, blocked=word), spare) is expected


def test_a_team_that_will_replan_has_not_formed() -> None:
    seen = observer()
    assert not formed(seen, told(0, replans=True), *map(told, range(1, N)))
    assert formed(seen, *map(told, range(N)))
    # What has formed ends as soon as a robot is about to leave the plan.
    seen.report(1, told(1, replans=True))
    check_at(seen, 60.0)
    assert seen.formed_s is None and not seen.in_order


@pytest.mark.parametrize(("gaps", "has"), [("report", True), ("replan", False)])
def test_a_plan_for_more_robots_than_live_is_no_end(gaps: str, has: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(observers, "fits", lambda _, places, robots: places == robots)  # no triangle has two corners
    seen = observer()
    protocol = CONFIG.protocol.model_copy(update={"gaps": gaps})
    seen._config = CONFIG.model_copy(update={"protocol": protocol})
    seen.alive.discard(N - 1)
    assert formed(seen, *map(told, range(N - 1))) is has


def test_rows_say_since_which_row_the_team_is_in_order() -> None:
    seen = observer()
    assert formed(seen, *map(told, range(N)))
    rows = [entry for entry in written(seen) if isinstance(entry, MetricsRow)]
    assert [row.in_order_since for row in rows] == [0] * len(rows) and len(rows) > 3
    seen.report(1, told(1, slot=0))
    check_at(seen, 70.0)
    last = written(seen)[-2]
    assert isinstance(last, MetricsRow) and last.in_order_since is None


def test_a_swarm_with_stages_left_has_not_formed() -> None:
    seen = observer()
    assert formed(seen, *map(told, range(N)))
    seen.mission = seen.mission.change(then=[{"set": {"shape": "line"}, "when": "order"}])
    assert seen.in_order and seen.formed_s is None


def other_mission(counter: int) -> dict[str, Any]:
    mission = MISSION.change(shape="line")
    return {"mission": (counter, mission.digest), "shape": mission.model_dump(mode="json")}


def test_only_the_operator_changes_the_mission() -> None:
    def signed(stamp: MissionStamp, signature: bytes) -> bool:
        return signature == b"operator %d" % stamp.counter

    seen = observer(signed=signed)
    with pytest.raises(MessageError, match="no_order"):
        seen.report(1, told(1, **other_mission(2**40)))
    with pytest.raises(MessageError, match="no_order"):
        seen.report(1, told(1, **other_mission(2**40), order=b"operator 7"))
    assert seen.mission.shape == "triangle" and 1 not in seen.reports
    assert formed(seen, *map(told, range(N)))
    seen.report(1, told(1, **other_mission(7), order=b"operator 7"))
    assert seen.mission.shape == "line" and seen.formed_s is None


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        ({"n_robots": 4}, "malformed"),
        ({"shape": "line"}, "malformed"),
        ({"spacing": "wide"}, "malformed"),
        ({"nothing": 1}, "malformed"),
    ],
)
def test_a_mission_of_another_team_or_digest_is_refused(shape: dict[str, Any], reason: str) -> None:
    seen = observer()
    fields = {**MISSION.model_dump(mode="json"), **shape}
    with pytest.raises(MessageError) as caught:
        seen.report(0, told(0, mission=(5, MISSION.digest), shape=fields))
    assert caught.value.reason == reason and seen.mission is MISSION


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"waypoint": (1.0, 2.0, 3.0)}, "wrong_length"),
        ({"waypoint": ()}, "wrong_length"),
        ({"plan": Plan(((1.0, 2.0, 3.0),) * N)}, "wrong_length"),
        ({"plan": Plan(((1.0, 2.0),) * N)}, "malformed"),
        ({"plan": UNDRAWN, "plan_id": UNDRAWN.digest}, "malformed"),
        ({"plan_id": None}, "malformed"),
        ({"happened": happened(1, "proposed")}, "impostor"),
    ],
)
def test_report_no_honest_robot_makes_is_refused_as_a_whole(changes: dict[str, Any], reason: str) -> None:
    seen = observer()
    report = unpack(RobotReport, pack(told(0, **changes)))
    with pytest.raises(MessageError) as caught:
        seen.report(0, report)
    assert caught.value.reason == reason and not seen.reports


@pytest.mark.parametrize(
    "changes",
    [
        {"waypoint": (float("inf"), 0.0)},
        {"plan": [((float("nan"), 0.0),) * N]},
        {"plan": [(), None]},
        {"plan": [PLACES, UNDRAWN.drawing]},
        {"round": -1},
        {"slot": 2**31},
        {"mission": (2**62, "x")},
        {"rejected": {str(k): 1 for k in range(1000)}},
        {"rejected": {"x" * 1000: 1}},
        {"latencies_s": (float("nan"),)},
        {"happened": happened(0, "proposed", a=1) * 5000},
        {"blocked": tuple(range(100)) * 200},
        {"neighbors": 2**53 - 1},
        {"hopeless": "x" * 2001},
        {"happened": (b'{"round":0,"robot":0,"kind":"x","detail":{"x":NaN}}',)},
        {"happened": (b'{"round":0,"robot":0,"kind":"x","detail":{"x":1180591620717411303424}}',)},
        {"happened": (b'{"round":0,"robot":0,"kind":"x","detail":{"x":' + 300 * b"[" + 300 * b"]" + b"}}",)},
        {"happened": (b'{"round":0,"robot":0,"kind":"x","detail":{"\\ud800":0}}',)},
        {"happened": ({"round": 0, "robot": 0, "kind": "x", "detail": {b"raw": 0}},)},
        {"calls": (b'{"robot":0}',)},
        {"calls": (call().encoded().replace(b'"input":0', b'"input":-1'),)},
    ],
)
def test_a_report_is_bounded_on_the_wire(changes: dict[str, Any]) -> None:
    with pytest.raises(MessageError, match="malformed"):
        unpack(RobotReport, pack(told(0, **changes)))


def test_what_no_row_holds_is_refused_as_its_robots_fault() -> None:
    """The bounds of messages and records are one table; were they not, no other robot would suffer."""
    seen = observer()
    with pytest.raises(MessageError, match="no record holds it"):
        seen.report(0, told(0, neighbors=2**53))
    seen.check()
    assert not seen.reports


def test_readings_of_another_dimension_are_dropped() -> None:
    seen, bodies = observer(), tuple(Body(position=(0.0, 0.0, 0.0), end=(0.0, 0.0, 0.0), command=0) for _ in range(N))
    seen.world(WorldState(stamp=2.0, closest=1.0, bodies=bodies, late=0))
    seen.check()
    assert seen.min_separation == 5.0


def test_a_call_of_another_robot_is_not_believed() -> None:
    other = call(robot=1)
    seen = observer()
    with pytest.raises(MessageError, match="impostor"):
        seen.report(0, told(0, calls=(other,)))
    seen.report(1, told(1, calls=(other,)))
    assert seen.said.calls == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"bytes": 2**53 - 1},
        {"sent": 2**53 - 1},
        {"rejected": {"too_many": 2**53 - 1}},
        {"calls": (call(input=2**53, output=2**53),)},
    ],
)
def test_sums_of_what_robots_say_have_room_in_a_record(changes: dict[str, Any]) -> None:
    """One member's counts ended recorder and launcher: the sum was more than a record holds."""
    seen = observer()
    for k in range(3):
        for robot in range(N):
            seen.report(robot, told(robot, **(changes if robot == 0 or "calls" not in changes else {})))
        check_at(seen, 100.0 + 10 * k)
    rows = [entry for entry in written(seen) if isinstance(entry, MetricsRow)]
    assert len(rows) == 3 and seen.said.tokens <= 2**53


def test_reports_of_one_robot_take_bounded_memory() -> None:
    """Plans, their suppliers and latencies; and the other robots' are heard all the same."""
    seen = observer()
    for k in range(400):
        points = tuple((float(k), 5.0 * j) for j in range(N))
        seen.report(
            0,
            told(
                0,
                plan_id=Plan(points).digest,
                plan=Plan(points),
                happened=happened(0, "proposed", plan=f"plan {k}", by="model"),
                latencies_s=tuple(0.001 * i for i in range(100)),
            ),
        )
    assert len(seen.said.places) == MAX_PLANS and len(seen.said.latencies_s) == MAX_LATENCIES
    seen.report(1, told(1, happened=happened(1, "proposed", plan=PLAN.digest, by="model")))
    assert seen.said.supplier(PLAN.digest, 1) == "simulated:ideal" and PLAN.digest in seen.said.places
    many = tuple((float(i), 0.0) for i in range(2000))
    with pytest.raises(MessageError, match="2000 places"):
        seen.report(1, told(1, plan_id=Plan(many).digest, plan=Plan(many)))


def test_one_robot_takes_a_bounded_share_of_the_record() -> None:
    """Events of 200 kB: five at once, then two and a half a second; a clock that is set back gives no more."""
    now = [50.0]
    sink = Sink()
    seen = Observer(CONFIG, sink, clock=lambda: now[0])
    long = "x" * 200_000

    def taken(seconds: float) -> int:
        """How many of ten reports are taken, spread evenly over this time."""
        before = len(sink.entries)
        for _ in range(10):
            now[0] += seconds / 10
            with suppress(MessageError):
                seen.report(0, told(0, happened=happened(0, "noise", text=long)))
        return sum(isinstance(entry, ProtocolEvent) for entry in sink.entries[before:])

    assert (taken(0.0), taken(4.0), taken(-100.0)) == (5, 10, 0)
    with pytest.raises(MessageError, match="too_much"):
        seen.report(0, told(0, happened=happened(0, "noise", text=long)))
    seen.report(0, told(0))
    seen.report(1, told(1, happened=happened(1, "noise", text=long)))


def test_no_mission_is_read_before_its_signature() -> None:
    shape = {**MISSION.model_dump(mode="json"), "obstacles": [{"polygon": [[k, (k * k) % 997] for k in range(20_000)]}]}
    with pytest.raises(MessageError) as caught:
        observer(signed=lambda *_: False).report(0, told(0, mission=(5, "ab" * 8), shape=shape))
    assert caught.value.reason == "no_order"
    with pytest.raises(MessageError, match="at most 128 corners"):
        observer().report(0, told(0, mission=(5, "ab" * 8), shape=shape))


def test_members_outside_the_team_do_not_report() -> None:
    with pytest.raises(MessageError, match="unknown_id"):
        observer().report(N, told(0))


def test_a_robot_that_goes_on_to_report_has_not_left() -> None:
    seen = observer()
    seen.report(0, told(0))
    seen.comes_or_goes(0, False)
    check_at(seen, 50.5)
    assert 0 in seen.robots
    check_at(seen, 51.1)
    assert 0 not in seen.robots
    seen.comes_or_goes(7, False)
    seen.comes_or_goes(0, True)
    assert 0 in seen.robots


def test_the_supplier_of_the_plan_is_what_most_robots_say() -> None:
    seen = observer()
    seen.report(0, told(0, happened=happened(0, "proposed", plan=PLAN.digest, slot=0, by="model")))
    seen.report(1, told(1))
    seen.report(2, told(2, proposer=2))
    assert seen.supplier == (0, "simulated:ideal")
    seen.report(1, told(1, plan_id=None, plan=None, proposer=None))
    assert seen.supplier is None


def test_plan_that_is_repeated_is_recorded_once() -> None:
    seen = observer()
    for robot in (0, 1, 0):
        seen.report(robot, told(robot))
    assert sum(isinstance(entry, PlanInfo) for entry in written(seen)) == 1


def test_only_whole_reports_pass_the_wire() -> None:
    raw = msgspec.msgpack.encode({"round": 1})
    with pytest.raises(MessageError, match="malformed"):
        unpack(RobotReport, pack(told(0))[:1] + raw)


@pytest.mark.parametrize("stops", [True, False])
def test_swarm_that_flies_on_does_not_end_once_formed(stops: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    class Launched:
        """Stands for the processes, and for an observer that has seen a formation."""

        async def __aenter__(self) -> Launched:
            return self

        async def __aexit__(self, *_: object) -> None:
            return

        async def run(self, until: Callable[[Any], bool] = lambda observer: observer.formed_s is not None) -> str:
            return "formed" if until(SimpleNamespace(formed_s=1.0)) else "time"

        def result(self, stopped: str) -> str:
            return stopped

        def tell(self, result: str) -> None:
            assert result in ("formed", "time")

    monkeypatch.setattr(swarm, "launch_swarm", lambda *_, **__: Launched())
    config = swarm_config(3, stop_when_formed=stops)
    assert asyncio.run(swarm.run_swarm(config)) == ("formed" if stops else "time")
