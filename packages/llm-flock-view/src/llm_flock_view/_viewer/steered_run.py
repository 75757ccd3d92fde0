"""Simulated runs that fly while one watches: paced, paused, disturbed, and given other missions."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Collection, Mapping
from typing import Any

from llm_flock.errors import FieldError, FlockError, InputError, unknown
from llm_flock.events import Note
from llm_flock.llm import MissionDraft, habits_of
from llm_flock.mission import Mission
from llm_flock.record import DEAD
from llm_flock.runtime import (
    RunConfig,
    RunOrders,
    TeamPlanners,
    Trial,
    build_config,
    run_async,
    starts_of,
)
from llm_flock.shapes import names_file
from llm_flock_view._viewer.library import load
from llm_flock_view._viewer.recording import Recording

POLL_S = 0.02  # time between two checks of a paused run [s]

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
    "start_positions",
    "fallback",
    "gaps",
    "decide",
    "stop_when_formed",
)
"""Fields that a page may set. Fields that name files, modules, addresses or folders belong to the command line."""


def config_of(
    fields: Mapping[str, Any],
    models: Collection[str] = (),
    base_url: str | None = None,
    draft: MissionDraft | None = None,
) -> RunConfig:
    """The configuration of a run that a page asks for, checked as the command's; the operator typed the rest.

    The mission is that of the `draft`, if there is one.
    """
    given = {name: value for name, value in fields.items() if value not in (None, "")}
    if draft is not None:
        given = {name: value for name, value in given.items() if name not in Mission.model_fields}
    for name in given:
        if name not in FIELDS:
            raise FieldError(name, given[name], says=unknown(f"field {name!r}", name, FIELDS))
    if names_file(shape := given.get("shape")):
        raise InputError("shape", shape, "a shape with a name; only the command line reads files")
    model = given.get("model")
    # A list of models by robot ("0=...,1=...") is not split here: it must be allowed as a whole.
    if model is not None and model not in models and not _free(str(model)):
        allowed = "simulated:PROFILE, geometry or a packaged model, or a model that `llm-flock view --model` named"
        raise InputError("model", model, allowed)
    config = build_config({}, **given, base_url=base_url if model in models else None)
    config = config if draft is None else config.flying(draft.mission, draft.gaps)
    if _free(config.model.model):
        # These raise now what would otherwise only be raised when the run begins.
        TeamPlanners(config)
        starts_of(config)
    return config


def _free(model: str) -> bool:
    """Whether a page may use a model: it costs nothing, uses no network, and reads no file outside the package."""
    free = model == "geometry" or model.startswith("simulated:") or habits_of(model).contained
    return free and "=" not in model


def check_pace(pace: float) -> None:
    """Refuse a pace that is too slow or too fast to watch [rounds a second]."""
    if not 0.1 <= pace <= 100:
        raise InputError("pace", pace, "from 0.1 to 100 rounds a second")


class SteeredRun:
    """One simulated run in its own thread, recorded as any other. Orders take effect with the next round."""

    def __init__(self, config: RunConfig, recording: Recording, pace: float) -> None:
        self.config = config
        self.recording = recording
        self.pace = pace
        self.paused = False
        self.orders = RunOrders(config)
        self.over = False
        self.loss = config.links.loss
        self.confused: set[int] = set()  # robots whose models answer nonsense by order
        self._killed: set[int] = set()
        self._hallucinating: list[int] = []
        self._loss: float | None = None
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._due = 0.0

    def start(self) -> None:
        threading.Thread(target=self._fly, daemon=True).start()
        threading.Thread(target=load, args=(self.recording, lambda: self.over), daemon=True).start()

    def end(self) -> None:
        """End the run, paused or not; its record can be read."""
        self._check("end")
        self.paused = False
        self._end.set()

    @property
    def round(self) -> int:
        return self.orders.round

    @property
    def dead(self) -> frozenset[int]:
        """Robots that are dead, or will be with the next round."""
        states = self.recording.history.states
        phases = states[-1].phases if states else ()
        return frozenset(robot for robot, phase in enumerate(phases) if phase == DEAD) | self._killed

    def state(self) -> dict[str, Any]:
        """The orders that it takes now, the reasons why others are refused, and the orders so far."""
        robots = range(self.config.mission.n_robots)
        return {
            "kind": "run",
            "run": self.refusal("end"),
            "kill": [self.refusal("kill", robot) for robot in robots],
            "hallucinate": [self.refusal("hallucinate", robot) for robot in robots],
            "paused": self.paused,
            "pace": self.pace,
            "loss": self.loss,
        }

    def refusal(self, order: str, robot: int | None = None) -> str | None:
        """Why an order makes no sense now, as a sentence; None if it does. `kill` and `hallucinate` name a robot."""
        if self.over or self._end.is_set():
            return "The run is over: it takes no more orders."
        if robot is None:
            return None
        if not 0 <= robot < self.config.mission.n_robots:
            return f"There is no robot {robot}: the team has robots 0 to {self.config.mission.n_robots - 1}."
        if robot in self.dead:
            return f"Robot {robot} is dead."
        if order == "hallucinate" and robot in self.confused:
            return f"The model of robot {robot} answers nonsense already."
        if order == "kill" and len(self.dead) == self.config.mission.n_robots - 1:
            return f"Robot {robot} is the last one alive."
        return None

    def _check(self, order: str, robot: int | None = None) -> None:
        says = self.refusal(order, robot)
        if says is not None:
            raise FieldError("run" if robot is None else "robot", robot, says=says)

    def hold(self, paused: bool) -> None:
        self._check("pause")
        self.paused = paused

    def set_pace(self, pace: float) -> None:
        self._check("pace")
        check_pace(pace)
        self.pace = pace

    def kill(self, robot: int) -> None:
        """Kill a robot; see `RunOrders.kill`."""
        self._check("kill", robot)
        self.orders.kill(robot)
        self._killed.add(robot)

    def change(self, fields: dict[str, Any]) -> int:
        """Give one robot another mission, and return that robot; see `RunOrders.change`."""
        self._check("change")
        return self.orders.change(fields)

    def proceed(self) -> int:
        """Order the next stage of the mission; see `RunOrders.proceed`."""
        self._check("proceed")
        return self.orders.proceed()

    def lose(self, share: float) -> None:
        self._check("lose")
        if not 0.0 <= share <= 1.0:
            raise InputError("loss", share, "a share from 0 to 1")
        with self._lock:
            self._loss = self.loss = share

    def hallucinate(self, robot: int) -> None:
        """Replace a robot's model by one that answers nonsense."""
        self._check("hallucinate", robot)
        with self._lock:
            self._hallucinating.append(robot)
            self.confused.add(robot)

    def _fly(self) -> None:
        try:
            asyncio.run(self._run())
        except (FlockError, OSError) as error:
            self.recording.fail(error)
        finally:
            self.over = True

    async def _run(self) -> None:
        work = asyncio.create_task(run_async(config=self.config, steer=self._steer, progress=False, trace=False))
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
        self.orders.carry_out(trial)
        with self._lock:
            hallucinating, self._hallucinating = self._hallucinating, []
            loss, self._loss = self._loss, None
        for robot in hallucinating:
            trial.planners.replace(robot, HALLUCINATING)
            trial.journal.note(self.round, None, robot, Note("injected", {"model": HALLUCINATING, "loss": None}))
        if loss is not None:
            trial.transport.faults = trial.transport.faults.model_copy(update={"loss": loss})
            for robot in trial.roster.awake:
                trial.journal.note(self.round, None, robot, Note("injected", {"model": None, "loss": loss}))
