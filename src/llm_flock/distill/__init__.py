"""Teach a small model to plan and to step: examples, training, evaluation, and an adapter file."""
