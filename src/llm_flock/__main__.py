"""Entry point of `llm-flock` and `python -m llm_flock`; imports the rest where Ctrl-C can already be caught."""

import sys


def main() -> None:
    """Run the command line; Ctrl-C ends it with exit code 130, whenever it comes."""
    try:
        if sys.argv[1:2] == ["view"]:  # whoever wants to look does not wait for what it takes to fly
            from llm_flock.viewer.command import main as command_line
        else:
            from llm_flock.cli import main as command_line

        command_line()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
