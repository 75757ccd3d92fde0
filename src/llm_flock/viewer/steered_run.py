"""Simulated runs that fly while one watches: paced, paused, disturbed, and given other missions."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from llm_flock.errors import FlockError, InputError
from llm_flock.llm.local.weights import is_packaged
from llm_flock.protocol.events import Note
from llm_flock.robots.simulated import draw_start
from llm_flock.runtime.api import RECORD_NAME, run_async
from llm_flock.runtime.config import RunConfig, build_config
from llm_flock.runtime.planners import TeamPlanners
from llm_flock.runtime.schedule import Change, Schedule, build_schedule
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.trial import Trial
from llm_flock.viewer.library import load
from llm_flock.viewer.recording import Recording

logger = logging.getLogger(__name__)

POLL_S = 0.02
"""Time between two checks of a paused run [s]."""

HALLUCINATING = "simulated:collapse,distorted,malformed@0.3"
"""Replaces the model of a robot that is made to hallucinate."""

FIELDS: tuple[str, ...] = (
    "shape",
    "n_robots",
    "center",
    "spacing",
    "model",
    "protocol",
    "seed",
    "rounds",
    "loss",
    "start",
    "fallback",
    "gaps",
    "decide",
    "stop_when_formed",
)
"""Fields that a page may set. Fields that name files, modules, addresses or folders belong to the command line."""


def config_of(fields: Mapping[str, Any], models: Collection[str] = ()) -> RunConfig:
    """The configuration of a run that a page asks for, checked as the command line checks it.

    Args:
        fields: values by field name; None and "" mean: not given.
        models: models that cost money or reach out, and that the operator allowed on the command line.

    Raises:
        InputError: a value is not allowed, here or anywhere.
    """
    given = {name: value for name, value in fields.items() if value not in (None, "")}
    for name in given:
        if name not in FIELDS:
            raise InputError(name, given[name], f"one of the fields of this page: {', '.join(FIELDS)}")
    check_shape(given.get("shape"))
    model = given.get("model")
    # A list of models by robot ("0=...,1=...") is not split here: it must be allowed as a whole.
    if model is not None and model not in models and not _free(str(model)):
        allowed = "simulated:PROFILE, geometry or local:smollm2, or a model that `llm-flock view --model` named"
        raise InputError("model", model, allowed)
    config = build_config({}, **given)
    if _free(config.model.model):
        # These raise now what would otherwise only be raised when the run begins.
        TeamPlanners(config)
        draw_start(config.mission, config.trial.start, stream(config.trial.seed, Stream.START))
    return config


def check_shape(shape: object) -> None:
    """Refuse a shape that is read from a file.

    Raises:
        InputError: it is one.
    """
    if isinstance(shape, str) and shape.strip().startswith("points:"):
        raise InputError("shape", shape, "a shape with a name; pages read no files")


def _free(model: str) -> bool:
    """Whether a page may use a model: it costs nothing, uses no network, and reads no file outside the package."""
    provider, _, name = model.partition(":")
    packaged = provider == "local" and is_packaged(name)
    return "=" not in model and (model == "geometry" or provider == "simulated" or packaged)


@dataclass(slots=True)
class _Orders:
    """Orders that came since the last round."""

    kills: list[int] = field(default_factory=list[int])
    change: Change | None = None
    hallucinating: list[int] = field(default_factory=list[int])
    loss: float | None = None


class SteeredRun:
    """One simulated run in its own thread, recorded as any other. Orders take effect with the next round.

    Args:
        config: the run; its `out` is the folder of the record.
        recording: shows it.
        pace: rounds a second.

    Attributes:
        paused: set it to hold the run before its next round.
        round: the round in flight.
        over: whether the run has ended.
    """

    def __init__(self, config: RunConfig, recording: Recording, pace: float = 4.0) -> None:
        self.config = config
        self.recording = recording
        self.pace = pace
        self.paused = False
        self.round = 0
        self.over = False
        self._kills: list[str] = []
        self._changes: list[Change] = []
        self._orders = _Orders()
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._due = 0.0

    @property
    def path(self) -> Path:
        """Its record."""
        return Path(str(self.config.trial.out)) / RECORD_NAME

    def start(self) -> None:
        """Start the run, and the thread that reads its record."""
        threading.Thread(target=self._fly, daemon=True).start()
        options = {"live": True, "stopped": lambda: self.over}
        threading.Thread(target=load, args=(self.path, self.recording), kwargs=options, daemon=True).start()

    def end(self) -> None:
        """End the run, paused or not; its record can be read."""
        self.paused = False
        self._end.set()

    # ---------------------------------------------------------------- orders

    def kill(self, robot: int) -> None:
        """Kill a robot.

        Raises:
            InputError: there is no such robot, it is dead, or it is the last one.
        """
        with self._lock:
            kills = [f"{k}@{self.round + 1}" for k in [*self._orders.kills, robot]]
            self._schedule([*self._kills, *kills], self._changes)
            self._orders.kills.append(robot)

    def change(self, fields: dict[str, Any]) -> int:
        """Give another mission to one robot; the others hear of it from there.

        Args:
            fields: the fields that change.

        Returns:
            The robot that gets it.

        Raises:
            InputError: the mission cannot be changed like that.
        """
        check_shape(fields.get("shape"))
        with self._lock:
            dead = {int(kill.partition("@")[0]) for kill in self._kills} | set(self._orders.kills)
            taker = next(k for k in range(self.config.mission.n_robots) if k not in dead)
            change = Change(round=self.round + 1, robot=taker, set=fields)
            self._schedule(self._kills, [*self._changes, change])
            self._orders.change = change
            return taker

    def lose(self, share: float) -> None:
        """Lose this share of the messages.

        Raises:
            InputError: it is no share.
        """
        if not 0.0 <= share <= 1.0:
            raise InputError("loss", share, "a share from 0 to 1")
        with self._lock:
            self._orders.loss = share

    def hallucinate(self, robot: int) -> None:
        """Replace a robot's model by one that answers nonsense.

        Raises:
            InputError: there is no such robot.
        """
        if not 0 <= robot < self.config.mission.n_robots:
            raise InputError("robot", robot, f"robots from 0 to {self.config.mission.n_robots - 1}")
        with self._lock:
            self._orders.hallucinating.append(robot)

    def _schedule(self, kills: Sequence[str], changes: Sequence[Change]) -> Schedule:
        """Everything that happened and is ordered, checked as the command line checks it."""
        events = {"kill": ",".join(kills), "join": None, "kill_random": 0, "join_random": 0, "changes": tuple(changes)}
        return build_schedule(self.config.mission, self.config.trial.model_copy(update=events))

    # ---------------------------------------------------------------- in flight

    def _fly(self) -> None:
        try:
            asyncio.run(self._run())
        except (FlockError, OSError) as error:
            self.recording.failure = str(error)
            logger.warning("%s", error)
        finally:
            self.over = True

    async def _run(self) -> None:
        work = asyncio.create_task(run_async(config=self.config, steer=self._steer))
        while not work.done():
            await asyncio.wait({work}, timeout=0.1)
            if self._end.is_set():
                work.cancel()
        if not work.cancelled():
            work.result()

    async def _steer(self, trial: Trial) -> None:
        """Wait until the next round is due, then carry out the orders."""
        while time.monotonic() < self._due or self.paused:  # noqa: ASYNC110 - `paused` is set in another thread
            await asyncio.sleep(POLL_S)
        self._due = time.monotonic() + 1.0 / self.pace
        with self._lock:
            orders, self._orders = self._orders, _Orders()
            self.round = trial.round + 1
            self._kills += [f"{robot}@{self.round}" for robot in orders.kills]
            if orders.change is not None:
                self._changes.append(orders.change.model_copy(update={"round": self.round}))
            if orders.kills or orders.change is not None:
                trial.schedule = self._schedule(self._kills, self._changes)
        for robot in orders.hallucinating:
            trial.planners.replace(robot, HALLUCINATING)
            self._note(trial, robot, model=HALLUCINATING)
        if orders.loss is not None:
            trial.transport.faults = trial.transport.faults.model_copy(update={"loss": orders.loss})
            for robot in trial.roster.awake:
                self._note(trial, robot, loss=orders.loss)

    def _note(self, trial: Trial, robot: int, *, model: str | None = None, loss: float | None = None) -> None:
        """Record a fault that was injected from outside."""
        trial.journal.note(self.round, None, robot, Note("injected", {"model": model, "loss": loss}))
