"""The body of a robot: simulated here, drivers for real ones beside it."""
