"""Language models on board: a GGUF file, run by an engine inside this process (the `local` extra)."""
