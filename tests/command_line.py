"""The command line: in a process of its own, or in the test's process, which saves a second of imports a command."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer

from llm_flock.__main__ import main
from llm_flock.cli._options import add_config_flags, with_config_flags

PLAIN = {"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}
ENV = {**os.environ, **PLAIN}

Done = subprocess.CompletedProcess[str]


def typed(*flags: str) -> dict[str, Any]:
    """The values that a command gets for flags of the configuration."""
    given: dict[str, Any] = {}

    @with_config_flags(shown=())
    def command(**values: Any) -> None:
        given.update(values)

    app = typer.Typer()
    app.command()(add_config_flags(command))
    typer.main.get_command(app).main(flags, standalone_mode=False)
    return given


def flock(*arguments: str, cwd: Path, check: bool = True) -> Done:
    """Run a command in this process."""
    out, errors, code = io.StringIO(), io.StringIO(), 0
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
    ):
        patch.chdir(cwd)
        patch.setattr(sys, "argv", ["llm-flock", *arguments])
        for name, value in PLAIN.items():
            patch.setenv(name, value)
        try:
            main()
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    return checked(Done(arguments, code, out.getvalue(), errors.getvalue()), check)


def flock_process(*arguments: str, cwd: Path, check: bool = True, timeout_s: float = 120) -> Done:
    """Run a command in a process of its own, as a user does."""
    done = subprocess.run(
        [sys.executable, "-m", "llm_flock", *arguments],
        cwd=cwd,
        env={name: value for name, value in ENV.items() if not name.endswith("_API_KEY")},
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )
    return checked(done, check)


def checked(done: Done, check: bool) -> Done:
    assert not check or done.returncode == 0, done.stderr + done.stdout
    return done
