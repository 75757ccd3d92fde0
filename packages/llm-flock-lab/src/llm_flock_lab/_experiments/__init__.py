"""Experiments: many seeded trials, flown as a sweep or a comparison, and statistics of their results."""
