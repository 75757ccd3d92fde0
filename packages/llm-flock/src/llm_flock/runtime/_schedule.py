"""What a run is to withstand: robots that die or join late, missions that change, sensors that err, obstacles."""

from __future__ import annotations

import itertools
import math
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any, Literal, Self, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from llm_flock.bounds import MAX_OBSTACLES, MAX_ORDER_BYTES, MAX_ORDERS, MAX_ROUNDS
from llm_flock.errors import InputError
from llm_flock.mission import MISSION_FIELDS, Coordinate, Mission
from llm_flock.obstacles import MovingObstacle
from llm_flock.shapes import names_file


class Stream(IntEnum):
    """The purpose of a stream of random numbers. Runs depend on these values, which never change."""

    START = 0
    LINKS = 1
    NOISE = 2
    MODEL = 3
    BACKOFF = 4
    FAULTS = 5


def stream(seed: int, purpose: Stream, robot: int = 0) -> np.random.Generator:
    """The generator for one purpose, and for one robot if each has its own."""
    return np.random.default_rng(np.random.SeedSequence([seed, int(purpose), robot]))


RANDOM_ROUNDS = 20
"""Random deaths and joins happen in a round from 1 to this: about twice the rounds that a team of ten needs to form."""


Turn: TypeAlias = tuple[int, int]  # a robot and a round


class Change(BaseModel):
    """A mission, or an order in words, given to one robot at the start of a round; the others receive it from there."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    round: Annotated[int, Field(ge=1)]
    robot: Annotated[int, Field(ge=0)]
    set: dict[str, Any] = Field(default_factory=dict)
    words: str = ""


class TrialConfig(BaseModel):
    """One seeded run: its length, starts and faults."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rounds: int | None = Field(
        default=None,
        ge=0,
        le=MAX_ROUNDS,
        description="Largest number of motion rounds [3 * lower bound + 20, from the last event on]",
    )
    stop_when_formed: bool = Field(default=True, description="End the run as soon as the formation has been held")
    seed: int = Field(default=0, ge=0, lt=2**63, description="Seed of starts, links, noise and simulated models")
    start: Literal["separated", "uniform", "connected"] = Field(
        default="separated",
        description="Random starts: at least safe_distance apart; uniform, as in the paper; or all in radio contact",
    )
    start_positions: tuple[tuple[Coordinate, ...], ...] | None = Field(
        default=None, description="Start positions, instead of random ones [units]"
    )
    start_area: tuple[tuple[Coordinate, ...], tuple[Coordinate, ...]] | None = Field(
        default=None, description="Two opposite corners of the area of random starts [the arena]"
    )
    kill: str | None = Field(
        default=None, description="Kill these robots, each at the start of a round: ID@ROUND,ID@ROUND,..."
    )
    join: str | None = Field(
        default=None, description="Let these robots join, or join again, at the start of a round: ID@ROUND,..."
    )
    battery: str | None = Field(
        default=None,
        description="Batteries that get weak at the start of a round, and how far these robots can fly from then on "
        "[units]: ID@ROUND:LENGTH,...",
    )
    kill_random: int = Field(default=0, ge=0, description="Kill this many more robots, drawn from the seed")
    join_random: int = Field(default=0, ge=0, description="Let this many more robots join late, drawn from the seed")
    changes: tuple[Change, ...] = Field(
        default=(),
        description="Give one robot another mission in flight: {round, robot, set: {field: value, ...}}; or, "
        "with --judge models, an order in words: {round, robot, words}",
    )
    noise: float = Field(default=0.0, ge=0, allow_inf_nan=False, description="Maximum localisation error [units]")
    drift: float = Field(
        default=0.0,
        ge=0,
        allow_inf_nan=False,
        description="Maximum offset of a robot's localisation, which wanders from round to round [units]",
    )
    sensing_delay: float = Field(
        default=0.0, ge=0, le=20, allow_inf_nan=False, description="Age of sensed positions of others [rounds]"
    )
    moving_obstacles: tuple[MovingObstacle, ...] = Field(
        default=(),
        max_length=MAX_OBSTACLES,
        description="Discs that fly along a path, and which robots evade: {center, radius, speed, path, since}",
    )
    out: str | None = Field(default=None, description="Folder for the record (run.mcap) and the figures drawn from it")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight:
    """The assumptions of Theorem 11a on positions, in docs/explanation/theory.md."""

    error: float = 0.0  #: Largest error of a position, half of that of a distance between two robots [units].
    rests: int = 0  #: Rounds in which all robots stand still after each one in which they may fly.

    @classmethod
    def of(cls, limits: Mission, error: float, delay: float) -> Self:
        """Bounds for positions with this error [units], and of others also with this delay [rounds].

        Others fly for less than a round after they were sensed. The margin covers that, or they rest for one round
        more, if the shield would have no room for that margin, or sensors do not reach far enough.
        """
        whole = math.floor(delay)
        unseen = (delay - whole) * limits.max_step
        most, needed = limits.safe_distance / 4, limits.height_apart + 2 * limits.max_step + 2 * unseen
        if unseen > 0.0 and (error + unseen / 2 > most or limits.sensing < needed):
            return cls(error=error, rests=whole + 1)
        return cls(error=error + unseen / 2, rests=whole)


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """Events at the start of rounds: by round, the robots that die or join, and the missions given."""

    asleep: frozenset[int]  # robots that are not awake at the start of the run
    kills: Mapping[int, tuple[int, ...]]
    joins: Mapping[int, tuple[int, ...]]  # for the first time or again
    missions: Mapping[int, tuple[tuple[int, Mission], ...]]  # in the order in which they are given
    weak: Mapping[int, tuple[tuple[int, float], ...]]  # robots, and how far
    orders: Mapping[int, tuple[tuple[int, str], ...]]  # in words
    crossed: int = 0  # the round in which the last moving obstacle comes to rest; 0 without any

    @property
    def last(self) -> int:
        """The round of the last event; 0 without any."""
        return max((*self.kills, *self.joins, *self.missions, *self.weak, *self.orders, self.crossed), default=0)


def build_schedule(mission: Mission, trial: TrialConfig) -> Schedule:
    """All events, checked as a whole.

    Robots that are named in no event die or join at random, each in a round from 1 to RANDOM_ROUNDS.
    """
    rounds, kill_random = MAX_ROUNDS if trial.rounds is None else trial.rounds, trial.kill_random
    killed = _turns("kill", trial.kill, mission.n_robots, rounds)
    joined = _turns("join", trial.join, mission.n_robots, rounds)
    named = {robot for robot, _ in (*killed, *joined)} | {change.robot for change in trial.changes}
    free = [robot for robot in range(mission.n_robots) if robot not in named]
    wanted = kill_random + trial.join_random
    if wanted > len(free) or (wanted and wanted == mission.n_robots):
        field, value = ("kill_random", kill_random) if kill_random else ("join_random", trial.join_random)
        most = min(len(free), mission.n_robots - 1)
        raise InputError(field, value, f"at most {most} robots that die or join at random, of those named nowhere else")
    if wanted:
        rng = stream(trial.seed, Stream.FAULTS)
        drawn = rng.permutation(free)[:wanted].tolist()
        whens = rng.integers(1, min(RANDOM_ROUNDS, max(1, rounds)) + 1, size=wanted).tolist()
        turns = list(zip(drawn, whens, strict=True))
        killed, joined = killed + turns[:kill_random], joined + turns[kill_random:]
    events = _events(mission.n_robots, killed, joined)
    asleep = _asleep(events)

    def awake(robot: int, when: int) -> bool:
        past = [field for number, field in events.get(robot, ()) if number <= when]
        return past[-1] == "join" if past else robot not in asleep

    missions, orders = _missions(mission, trial.changes, awake, rounds)
    crossed = _crossed(mission, trial.moving_obstacles)
    kills, joins = _by_round(killed), _by_round(joined)
    weak = _weak(mission, trial.battery, awake, rounds)
    return Schedule(
        asleep=asleep, kills=kills, joins=joins, missions=missions, weak=weak, orders=orders, crossed=crossed
    )


def _weak(
    mission: Mission, text: str | None, awake: Callable[[int, int], bool], rounds: int
) -> dict[int, tuple[tuple[int, float], ...]]:
    """By round, the robots whose batteries get weak then, each with the length that it can still fly [units]."""
    parts = [part.partition(":") for part in (text or "").split(",") if part.strip()]
    if not all(re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9})?", length.strip()) for _, _, length in parts):
        raise InputError("battery", text, "ID@ROUND:LENGTH with commas between them, such as 3@12:40,5@20:8.5")
    turns = _turns("battery", ",".join(turn for turn, _, _ in parts), mission.n_robots, rounds)
    weak = dict[int, tuple[tuple[int, float], ...]]()
    for (robot, when), (_, _, length) in zip(turns, parts, strict=True):
        if not awake(robot, when):
            raise InputError("battery", text, f"a robot that is awake in round {when}")
        weak[when] = (*weak.get(when, ()), (robot, float(length)))
    return weak


def _crossed(mission: Mission, moving: Sequence[MovingObstacle]) -> int:
    """The round in which the last of moving obstacles comes to rest, after checking them."""
    for one in moving:
        if {len(one.center), *map(len, one.path)} != {mission.dim}:
            allowed = f"{mission.dim} coordinates in each point, as the mission has"
            raise InputError("moving_obstacles", one.model_dump(), allowed)
        if one.end > MAX_ROUNDS:
            raise InputError("moving_obstacles", one.model_dump(), f"a path flown by round {MAX_ROUNDS:,}")
    return math.ceil(max((one.end for one in moving), default=0))


def _turns(field: str, text: str | None, n_robots: int, rounds: int) -> list[Turn]:
    """Read `ID@ROUND,ID@ROUND,...`."""
    turns: list[Turn] = []
    for part in (text or "").split(","):
        if not part.strip():
            continue
        robot, at, when = (piece.strip() for piece in part.partition("@"))
        if not (at and all(x.isascii() and x.isdecimal() and len(x) <= 9 for x in (robot, when))):
            raise InputError(field, text, "ID@ROUND with commas between them, such as 3@12,5@20")
        turns.append((int(robot), int(when)))
    for robot, when in turns:
        if robot >= n_robots:
            raise InputError(field, text, says=f"there is no robot {robot}, only robots 0 to {n_robots - 1}")
        if not 1 <= when <= rounds:
            raise InputError(field, text, f"rounds from 1 to {rounds}, the most that are flown; not {when}")
    return turns


def _by_round(turns: Sequence[Turn]) -> dict[int, tuple[int, ...]]:
    robots: defaultdict[int, tuple[int, ...]] = defaultdict(tuple)
    for robot, when in sorted(turns):
        robots[when] += (robot,)
    return dict(robots)


def _events(
    n_robots: int, killed: Sequence[Turn], joined: Sequence[Turn]
) -> dict[int, list[tuple[int, Literal["kill", "join"]]]]:
    """The rounds in which each robot dies and joins, in their order, which is checked."""
    events: defaultdict[int, list[tuple[int, Literal["kill", "join"]]]] = defaultdict(list)
    for robot, when in killed:
        events[robot].append((when, "kill"))
    for robot, when in joined:
        events[robot].append((when, "join"))
    steps: defaultdict[int, int] = defaultdict(int)
    for robot, turns in events.items():
        turns.sort()
        for (when, field), (later, other) in itertools.pairwise(turns):
            if when == later or field == other:
                allowed = "a robot that was killed before" if other == "join" else "a robot that is awake"
                raise InputError(other, f"{robot}@{later}", f"{allowed}, in a later round than round {when}")
        for when, field in turns:
            steps[when] += 1 if field == "join" else -1
    first = n_robots - len(_asleep(events))
    if min(itertools.accumulate((steps[when] for when in sorted(steps)), initial=first)) < 1:
        field, value = ("kill", sorted(killed)) if first else ("join", sorted(joined))
        raise InputError(field, value, "at least one robot that is awake, at any time")
    return events


def _asleep(events: Mapping[int, Sequence[tuple[int, str]]]) -> frozenset[int]:
    """Robots whose first event is to join."""
    return frozenset(robot for robot, turns in events.items() if turns[0][1] == "join")


def _missions(
    mission: Mission, changes: Sequence[Change], awake: Callable[[int, int], bool], rounds: int
) -> tuple[dict[int, tuple[tuple[int, Mission], ...]], dict[int, tuple[tuple[int, str], ...]]]:
    """The mission of each change, derived from the one in force in that round; and the orders in words."""
    missions: dict[int, tuple[tuple[int, Mission], ...]] = {}
    orders: dict[int, tuple[tuple[int, str], ...]] = {}
    for change in sorted(changes, key=lambda change: change.round):
        when, robot = change.round, change.robot
        value = change.model_dump()
        if robot >= mission.n_robots:
            raise InputError("changes", value, f"a robot from 0 to {mission.n_robots - 1}")
        if when > rounds:
            raise InputError("changes", value, f"a round from 1 to {rounds}, the most that are flown")
        if not awake(robot, when):
            raise InputError("changes", value, f"a robot that is awake in round {when}")
        if change.words or "set" not in change.model_fields_set:
            if change.set or not 0 < len(change.words.encode()) <= MAX_ORDER_BYTES:
                raise InputError("changes", value, f"set, or words of at most {MAX_ORDER_BYTES} bytes")
            orders[when] = (*orders.get(when, ()), (robot, change.words))
            continue
        fields = dict(change.set)
        try:
            if "since" in fields:
                says = "cannot be given: a changed mission counts from the round of the change"
                raise InputError("since", fields["since"], says=says)
            new = mission.at(when).change(**fields, since=when)
        except InputError as error:
            raise InputError("changes", value, says=str(error)) from error
        for field in Mission.model_fields:  # a robot's limits and surroundings are fixed
            if field not in MISSION_FIELDS and getattr(new, field) != getattr(mission, field):
                allowed = f"only fields that a robot accepts by radio ({', '.join(sorted(MISSION_FIELDS - {'since'}))})"
                raise InputError("changes", value, f"{allowed}, not {field}")
        missions[when], mission = (*missions.get(when, ()), (robot, new)), new
    if sum(map(len, orders.values())) > MAX_ORDERS:
        raise InputError("changes", len(changes), f"at most {MAX_ORDERS} orders in words")
    return missions, orders


def read_points(change: Any) -> Any:
    """A change as it was given, with what a file of its shape holds."""
    given: Any = change.model_dump() if isinstance(change, Change) else change
    fields: Any = given.get("set") if hasattr(given, "get") else None
    if not hasattr(fields, "get"):
        return change
    read = {**fields}
    load_points(read)
    return {**given, "set": read} if read != fields else change


def load_points(fields: dict[str, Any]) -> bool:
    """Replace `shape = "points:FILE"` by the points of that file; returns whether there was one.

    `program:FILE` and `outline:FILE` become the program of that file.
    """
    shape = fields.get("shape")
    if not names_file(shape):
        return False
    kind, _, name = (part.strip() for part in str(shape).partition(":"))
    if not name:
        raise InputError("shape", shape, f"{kind}:FILE, with the name of a file")
    if kind != "points":
        from llm_flock.formation import load_program

        fields["shape"] = load_program(name, "shape", (".svg",) if kind == "outline" else (".toml", ".json")).spec
        return False
    from llm_flock.point_files import load_points as read_file

    fields.update(shape="points", points=read_file(name, "shape"))
    return True
