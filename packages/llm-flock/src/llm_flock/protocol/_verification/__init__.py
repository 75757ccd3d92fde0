"""Verification: checks plans and waypoints before they are used."""
