"""Stand-ins for autopilots: point masses that speak MAVLink over UDP in the manner of PX4, or of ArduPilot.

They answer for heartbeats, modes, arming, take-off by command, set-points, landing, parameters, message intervals and
the emergency stop, and do what an autopilot does when set-points or heartbeats stop. They are written from the
autopilots' documentation, by the same hands as the driver: a flight with them shows that the driver keeps its contract,
and nothing about a real vehicle. Lost packets and answers, refusals, a pilot's switch, and a wrong estimate can be
caused at any time.

from llm_flock_flight._testing.mavlink import AutopilotStandIns

with AutopilotStandIns([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], flavour="px4") as vehicles:
    print(vehicles.uris)  # udp://127.0.0.1:PORT, one each
"""

from llm_flock_flight._testing.mavlink.server import AutopilotStandIn, AutopilotStandIns

__all__ = ["AutopilotStandIn", "AutopilotStandIns"]
