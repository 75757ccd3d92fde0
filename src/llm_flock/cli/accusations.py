"""Shows who is accused of lying in a record, and checks the proofs with the public keys of the team."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from rich.text import Text

from llm_flock.cli.terminal import Screen
from llm_flock.errors import FlockError, InputError
from llm_flock.mission import Mission
from llm_flock.protocol.signed.certificates import LIARS

if TYPE_CHECKING:
    from llm_flock.record.reader import RunRecord
    from llm_flock.runtime.network.accusations import Judge


def show_accusations(record: RunRecord, keys: Path | None) -> None:
    """Print a line for each accusation in a record; with a team's folder, whether its proof holds.

    Raises:
        InputError: the folder has no public keys.
    """
    judge = None if keys is None else _judge(record, keys)
    missions = [] if judge is None else list(_missions(record))
    for event in record.events:
        if event.kind != "accused":
            continue
        robot, reason = event.detail.get("robot"), event.detail.get("reason")
        line = f"robot {event.robot} accuses robot {robot} of lying ({reason})"
        if judge is None:
            line += ": check this with --keys and the folder of the team's public keys"
        else:
            proven = judge.confirms(event.detail, missions)
            line += ": not proven" if proven is None else f": proven, robot {proven[0]} signed it ({proven[1]})"
        Screen().print(Text(line))


def _judge(record: RunRecord, keys: Path) -> Judge:
    try:
        from llm_flock.runtime.network.accusations import Judge
        from llm_flock.trust.keys import load_public_keys
    except ImportError:
        raise InputError("keys", str(keys), "possible with the extra: pip install 'llm-flock[network]'") from None
    config = record.run.config
    liars = cast("Mapping[str, Any]", config.get("network") or {}).get("liars", LIARS)
    gaps = cast("Mapping[str, Any]", config.get("protocol") or {}).get("gaps")
    return Judge(load_public_keys(keys), liars=liars if isinstance(liars, int) else LIARS, any_size=gaps == "replan")


def _missions(record: RunRecord) -> list[Mission]:
    """The missions of a record that this program can fly."""
    found: list[Mission] = []
    for info in record.missions:
        try:
            found.append(Mission.model_validate(info.mission))
        except (FlockError, ValueError):
            continue
    return found
