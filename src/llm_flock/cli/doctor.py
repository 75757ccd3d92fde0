"""`llm-flock doctor`: what is installed, which keys are set, and what can be reached from here."""

from __future__ import annotations

import json
import os
import platform
import socket
import sys
from dataclasses import asdict, dataclass
from importlib import metadata
from itertools import groupby
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from llm_flock.cli.terminal import Screen, say
from llm_flock.extras import EXTRAS

ROUTER = "tcp/127.0.0.1:7447"
"""Where a swarm's peers find each other unless the configuration says otherwise."""

PATIENCE_S = 2.0
"""Longest wait for a router [s]."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the examination.

    Attributes:
        part: what it belongs to: base, extra, key or reach.
        name: what was looked for.
        ok: whether it is there.
        detail: what was found, or what to do.
    """

    part: str
    name: str
    ok: bool
    detail: str


def doctor(
    router: Annotated[str, typer.Option(help="Endpoint of a swarm's router or peer to reach")] = ROUTER,
    drones: Annotated[
        bool, typer.Option("--drones/--no-drones", help="Look for Crazyflies by radio, cable and UDP (a second)")
    ] = True,
    json_output: Annotated[bool, typer.Option("--json", help="Print a JSON list instead of a table")] = False,
) -> None:
    """Show what is installed, which extras and keys are there, and whether drones, a router and a browser are in reach.

    No language model is asked, and no key is shown. What is missing is no error: a simulated run needs none of it.
    """
    found = [*base(), *extras(), *provider_keys()]
    found += [reach_drones()] if drones else []
    found += [reach_router(router), reach_browser()]
    if json_output:
        say(json.dumps([asdict(finding) for finding in found]))
        return
    for part, rows in groupby(found, key=lambda finding: finding.part):
        table = Table("name", "there", "what", title=part, title_justify="left")
        for row in rows:
            table.add_row(escape(row.name), "[green]yes[/]" if row.ok else "[dim]no[/]", escape(row.detail))
        Screen().show(table, copied=("name",))
    if any(extra.missing for extra in EXTRAS.values()):
        say("to add extras: pip install 'llm-flock[NAME,...]'")


def version() -> str:
    """This package's version; `not installed` where it runs from its sources alone."""
    try:
        return metadata.version("llm-flock")
    except metadata.PackageNotFoundError:
        return "not installed"


def base() -> list[Finding]:
    """This package, the interpreter and the system."""
    return [
        Finding("base", "llm-flock", True, version()),
        Finding("base", "Python", sys.version_info >= (3, 11), f"{platform.python_version()}, {sys.prefix}"),
        Finding("base", "system", True, f"{platform.system()} {platform.release()}, {platform.machine()}"),
    ]


def extras() -> list[Finding]:
    """Each extra: whether its libraries are installed, and what needs them. Imports none of them."""
    return [Finding("extra", extra.name, not extra.missing, extra.purpose) for extra in EXTRAS.values()]


def provider_keys() -> list[Finding]:
    """Each environment variable that may hold a provider's key, and whether it does; never its value."""
    from llm_flock.llm.providers import PROVIDERS

    names = dict.fromkeys(info.key_env for info in PROVIDERS.values())
    users = {name: [info.name for info in PROVIDERS.values() if info.key_env == name] for name in names}
    return [Finding("key", name, is_set(name), ", ".join(users[name])) for name in names]


def is_set(variable: str) -> bool:
    """Whether an environment variable holds more than spaces."""
    return bool(os.environ.get(variable, "").strip())


NO_DRONE = "none answers, by radio at the address E7E7E7E7E7; llm-flock stand-ins simulates some"
"""Radios are searched on all channels for the address that drones are shipped with, not for others."""


def reach_drones() -> Finding:
    """Crazyflies that answer."""
    if EXTRAS["crazyflie"].missing:
        return Finding("reach", "drone", False, "the extra crazyflie is not installed")
    from llm_flock.robots.crazyflie.link import in_reach

    try:
        uris = in_reach()
    except Exception as error:  # noqa: BLE001  # drivers of radios raise anything, and this only looks
        return Finding("reach", "drone", False, f"the search failed: {error}")
    return Finding("reach", "drone", bool(uris), ", ".join(uris) or NO_DRONE)


def reach_router(endpoint: str) -> Finding:
    """Whether something listens at a swarm's endpoint, such as tcp/127.0.0.1:7447."""
    host, colon, port = endpoint.partition("/")[2].rpartition(":")
    name = f"router at {endpoint}"
    if not colon or not port.isdigit() or not host or int(port) > 65535:
        return Finding("reach", name, False, "not an endpoint such as tcp/127.0.0.1:7447")
    try:
        socket.create_connection((host.strip("[]"), int(port)), PATIENCE_S).close()
    except OSError as error:
        return Finding("reach", name, False, f"{error.strerror or error}; llm-flock swarm needs none")
    return Finding("reach", name, True, "something listens there")


def reach_browser() -> Finding:
    """The browser that `llm-flock view` opens."""
    import webbrowser

    try:
        browser = webbrowser.get()
    except webbrowser.Error:
        return Finding("reach", "browser", False, "none here; llm-flock view prints an address for any browser")
    return Finding("reach", "browser", True, getattr(browser, "name", "") or type(browser).__name__)
