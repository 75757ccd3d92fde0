"""Motion: turns waypoints into moves that keep the safe distance."""
