"""Entry point of `llm-flock` and `python -m llm_flock`; imports the rest only once Ctrl-C can be caught."""

import sys


def main() -> None:
    """Run the command line. Ctrl-C ends it with exit code 130 at any time."""
    try:
        from llm_flock.cli import main as command_line

        command_line()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
