"""`llm-flock view`: shows runs in a browser."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from llm_flock import plugins
from llm_flock.cli import Finding
from llm_flock.errors import InputError
from llm_flock.extras import ExtraMissing, require
from llm_flock_view._foxglove.options import Foxglove, FoxglovePort, port_of


def view(
    records: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[RECORD]...",
            help="Records (run.mcap), folders that hold one, or folders of such folders",
            show_default=False,
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Follow records that are still being written [the newest one in --runs]")
    ] = False,
    connect: Annotated[
        str | None,
        typer.Option(help="Watch a running swarm: endpoint of a peer, such as tcp/127.0.0.1:7447", show_default=False),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Configuration of the swarm (TOML), for --connect", show_default=False)
    ] = None,
    swarm: Annotated[
        str | None, typer.Option(help="Name of the swarm [the configuration's]", show_default=False)
    ] = None,
    runs: Annotated[Path, typer.Option(help="Folder for the records of runs that are started from the page")] = Path(
        "runs"
    ),
    model: Annotated[
        list[str] | None,
        typer.Option(
            help="Model that runs from the page may ask, PROVIDER:MODEL or local:MODEL; the first reads missions in "
            "words; may repeat",
            show_default=False,
        ),
    ] = None,
    base_url: Annotated[
        str | None, typer.Option(help="Address that replaces the provider's own", show_default=False)
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen at")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen at; 0 takes a free one")] = 8765,
    token: Annotated[
        str | None,
        typer.Option(
            envvar="LLM_FLOCK_TOKEN",
            help="Token that a browser must show [random]; on the command line, others on this machine can see it",
            show_default=False,
        ),
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser")] = True,
    reader: Annotated[
        str | None,
        typer.Option(help="Model that reads missions in words [the first --model]", show_default=False),
    ] = None,
    foxglove: Foxglove = False,
    foxglove_port: FoxglovePort = None,
) -> None:
    """Watch runs in a browser: replay records, follow one that is being written, watch a swarm, or fly simulated runs.

    Without a record, the page opens with the form that starts runs.
    """
    live_port = port_of(foxglove, foxglove_port)
    require("view", "view")
    from llm_flock_view._viewer.paths import growing_in, newest_in, records_in
    from llm_flock_view._viewer.server import listen

    if swarm is not None and connect is None and config is None:
        raise InputError("swarm", swarm, says="has no effect without --connect or --config")
    if base_url is not None and not model:
        raise InputError("base_url", base_url, says="has no effect without --model")
    found = list(records or [])
    if live:
        found = growing_in(found) or [newest_in(runs)]
    else:
        found = records_in(found)
    watched = None
    if connect is not None or config is not None:
        if "swarm" not in plugins.entries("watches"):
            raise ExtraMissing("view --connect", "network")
        watched = plugins.load("watches", "swarm")(config, connect, swarm)
    # Whatever can fail does so before an address is shown.
    models, reads = tuple(model or ()), None
    if models or reader:
        from llm_flock.llm import MissionReader

        reads = MissionReader(reader or models[0], base_url)
    server = None
    if live_port is not None:
        from llm_flock_view._foxglove.server import MAX_SERVED_ROBOTS, FoxgloveServer

        server = FoxgloveServer(live_port, MAX_SERVED_ROBOTS)
    address = listen(host, port, token)
    typer.echo(address.url)
    if server is not None:
        typer.echo(f"Foxglove: {server.url}", err=True)
    typer.echo("Ctrl-C ends the viewer", err=True)
    if browser:
        threading.Thread(target=_open, args=(address.url, runs), daemon=True).start()
    # The heavy libraries come last: the browser starts meanwhile, and waits at the open port.
    from llm_flock_view._viewer.app import run_viewer

    run_viewer(
        address,
        records=found,
        folders=[] if live else [path for path in records or [] if path.is_dir()],
        live=live,
        swarm=watched,
        runs=runs,
        models=models,
        base_url=base_url,
        reader=reads,
        foxglove=server,
    )


def _open(url: str, runs: Path) -> None:
    """Let the browser open a page that leads to the viewer: other users of the machine see what a command is given."""
    import webbrowser

    # Browsers that are confined to the user's own folders read it there, but not in the system's folder.
    with TemporaryDirectory(dir=runs if os.access(runs, os.W_OK) else None) as folder:
        page = Path(folder).resolve() / "viewer.html"
        page.write_text(f'<!doctype html><meta http-equiv="refresh" content="0;url={url}">', encoding="ascii")
        webbrowser.open(page.as_uri())
        time.sleep(60.0)  # the browser has read it by then


def reach_browser() -> list[Finding]:
    """The line of `llm-flock doctor` about the browser that `llm-flock view` opens."""
    import webbrowser

    try:
        browser = webbrowser.get()
    except webbrowser.Error:
        return [Finding("reach", "browser", False, "none here; llm-flock view prints an address for any browser")]
    return [Finding("reach", "browser", True, getattr(browser, "name", "") or type(browser).__name__)]
