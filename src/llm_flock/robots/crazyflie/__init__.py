"""Crazyflies, driven through the high-level commander on board by Bitcraze's cflib.

cflib is under the GPL, version 3, so it is an extra (`pip install 'llm-flock[crazyflie]'`) that is imported only when a
link is opened, by `llm_flock.robots.crazyflie.link` alone.
"""

from llm_flock.robots.crazyflie.robot import CrazyflieRobot

__all__ = ["CrazyflieRobot"]
