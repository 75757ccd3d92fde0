"""A mission flown by real bodies: frames, limits, preflight, monitors, landing, and the process that outlives it."""
