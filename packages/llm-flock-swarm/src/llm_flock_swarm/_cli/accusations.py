"""Lists the robots that a record accuses of lying, and checks the proofs with the public keys of the team."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from llm_flock.cli import Screen
from llm_flock.errors import FlockError
from llm_flock.extras import require

if TYPE_CHECKING:
    from llm_flock.mission import Mission
    from llm_flock.record import RunRecord
    from llm_flock_swarm._network.accusations import Judge


MAX_SHOWN = 64  # accusations of a record that are checked and shown


def show_accusations(
    record: RunRecord,
    *,
    keys: Annotated[
        Path | None,
        typer.Option("--keys", metavar="DIR", help="Check accusations of lying with a team's public keys (team.json)"),
    ] = None,
) -> None:
    """Print a line for each accusation in a record; with a team's folder, whether its proof holds.

    What the accuser says is not shown, only what the proof says: a record may come from anywhere.
    """
    judge = None if keys is None else _judge(record, keys)
    missions = [] if judge is None else _missions(record)
    accused = [event for event in record.events if event.kind == "accused"]
    screen = Screen()
    for event in accused[:MAX_SHOWN]:
        line = f"robot {event.robot} accuses robot {event.detail.get('robot')} of lying: "
        if keys is None:
            line += "to check this, give --keys and the folder of the team's public keys"
        else:
            proven = judge.confirms(event.detail, missions) if judge is not None and missions else None
            line += "not proven" if proven is None else f"proven, it signed this message ({proven[1]})"
        screen.print(Text(line))
    if len(accused) > MAX_SHOWN:
        screen.print(Text(f"{len(accused) - MAX_SHOWN} more accusations"))


def _judge(record: RunRecord, keys: Path) -> Judge | None:
    """The judge of the record's messages; None if the record is of no swarm of this program."""
    require("network", "inspect --keys")
    from llm_flock_swarm._network.accusations import Judge
    from llm_flock_swarm._network.config import SwarmConfig
    from llm_flock_swarm._trust.keys import load_public_keys

    public = load_public_keys(keys)
    try:
        config, _ = SwarmConfig.stored(record.run.config)
        return Judge(public.for_flight(config.network.swarm), config)
    except (FlockError, ValueError):
        return None


def _missions(record: RunRecord) -> list[Mission]:
    """The missions of a record that this program can fly."""
    from llm_flock.mission import Mission

    found: list[Mission] = []
    for info in record.missions:
        try:
            found.append(Mission.model_validate(info.mission))
        except (FlockError, ValueError):
            continue
    return found
