"""Teaching a small model the two questions: examples, training, evaluation, and an adapter as a file."""
