"""Many seeded trials, and what they say together."""
