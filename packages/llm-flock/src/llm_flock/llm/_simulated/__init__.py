"""Simulated language models: they read only the prompt, and fail in the ways of their profile."""
