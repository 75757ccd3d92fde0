"""Stand-ins for Crazyflies: point masses that speak the drones' protocol (CRTP) over UDP, as Bitcraze's cflib uses it.

They answer for the link, the protocol version, tables of log variables and parameters, memories, arming, the high-level
commander, log blocks and the emergency stop; each drone is a `llm_flock.robots._point_mass.PointMass`. Lost packets,
death, an empty battery, and an estimate that jumps or stalls can be caused at any time.

from llm_flock_flight._testing.crtp import StandIns

with StandIns([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]) as drones:
    print(drones.uris)  # udp://127.0.0.1:PORT, one each
"""

from llm_flock_flight._testing.crtp.radio import ModelledRadio
from llm_flock_flight._testing.crtp.server import StandIn, StandIns

__all__ = ["ModelledRadio", "StandIn", "StandIns"]
