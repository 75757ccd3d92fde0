"""`llm-flock mcp`: gives agents tools to fly simulated missions and to read records."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from llm_flock.cli import say
from llm_flock.errors import InputError
from llm_flock.extras import require


def mcp(
    runs: Annotated[
        Path | None,
        typer.Option(help="Folder of the records that agents may read, and that their missions go to [none]"),
    ] = None,
    http: Annotated[bool, typer.Option("--http", help="Listen on this machine instead of standard input")] = False,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port of --http; 0 takes a free one [8766]", show_default=False)
    ] = None,
    token: Annotated[
        str | None,
        typer.Option(
            envvar="LLM_FLOCK_TOKEN",
            help="Token that clients of --http show [random]; on the command line, others on this machine can see it",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Offer tools to agents by the Model Context Protocol: simulated missions, comparisons, records, figures.

    An agent's program starts this command and talks to it by standard input and output. Nothing in it commands a drone
    or asks a language model.
    """
    require("mcp", "mcp")
    if port is not None and not http:
        raise InputError("port", port, says="has no effect without --http")
    from llm_flock_lab._mcp.records import Records
    from llm_flock_lab._mcp.server import make_server, serve_http

    if runs is not None:
        try:
            runs.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as error:
            raise InputError("runs", str(runs), f"a folder ({getattr(error, 'strerror', None) or error})") from None
    server = make_server(Records(runs))
    if not http:
        server.run("stdio")
        return
    from llm_flock_view._viewer.server import listen

    address = listen("127.0.0.1", 8766 if port is None else port, token)
    say(f"http://127.0.0.1:{address.port}/mcp")
    if token is None:
        say(f"Authorization: Bearer {address.token}")
    say("Ctrl-C ends the server", error=True)
    serve_http(server, address.sock, address.token)
