from ._network.config import SwarmConfig as SwarmConfig
from ._network.swarm import SwarmResult as SwarmResult
from ._network.swarm import run_swarm as run_swarm
from ._signed.parts import signed_parts as signed_parts
from ._trust.keys import make_keys as make_keys
