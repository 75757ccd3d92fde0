"""Figures and animations, drawn from records."""
