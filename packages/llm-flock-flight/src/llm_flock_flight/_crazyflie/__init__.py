"""Drives Crazyflies through their high-level commander, with Bitcraze's cflib.

cflib is under the GPL, version 3, so it is an extra (`pip install 'llm-flock[crazyflie]'`), and only
`llm_flock_flight._crazyflie.link` imports it, when a link is opened.
"""

from llm_flock_flight._crazyflie.robot import CrazyflieRobot

__all__ = ["CrazyflieRobot"]
