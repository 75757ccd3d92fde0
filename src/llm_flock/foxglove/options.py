"""Options of the commands that show a run in Foxglove while it flies. Imports nothing heavy."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from llm_flock.errors import InputError
from llm_flock.extras import require
from llm_flock.listening import ListeningPort, open_port

PANEL = "Foxglove"
HOST = "127.0.0.1"
PORT = 8766
"""Port by default: one above the viewer's, so that both can be open."""

# None stands for an option that was not typed: without --foxglove none may be.
OPTIONS: dict[str, Any] = {
    "foxglove": Annotated[
        bool, typer.Option("--foxglove", help="Serve the run to Foxglove while it flies", rich_help_panel=PANEL)
    ],
    "foxglove_host": Annotated[
        str | None,
        typer.Option(
            help="Address to serve it at; any but this machine's own needs a token",
            show_default=HOST,
            hidden=True,
            rich_help_panel=PANEL,
        ),
    ],
    "foxglove_port": Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            help="Port to serve it at; 0 takes a free one",
            show_default=str(PORT),
            hidden=True,
            rich_help_panel=PANEL,
        ),
    ],
    "foxglove_token": Annotated[
        str | None,
        typer.Option(
            help="Token that Foxglove must show, 16 characters or more; whoever shows it may give orders",
            show_default=False,
            hidden=True,
            rich_help_panel=PANEL,
        ),
    ],
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """Whether and where a command serves its run to Foxglove, as its options say."""

    on: bool
    host: str
    port: int
    token: str | None

    def refuse(self, where: str) -> None:
        """Refuse --foxglove for a command that shows nothing there.

        Raises:
            InputError: it was given.
        """
        if self.on:
            raise InputError("foxglove", None, says=f"has no effect in {where}")

    def listen(self) -> ListeningPort | None:
        """Listen where Foxglove is to be served; None where it was not asked for. Call before an address is shown.

        Raises:
            InputError: the extra is not installed, the port is taken, or the token is too short.
        """
        if not self.on:
            return None
        require("foxglove", "--foxglove")
        return open_port(self.host, self.port, self.token, "foxglove_")


def with_foxglove(command: Callable[..., None]) -> Callable[..., None]:
    """Add these options to a command. It gets them as one `Service`, in its keyword parameter `service`."""

    @functools.wraps(command)
    def with_service(**given: Any) -> None:
        options = {name: given.pop(name) for name in OPTIONS}
        command(service=_service(**options), **given)

    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        if parameter.name == "service":
            parameters += [
                inspect.Parameter(
                    name, parameter.KEYWORD_ONLY, default=False if name == "foxglove" else None, annotation=annotation
                )
                for name, annotation in OPTIONS.items()
            ]
        else:
            parameters.append(parameter)
    vars(with_service)["__signature__"] = inspect.Signature(parameters)
    with_service.__annotations__ = {p.name: p.annotation for p in parameters}
    return with_service


def _service(
    *, foxglove: bool, foxglove_host: str | None, foxglove_port: int | None, foxglove_token: str | None
) -> Service:
    typed = {"foxglove_host": foxglove_host, "foxglove_port": foxglove_port}
    for field, value in {**typed, "foxglove_token": None if foxglove_token is None else ""}.items():
        if value is not None and not foxglove:
            shown = None if field == "foxglove_token" else value
            raise InputError(field, shown, says="has no effect without --foxglove")
    return Service(
        on=foxglove,
        host=HOST if foxglove_host is None else foxglove_host,
        port=PORT if foxglove_port is None else foxglove_port,
        token=foxglove_token,
    )
