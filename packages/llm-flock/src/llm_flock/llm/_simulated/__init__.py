"""Simulated language models: they read nothing but the prompt, and get wrong what their profile says."""
