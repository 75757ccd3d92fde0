"""Stand-ins for Crazyflies: point masses that speak the drones' protocol (CRTP) over UDP, as Bitcraze's cflib uses it.

Lost packets, death, an empty battery, and an estimate that jumps or stalls can be caused at any time.
"""

from llm_flock_flight._testing.crtp.radio import ModelledRadio
from llm_flock_flight._testing.crtp.server import StandIn, StandIns

__all__ = ["ModelledRadio", "StandIn", "StandIns"]
