"""Drives minds, bodies, models and messages through a mission."""
