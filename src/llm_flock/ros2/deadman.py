"""The deadman of a flight whose poses come from ROS 2: it takes them from there while it lands the drones.

Its process is `llm_flock.runtime.flight.deadman`, which knows no ROS.
"""

from __future__ import annotations

import sys

from llm_flock.ros2.flight import poses_of
from llm_flock.ros2.types import prepare
from llm_flock.runtime.flight import deadman


def main() -> int:
    """Load what takes time before the flight begins; then run the deadman."""
    prepare()
    return deadman.main(poses_of)


if __name__ == "__main__":
    sys.exit(main())
