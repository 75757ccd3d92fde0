"""Signatures around messages and agreement, for teams whose members hold keys."""
