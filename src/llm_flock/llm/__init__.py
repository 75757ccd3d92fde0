"""Prompts, answers and language models: everything that turns a question of the core into text and back."""
