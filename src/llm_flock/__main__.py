"""`python -m llm_flock` is `llm-flock`."""

from llm_flock.cli import main

main()
