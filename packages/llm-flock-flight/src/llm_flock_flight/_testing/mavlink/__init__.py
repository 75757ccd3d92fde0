"""Stand-ins for autopilots: point masses that speak MAVLink over UDP in the manner of PX4, or of ArduPilot.

They are written from the autopilots' documentation, by the same hands as the driver: a flight with them shows that the
driver keeps its contract, and nothing about a real vehicle.
"""

from llm_flock_flight._testing.mavlink.server import AutopilotStandIn, AutopilotStandIns

__all__ = ["AutopilotStandIn", "AutopilotStandIns"]
