"""From a waypoint to a move that keeps the safe distance."""
