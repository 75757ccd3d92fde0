"""Every report and every reading that the wire lets through becomes rows that a reader of the record reads back."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import pytest
from effort import cases
from hypothesis import given
from hypothesis import strategies as st
from legal import legal
from msgspec.structs import replace
from reports import CONFIG, MISSION, N, told

from llm_flock.mission import Mission
from llm_flock.plan import Coordinate, Plan
from llm_flock.record import LlmEntry, ProtocolEvent, RecordWriter, SummaryMessage, read_record
from llm_flock.runtime import run_info
from llm_flock_swarm._network import self_reports
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.wire import Body, RobotReport, WorldState, pack, unpack

CASES = 10

POINT = st.tuples(legal(Coordinate), legal(Coordinate))


@st.composite
def reports(draw: st.DrawFn, robot: int) -> RobotReport:
    """A report that this robot of this team may send: the rest is refused as another team's or robot's."""
    own = st.just(robot)
    team = {
        "waypoint": st.none() | POINT,
        "happened": st.lists(legal(ProtocolEvent, robot=own), max_size=3).map(tuple),
        "calls": st.lists(legal(LlmEntry, robot=own), max_size=3).map(tuple),
    }
    report = draw(legal(RobotReport, **team))
    plan = draw(st.none() | st.lists(POINT, min_size=N, max_size=N).map(Plan.of))
    changes: dict[str, Any] = {"plan": None} if plan is None else {"plan": plan, "plan_id": plan.digest}
    mission = draw(st.none() | legal(Mission).filter(lambda one: (one.n_robots, one.dim) == (N, MISSION.dim)))
    changes["shape"] = None if mission is None else mission.model_dump(mode="json")
    changes |= {} if mission is None else {"mission": (report.mission[0], mission.digest)}
    return replace(report, **changes)


BODIES = st.lists(st.builds(Body, POINT, POINT, st.just(0)), min_size=N, max_size=N).map(tuple)


@patch.object(self_reports, "RECORDED", 2**40)
@cases(CASES)
@given(
    heard=st.lists(reports(0), min_size=1, max_size=2),
    readings=st.lists(legal(WorldState, bodies=BODIES), min_size=2, max_size=2),
)
def test_every_legal_report_becomes_rows_that_are_read_back(
    heard: list[RobotReport], readings: list[WorldState], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "legal.mcap"
    path.unlink(missing_ok=True)
    now = [50.0]
    with RecordWriter(path) as writer:
        writer.write(run_info(CONFIG, simulated=True))
        seen = Observer(CONFIG, writer, clock=lambda: now[0])
        for robot in range(N):
            seen.comes_or_goes(robot, True)
            seen.report(robot, told(robot))
        for reading in readings:
            seen.world(unpack(WorldState, pack(reading)))
            for report in heard:
                now[0] += 10.0  # for their share of the record
                seen.report(0, unpack(RobotReport, pack(report)))
            seen.check()
        writer.write(SummaryMessage(result={"formed": seen.formed_s is not None}))
    record, told_of = read_record(path), heard * len(readings)
    assert record.rounds + 1 == len(readings) and record.complete
    assert len(record.llm) == sum(len(report.calls) for report in told_of)
    assert len(record.events) == sum(event.kind != "accused" for report in told_of for event in report.happened)
