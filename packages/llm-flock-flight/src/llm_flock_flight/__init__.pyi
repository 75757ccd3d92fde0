from ._crazyflie.robot import CrazyflieRobot as CrazyflieRobot
from ._flight.config import FlightConfig as FlightConfig
from ._flight.fleet import start_of as start_of
from ._flight.flight import Flight as Flight
from ._flight.flight import FlightResult as FlightResult
from ._flight.sections import DroneConfig as DroneConfig
from ._mavlink.robot import MavlinkRobot as MavlinkRobot
from ._physics import PhysicsWorld as PhysicsWorld
