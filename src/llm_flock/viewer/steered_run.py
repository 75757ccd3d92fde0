"""Simulated runs that fly while one watches: paced, paused, disturbed, and given other missions."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Collection, Mapping
from typing import Any

from llm_flock.errors import FlockError, InputError
from llm_flock.llm.local.weights import is_packaged
from llm_flock.protocol.events import Note
from llm_flock.robots.simulated import draw_start
from llm_flock.runtime.api import run_async
from llm_flock.runtime.config import RunConfig, build_config
from llm_flock.runtime.planners import TeamPlanners
from llm_flock.runtime.schedule import Change, build_schedule
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.trial import Trial
from llm_flock.viewer.library import load
from llm_flock.viewer.recording import Recording

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

    Values of None and "" are not given; `models` cost money or reach out, and the operator allowed them.

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
        draw_start(config.mission, config.trial.start, stream(config.trial.seed, Stream.START), config.trial.start_area)
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


class SteeredRun:
    """One simulated run in its own thread, recorded as any other. Orders take effect with the next round.

    Attributes:
        pace: rounds a second.
        paused: set it to hold the run before its next round.
        round: the round in flight.
    """

    def __init__(self, config: RunConfig, recording: Recording, pace: float) -> None:
        self.config = config
        self.recording = recording
        self.pace = pace
        self.paused = False
        self.round = 0
        self.over = False
        self._kills: list[str] = []
        self._changes: list[Change] = []
        self._schedule = config.schedule()
        self._hallucinating: list[int] = []
        self._loss: float | None = None
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._due = 0.0

    def start(self) -> None:
        """Start the run, and the thread that reads its record."""
        threading.Thread(target=self._fly, daemon=True).start()
        threading.Thread(target=load, args=(self.recording, lambda: self.over), daemon=True).start()

    def end(self) -> None:
        """End the run, paused or not; its record can be read."""
        self.paused = False
        self._end.set()

    def kill(self, robot: int) -> None:
        """Kill a robot.

        Raises:
            InputError: there is no such robot, it is dead, or it is the last one.
        """
        with self._lock:
            self._reschedule([*self._kills, f"{robot}@{self.round + 1}"], self._changes)

    def change(self, fields: dict[str, Any]) -> int:
        """Change fields of the mission of one robot, and return that robot; the others hear of it from there.

        Raises:
            InputError: the mission cannot be changed like that.
        """
        check_shape(fields.get("shape"))
        with self._lock:
            dead = {int(kill.partition("@")[0]) for kill in self._kills}
            taker = next(k for k in range(self.config.mission.n_robots) if k not in dead)
            change = Change(round=self.round + 1, robot=taker, set=fields)
            # A second mission for the next round replaces the first.
            before = [one for one in self._changes if one.round <= self.round]
            self._reschedule(self._kills, [*before, change])
            return taker

    def lose(self, share: float) -> None:
        """Lose this share of the messages.

        Raises:
            InputError: it is no share.
        """
        if not 0.0 <= share <= 1.0:
            raise InputError("loss", share, "a share from 0 to 1")
        with self._lock:
            self._loss = share

    def hallucinate(self, robot: int) -> None:
        """Replace a robot's model by one that answers nonsense.

        Raises:
            InputError: there is no such robot.
        """
        if not 0 <= robot < self.config.mission.n_robots:
            raise InputError("robot", robot, f"robots from 0 to {self.config.mission.n_robots - 1}")
        with self._lock:
            self._hallucinating.append(robot)

    def _reschedule(self, kills: list[str], changes: list[Change]) -> None:
        """Take everything that happened and is ordered, if it is as the command line allows it."""
        events = {"kill": ",".join(kills), "join": None, "kill_random": 0, "join_random": 0, "changes": tuple(changes)}
        self._schedule = build_schedule(self.config.mission, self.config.trial.model_copy(update=events))
        self._kills, self._changes = kills, changes

    def _fly(self) -> None:
        try:
            asyncio.run(self._run())
        except (FlockError, OSError) as error:
            self.recording.fail(error)
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
            self.round = trial.round + 1
            trial.schedule = self._schedule
            hallucinating, self._hallucinating = self._hallucinating, []
            loss, self._loss = self._loss, None
        for robot in hallucinating:
            trial.planners.replace(robot, HALLUCINATING)
            trial.journal.note(self.round, None, robot, Note("injected", {"model": HALLUCINATING, "loss": None}))
        if loss is not None:
            trial.transport.faults = trial.transport.faults.model_copy(update={"loss": loss})
            for robot in trial.roster.awake:
                trial.journal.note(self.round, None, robot, Note("injected", {"model": None, "loss": loss}))
