"""Entry point of `llm-flock` and `python -m llm_flock`; imports the rest only once Ctrl-C can be caught."""

from __future__ import annotations

import errno
import os
import sys

EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED = 1, 2, 130

FULL = (errno.ENOSPC, errno.EDQUOT)
"""Faults of a full disk: where the output goes, or a file whose writer does not say so itself."""


def main() -> None:
    """Run the command line; expected errors become one line on stderr and an exit code. Ctrl-C ends it with 130."""
    try:
        _run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)


def _run() -> None:
    from llm_flock.errors import FlockError, InputError
    from llm_flock.printable import log_to_stderr, printable

    log_to_stderr()
    os.environ.pop("MPLBACKEND", None)  # figures go to files; one that matplotlib does not know would end the command
    try:
        from llm_flock.cli import app

        app()
    except FlockError as error:
        print(printable(f"error: {error}"), file=sys.stderr, flush=True)
        sys.exit(EXIT_INPUT if isinstance(error, InputError) else EXIT_FAILED)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            print(printable(f"error: {error.filename!s:.60}...: {error.strerror}"), file=sys.stderr, flush=True)
            sys.exit(EXIT_INPUT)
        if error.errno not in FULL:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # at the exit, the rest of the output would fail again
        print(printable(f"error: nothing more can be written ({error.strerror})"), file=sys.stderr, flush=True)
        sys.exit(EXIT_FAILED)


if __name__ == "__main__":
    main()
