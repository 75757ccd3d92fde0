"""Stand-ins for Crazyflies: they speak the drones' protocol (CRTP) over UDP, as Bitcraze's cflib uses it.

The link source, the protocol version, the tables of log variables and parameters, the list of memories, arming, the
high-level commander, log blocks and the emergency stop are there; the drone behind them is a point mass
(`llm_flock.robots.point_mass`). Loss, death, an empty battery, and an estimate that jumps or stalls come on demand.

from llm_flock.testing.crtp import StandIns

with StandIns([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]) as drones:
    print(drones.uris)  # udp://127.0.0.1:PORT, one each
"""

from llm_flock.testing.crtp.server import StandIn, StandIns

__all__ = ["StandIn", "StandIns"]
