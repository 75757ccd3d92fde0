"""Simulated runs that are flown while one watches: paced, paused, disturbed and given other missions."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from llm_flock.errors import FlockError, InputError
from llm_flock.protocol.events import Note
from llm_flock.runtime.api import RECORD_NAME, run_async
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.schedule import Change, Schedule, build_schedule
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.trial import Trial
from llm_flock.viewer.form import check_shape
from llm_flock.viewer.gallery import play
from llm_flock.viewer.reel import Reel

logger = logging.getLogger(__name__)

LOOK_S = 0.02
"""So often a paused run looks whether it may go on [s]."""

HALLUCINATING = "simulated:collapse,distorted,malformed@0.3"
"""What answers in place of the model of a robot that is made to hallucinate."""


@dataclass(slots=True)
class Orders:
    """What was asked for since the last round."""

    kills: list[int] = field(default_factory=list[int])
    change: Change | None = None
    liars: list[int] = field(default_factory=list[int])
    loss: float | None = None


class Flight:
    """One simulated run in a thread of its own, recorded as any other.

    Args:
        config: what is flown; its `out` is the folder of the record.
        reel: shows it.
        pace: rounds a second.
    """

    def __init__(self, config: RunConfig, reel: Reel, pace: float = 4.0) -> None:
        self.config = config
        self.reel = reel
        self.pace = pace
        self.paused = False
        self.round = 0
        self.over = False
        self._kill: list[str] = []
        self._changes: list[Change] = []
        self._orders = Orders()
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._due = 0.0

    @property
    def path(self) -> Path:
        """Its record."""
        return Path(str(self.config.trial.out)) / RECORD_NAME

    def start(self) -> None:
        """Take off."""
        threading.Thread(target=self._fly, daemon=True).start()
        read = {"live": True, "stopped": lambda: self.over}
        threading.Thread(target=play, args=(self.path, self.reel), kwargs=read, daemon=True).start()

    def end(self) -> None:
        """Bring the run to its end, with a record that can be read."""
        self._end.set()

    # ---------------------------------------------------------------- orders

    def kill(self, robot: int) -> None:
        """From the next round on, the robot is dead.

        Raises:
            InputError: there is no such robot, it is dead, or it is the last one.
        """
        with self._lock:
            self._schedule([*self._kill, *(f"{k}@{self._next}" for k in [*self._orders.kills, robot])], self._changes)
            self._orders.kills.append(robot)

    def change(self, fields: dict[str, Any], robot: int | None = None) -> int:
        """Give a mission to one robot; the others hear of it from there.

        Args:
            fields: what changes.
            robot: who is told; any that is awake if left out.

        Returns:
            The robot that is told.

        Raises:
            InputError: the mission cannot be changed like that.
        """
        check_shape(fields.get("shape"))
        with self._lock:
            dead = {int(turn.partition("@")[0]) for turn in self._kill} | set(self._orders.kills)
            alive = [k for k in range(self.config.mission.n_robots) if k not in dead]
            taker = robot if robot is not None else alive[0]
            change = Change(round=self._next, robot=taker, set=fields)
            self._schedule(self._kill, [*self._changes, change])
            self._orders.change = change
            return taker

    def lose(self, share: float) -> None:
        """From the next round on, so many of the messages are lost."""
        if not 0.0 <= share <= 1.0:
            raise InputError("loss", share, "a share from 0 to 1")
        with self._lock:
            self._orders.loss = share

    def hallucinate(self, robot: int) -> None:
        """From the next round on, nonsense answers in place of the robot's model."""
        if not 0 <= robot < self.config.mission.n_robots:
            raise InputError("robot", robot, f"robots from 0 to {self.config.mission.n_robots - 1}")
        with self._lock:
            self._orders.liars.append(robot)

    @property
    def _next(self) -> int:
        return self.round + 1

    def _schedule(self, kill: Sequence[str], changes: Sequence[Change]) -> Schedule:
        """All that was and is to happen, checked as the command line checks it."""
        trial = self.config.trial
        return build_schedule(
            self.config.mission,
            kill=",".join(kill),
            join=None,
            kill_random=0,
            join_random=0,
            changes=changes,
            rounds=trial.rounds,
            rng=stream(trial.seed, Stream.FAULTS),
        )

    # ---------------------------------------------------------------- in flight

    def _fly(self) -> None:
        try:
            asyncio.run(self._run())
        except (FlockError, OSError) as error:
            self.reel.failure = str(error)
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
        """Wait for the next round's time, then hand the trial its orders."""
        while time.monotonic() < self._due or self.paused:  # noqa: ASYNC110 - the one who waits is in another thread
            await asyncio.sleep(LOOK_S)
        self._due = time.monotonic() + 1.0 / self.pace
        with self._lock:
            orders, self._orders = self._orders, Orders()
            self.round = trial.round + 1
            self._kill += [f"{robot}@{self.round}" for robot in orders.kills]
            if orders.change is not None:
                self._changes.append(orders.change.model_copy(update={"round": self.round}))
            if orders.kills or orders.change is not None:
                trial.schedule = self._schedule(self._kill, self._changes)
        for robot in orders.liars:
            trial.planners.replace(robot, HALLUCINATING)
            self._injected(trial, robot, model=HALLUCINATING)
        if orders.loss is not None:
            trial.transport.faults = trial.transport.faults.model_copy(update={"loss": orders.loss})
            for robot in trial.roster.awake:
                self._injected(trial, robot, loss=orders.loss)

    def _injected(self, trial: Trial, robot: int, *, model: str | None = None, loss: float | None = None) -> None:
        """The record says what was done to a robot from outside."""
        trial.journal.note(self.round, None, robot, Note("injected", {"model": model, "loss": loss}))
