"""Stand-ins for drones."""
