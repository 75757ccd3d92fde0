"""`llm-flock mcp`: gives agents tools to fly simulated missions and to read records."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from llm_flock.cli import say
from llm_flock.errors import InputError
from llm_flock.extras import require


def mcp(
    runs: Annotated[Path | None, typer.Option(help="Folder that records are read from and written to [none]")] = None,
    http: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Port of 127.0.0.1 to listen at, 0 for a free one [standard input]"),
    ] = None,
    token: Annotated[
        str | None, typer.Option(envvar="LLM_FLOCK_TOKEN", help="Token that clients of --http must show [random]")
    ] = None,
) -> None:
    """Offer tools to agents by the Model Context Protocol: simulated missions, comparisons, records, figures.

    An agent's program starts this command and talks to it by standard input and output. Nothing in it commands a drone
    or asks a language model.
    """
    require("mcp", "mcp")
    if runs is not None and not runs.is_dir():
        raise InputError("runs", str(runs), "a folder that is there")
    from llm_flock_lab._mcp.records import Records
    from llm_flock_lab._mcp.server import make_server, serve_http

    server = make_server(Records(runs))
    if http is None:
        server.run("stdio")
        return
    from llm_flock_view._viewer.server import listen

    address = listen("127.0.0.1", http, token)
    say(f"http://127.0.0.1:{address.port}/mcp")
    if token is None:
        say(f"Authorization: Bearer {address.token}")
    say("Ctrl-C ends the server", error=True)
    serve_http(server, address.sock, address.token)
