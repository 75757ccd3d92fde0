"""Orders to a run in flight, to kill a robot or to give it another mission. They take effect in the next round."""

from __future__ import annotations

import threading
from typing import Any

from llm_flock.errors import InputError
from llm_flock.mission import MISSION_FIELDS, OPTIONAL
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._schedule import Change, build_schedule
from llm_flock.runtime._trial import Trial


class RunOrders:
    """Takes orders from any thread, and carries them out between two rounds.

    `round` is the one in flight, `mission` the one in force or ordered for the next, `drawn` the program that a robot
    follows, if any.
    """

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._schedule = schedule = config.schedule()
        # List all events: a robot that an order names must not change the random draw of others.
        self._kills = [f"{robot}@{when}" for when, robots in schedule.kills.items() for robot in robots]
        self._joins = [f"{robot}@{when}" for when, robots in schedule.joins.items() for robot in robots]
        self._changes = list(config.trial.changes)
        self._ordered_rounds: set[int] = set()
        self._awake = [k for k in range(config.mission.n_robots) if k not in schedule.asleep]
        self._lock = threading.Lock()
        self.mission, self.drawn, self.round = config.mission, "", 0

    def kill(self, robot: int) -> None:
        """Kill a robot that is alive, and not the last one."""
        with self._lock:
            self._reschedule([*self._kills, f"{robot}@{self.round + 1}"], self._changes)

    def proceed(self) -> int:
        """Order the next stage of the mission in force, as `change` does."""
        return self.change(self.mission.proceeding())

    def change(self, fields: dict[str, Any]) -> int:
        """Change fields of the mission of one robot, and return that robot. It tells the others."""
        with self._lock:
            when = self.round + 1
            if fixed := sorted(fields.keys() - MISSION_FIELDS | fields.keys() & {"since"}):
                allowed = ", ".join(sorted(MISSION_FIELDS - {"since"}))
                raise InputError("changes", fixed, f"only fields that a robot accepts by radio ({allowed})")
            # The schedule knows neither stages that robots have gone on to, nor an order that this one replaces.
            changed = self.mission.at(when).change(**fields, since=when)
            fields = {**OPTIONAL, **changed.model_dump(include=set(MISSION_FIELDS - {"since"}))}
            dead = self._schedule.kills.get(when, ())
            taker = next(robot for robot in self._awake if robot not in dead)
            # A second order for the next round changes the first; the configuration's own changes stay.
            before = [one for one in self._changes if one.round != when or when not in self._ordered_rounds]
            try:
                self._reschedule(self._kills, [*before, Change(round=when, robot=taker, set=fields)])
            except InputError as error:
                # The sender of the order knows the fields of a mission, but not the list of changes.
                raise (error.__cause__ if isinstance(error.__cause__, InputError) else error) from None
            self._ordered_rounds.add(when)
            self.mission, self.drawn = changed, self.drawn if changed.shape == self.mission.shape else ""
            return taker

    def carry_out(self, trial: Trial) -> None:
        """Carry out the orders. Call before each round."""
        with self._lock:
            self.round = trial.round + 1
            self._awake = list(trial.roster.awake)
            given = self._schedule.missions.get(self.round)
            self.mission = given[-1][1] if given else trial.mission.at(trial.round)
            plan = trial.roster.agents[self._awake[0]].plan
            self.drawn = "" if plan is None or self.mission.shape != trial.mission.shape else plan.program
            trial.schedule = self._schedule

    def _reschedule(self, kills: list[str], changes: list[Change]) -> None:
        """Take everything that happened and is ordered, if it is as the command line allows it."""
        events = {"kill_random": 0, "join_random": 0, "changes": tuple(changes)}
        lists = {"kill": ",".join(kills) or None, "join": ",".join(self._joins) or None}
        schedule = build_schedule(self._config.mission, self._config.trial.model_copy(update=events | lists))
        self._config.check_missions(*(mission for orders in schedule.missions.values() for _, mission in orders))
        self._schedule = schedule
        self._kills, self._changes = kills, changes
