"""The LoRA adapter that LLM-Flock loads beside SmolLM2-135M-Instruct for `--model local:smollm2`."""

from pathlib import Path

ADAPTER = Path(__file__).with_name("smollm2-flock.gguf")
"""The adapter, a GGUF file for llama.cpp."""

LETTERS = Path(__file__).with_name("smollm2-letters.gguf")
"""The adapter for questions that are answered with one letter, `--model local:smollm2+letters`."""
