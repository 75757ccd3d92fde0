"""Topics and rates that each member of a team may send."""

from __future__ import annotations

from llm_flock.members import OPERATOR, WORLD, member_name, members
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._zenoh import ROOT

REPORT_S = 0.2  # time between two reports to observers [s]
ORDER_S = 1.0  # shortest time between two orders of an operator, in the long run [s]
BURST_FACTOR = 4.0  # allowed rate over configured rate: delayed messages arrive in bursts


def rates(config: SwarmConfig) -> dict[str, float]:
    """Messages a second that one sender may bring, by kind."""
    network = config.network
    periods = {
        "say": network.gossip_s,
        "beacon": network.beacon_s,
        "frame": network.frame_s,
        "command": network.control_s,
        "report": REPORT_S,
        "mission": ORDER_S,
    }
    return {kind: BURST_FACTOR / period for kind, period in periods.items()}


def topics_of_members(config: SwarmConfig) -> dict[str, list[str]]:
    """Keys under which each member of a team may send and be alive, by the name in its certificate."""
    root, n = f"{ROOT}/{config.network.swarm}", config.mission.n_robots
    others = {WORLD: [f"frame/{WORLD}", f"alive/{WORLD}"], OPERATOR: ["mission/*"]}
    robots = {j: [f"{kind}/{j}" for kind in ("say", "beacon", "report", "command", "alive")] for j in range(n)}
    return {
        member_name(member): [f"{root}/{topic}" for topic in {**others, **robots}.get(member, [])]
        for member in members(n)
    }
