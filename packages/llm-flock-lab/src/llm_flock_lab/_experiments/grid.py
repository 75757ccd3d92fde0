"""The cells of an experiment, their arenas, and the trials that they stand for."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from llm_flock import shapes as formations
from llm_flock.arrays import Point, Vector
from llm_flock.bounds import MAX_ROBOTS
from llm_flock.errors import FieldError, InputError
from llm_flock.llm import PACKAGED, model_digests, parse_model, parse_models, waits
from llm_flock.mission import Mission
from llm_flock.runtime import RunConfig, load_points


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """Trials that differ only in their seed; `axes` are labels of the grid's axes that have no column in the tables."""

    config: RunConfig
    label: str = ""
    axes: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def protocol(self) -> str:
        return self.config.protocol.protocol

    @property
    def shape(self) -> str:
        return self.config.mission.shape

    @property
    def n_robots(self) -> int:
        return self.config.mission.n_robots

    def trial(self, seed: int, trial: str | None = None) -> TrialSpec:
        """The trial with this seed; `trial` is its id, by default `trial_id`."""
        config = self.config.model_copy(update={"trial": self.config.trial.model_copy(update={"seed": seed})})
        return TrialSpec(id=trial or trial_id(config), cell=self.label, axes=self.axes, config=config)


class Earlier(msgspec.Struct, frozen=True, kw_only=True):
    """Why an earlier try of a trial ended, and its use; the cost [US dollars] is None where no price is known."""

    stopped: str
    model_calls: int
    tokens: int
    cost_usd: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSpec:
    """A trial to fly, after its earlier tries."""

    id: str
    cell: str
    axes: Mapping[str, str]
    config: RunConfig
    earlier: tuple[Earlier, ...] = ()

    @property
    def seed(self) -> int:
        return self.config.trial.seed

    @property
    def models(self) -> tuple[str, ...]:
        return models_of(self.config)

    @property
    def waits(self) -> bool:
        """Whether the trial mostly waits for answers, so that many of its kind fit into one process."""
        return any(map(waits, self.models))


def models_of(config: RunConfig) -> tuple[str, ...]:
    """The models that a configuration uses, each once."""
    return tuple(dict.fromkeys(parse_models(config.model.model, config.mission.n_robots)))


def trial_id(config: RunConfig) -> str:
    """Hash of a resolved configuration and of the files that it names: prompts, cassettes, weights."""
    # Without fields that say where files go.
    sections = config.model_dump(mode="json", exclude={"trial": {"out"}, "model": {"record_llm"}})
    prompts = config.model.prompts
    files = [] if prompts is None or prompts in PACKAGED else [_digest(Path(prompts))]
    for model in models_of(config):
        name = parse_model(model)
        if name.kind == "replay":
            files.append(_digest(Path(name.model)))
        files.extend(model_digests(model).values())
    text = json.dumps([sections, files], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def _digest(path: Path) -> str:
    """Hash of a file, or of all files in a folder. Missing files are reported when they are used, not here."""
    digest = hashlib.sha256()
    try:
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file():
                digest.update(f"{file.relative_to(path)}\0".encode() + file.read_bytes() + b"\0")
    except OSError as error:
        raise InputError("model", str(path), f"a cassette, or a folder of prompts ({error.strerror})") from None
    return digest.hexdigest()


def parse_teams(text: str) -> list[tuple[str, int]]:
    """Read `SHAPE/N,SHAPE/N,...`, such as `triangle/6,circle/10`."""
    teams: list[tuple[str, int]] = []
    for part in text.split(","):
        shape, slash, count = part.strip().rpartition("/")
        if not (slash and shape and count.isascii() and count.isdecimal() and len(count) <= 9):
            raise InputError("cells", text, "SHAPE/N with commas between them, such as triangle/6,circle/10")
        teams.append((shape, int(count)))
    return teams


@contextmanager
def naming_team(field: str, team: str) -> Generator[None]:
    """Errors of a shape or a number of robots name where both were given: `field`, as `SHAPE/N`."""
    try:
        yield
    except InputError as error:
        if isinstance(error, FieldError) or error.field not in ("shape", "n_robots"):
            raise
        raise InputError(field, team, says=error.says) from None


def arena_of(load: Callable[..., RunConfig], fields: Mapping[str, Any]) -> tuple[Point, Point]:
    """The fitted arena of a configuration that may be refused for lack of room; `load` makes one of `fields`."""
    shape, n_robots = fields["shape"], fields["n_robots"]
    if not isinstance(shape, str) or type(n_robots) is not int or not 1 <= n_robots <= MAX_ROBOTS:
        raise InputError("team", f"{shape}/{n_robots}", f"SHAPE/N with N from 1 to {MAX_ROBOTS}")
    places = fields.get("places")
    if places is not None and (type(places) is not int or not 1 <= places <= MAX_ROBOTS):
        raise InputError("places", places, f"a number from 1 to {MAX_ROBOTS}")
    # A single robot without a shape fits everywhere, so the other settings can be read before the arena fits.
    alone = {"shape": "text:anything", "n_robots": 1, "kill": "", "join": "", "kill_random": 0, "join_random": 0}
    team = load(**{**fields, **alone, "changes": ()}).mission
    load_points(resolved := {"points": None, **fields})
    return fitted_arena(team, resolved["shape"], n_robots, resolved["points"])


def fitted_arena(
    team: Mission, shape: str, n_robots: int, points: Sequence[Point] | None = None
) -> tuple[Point, Point]:
    """The team's arena [units], grown where the formation in any orientation, and a spacing around it, need more room.

    Where random starts at the safe distance do not fit then, all walls move out to a cube in which they do.
    """
    center = np.array(team.center)
    ideal = formations.ideal_points(shape, team.places or n_robots, team.center, team.spacing, points)
    room = 0.0 if ideal is None else formations.circumradius(ideal, team.center) + team.spacing
    low, high = _grown(team, center, room)
    needed = team.start_volume(n_robots)
    if float(np.prod(high - low)) < needed:
        # A thousandth more, so that rounding cannot make it too small again.
        low, high = _grown(team, center, 1.001 * math.pow(needed, 1 / team.dim) / 2)
    return tuple(low.tolist()), tuple(high.tolist())


def _grown(team: Mission, center: Vector, room: float) -> tuple[Vector, Vector]:
    """Corners of the arena after moving each wall out to `room` from the centre."""
    low, high = (np.array(corner) for corner in team.arena)
    return np.minimum(low, center - room), np.maximum(high, center + room)
