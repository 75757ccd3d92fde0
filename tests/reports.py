"""Reports of honest robots at their places."""

from __future__ import annotations

from typing import Any

from llm_flock.plan import Plan
from llm_flock.record import ProtocolEvent
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.wire import RobotReport

N = 3
CONFIG = SwarmConfig.build({}, shape="triangle", n_robots=N, model="simulated:ideal")
MISSION = CONFIG.mission
PLAN = Plan.of(MISSION.ideal or ())
PLACES = PLAN.points


def happened(robot: int, kind: str, /, **detail: Any) -> tuple[ProtocolEvent, ...]:
    """An event of a robot, as its report carries it."""
    return (ProtocolEvent(round=0, comm_round=None, robot=robot, kind=kind, detail=detail),)


def told(robot: int, **changes: Any) -> RobotReport:
    """The report of an honest robot at its place, with these changes."""
    whole: dict[str, Any] = {
        "round": 4,
        "period": 4,
        "phase": "moving",
        "mission": (0, MISSION.digest),
        "order": b"",
        "plan_id": PLAN.digest,
        "plan": PLAN,
        "proposer": 0,
        "slot": robot,
        "replans": False,
        "blocked": (),
        "waypoint": PLACES[robot],
        "origin": "model",
        "neighbors": N - 1,
        "happened": (),
        "calls": (),
        "waypoints": {"model": 4},
        "sent": 9,
        "bytes": 900,
        "rejected": {},
        "breakers": (),
        "hopeless": None,
        "latencies_s": (),
        "shape": None,
    }
    return RobotReport(**{**whole, **changes})
