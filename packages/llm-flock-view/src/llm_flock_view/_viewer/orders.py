"""Orders of pages, as one JSON object each: start and steer runs, read a described mission, delete a record."""

from __future__ import annotations

import asyncio
import re
import secrets
import threading
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from llm_flock.arrays import MAX_COORDINATE
from llm_flock.errors import FieldError, FlockError, InputError
from llm_flock.formation import Program, parse_program
from llm_flock.mission import Mission, build_mission
from llm_flock.printable import printable
from llm_flock_view._viewer.deletion import delete_record
from llm_flock_view._viewer.library import Library

if TYPE_CHECKING:
    from llm_flock.llm import MissionDraft
    from llm_flock_view._viewer.launcher import Launcher
    from llm_flock_view._viewer.steered_run import SteeredRun
    from llm_flock_view._viewer.swarm import SwarmSource

LABELS: Mapping[str, str] = {
    "shape": "Shape",
    "n_robots": "Robots",
    "center": "Centre",
    "spacing": "Spacing",
    "protocol": "Protocol",
    "model": "Model",
    "seed": "Seed",
    "rounds": "Rounds at most",
    "gaps": "Places of the dead",
    "loss": "Messages lost",
    "start": "Starts",
    "start_positions": "Starts",
    "pace": "Rounds a second",
    "words": "Mission in words",
}
"""Fields of the pages' forms by their names in the configuration."""

GIVEN = "Robot {} has the mission; the others hear of it from there."

NO_ORDERS = "this run takes no orders: it was not started from the page"

MAX_DRAFTS = 20  #: Missions in words that wait for their confirmation.

_NAME = re.compile(rf"(?<![\w.])({'|'.join(LABELS)})(?= =)|^({'|'.join(LABELS)})(?=:)")


class PageOrders:
    """Carries out what pages order; `swarm` is the one that is watched, None without one."""

    def __init__(self, library: Library, launcher: Launcher, swarm: SwarmSource | None = None) -> None:
        self.library = library
        self.launcher = launcher
        self.swarm = swarm
        self._deleting = threading.Lock()
        self._drafts: dict[str, MissionDraft] = {}

    async def carry_out(self, asked: object) -> dict[str, Any]:
        """Carry out an order, of which nothing is trusted; returns `done` as text, or `error` and its `field`."""
        order = cast("dict[str, Any]", asked if isinstance(asked, dict) else {})
        try:
            return await self._order(order)
        except FlockError as error:
            # A form shows what is wrong at the field; what a model made of plain words has none.
            field = error.field if isinstance(error, InputError) and order.get("order") != "read" else None
            # Neither form has a field for the arena: the centre is what moves a formation away from its walls.
            field = "center" if field == "arena" else field
            said = printable(_in_form_words(error, at_field=field is not None))
            # In flight the number of robots is as it is: another shape is what can be chosen.
            if field == "n_robots" and isinstance(error, InputError) and order.get("order") == "change":
                field, said = "shape", f"{said}; this team has {printable(str(error.value))}"
            return {"error": said, "field": field if field is None else printable(field)}

    async def _order(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        order = asked.get("order")
        if order == "start":
            return await asyncio.to_thread(self._start, asked)
        if order == "preview":
            return await asyncio.to_thread(self._preview, asked.get("fields"))
        if order == "read":
            return await self._read(asked)
        if order == "delete":
            return await asyncio.to_thread(self._delete, str(asked.get("run")))
        keys = _keys(asked.get("runs"))
        if order in ("change", "proceed") and self.swarm is not None and keys == [self.swarm.recording.key]:
            fields = self._present(keys)[0].proceeding() if order == "proceed" else self._fields(asked, spacing=False)
            return {"done": GIVEN.format(await self.swarm.team.give(fields))}
        return await asyncio.to_thread(self._steer, str(order), keys, asked)

    def _start(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        fields, protocols = asked.get("fields"), asked.get("protocols")
        if not isinstance(fields, dict):
            raise FieldError("fields", None, says="a start needs the fields of its run")
        pace = _number("pace", asked.get("pace"))
        self.launcher.loaded()
        from llm_flock_view._viewer.steered_run import check_pace

        check_pace(pace)
        _check_center(cast("dict[str, Any]", fields).get("center"), space=False)
        names = None if protocols is None else [str(name) for name in _list(protocols)]
        if names is not None and not 1 <= len(names) <= 2:
            raise FieldError("protocols", None, says="a start needs one protocol or two")
        draft = None if asked.get("draft") is None else self._draft(asked)
        started = self.launcher.start(cast("dict[str, Any]", fields), pace=pace, protocols=names, draft=draft)
        where = "run" if len(started) == 1 else "pair"
        return {"address": "/".join(["", where, *(one.recording.key for one in started)])}

    def _preview(self, fields: object) -> dict[str, Any]:
        """Arena, starts and places of a run of the form's fields, which does not fly yet [units]."""
        self.launcher.loaded()
        from llm_flock.runtime import starts_of
        from llm_flock_view._viewer.steered_run import config_of

        if not isinstance(fields, dict):
            raise FieldError("fields", None, says="a picture needs the fields of a run")
        config = config_of(cast("dict[str, Any]", fields), self.launcher.models, self.launcher.base_url)
        mission = config.mission
        return {
            "arena": mission.arena,
            "center": mission.center,
            "safe": mission.safe_distance,
            "starts": starts_of(config).round(1).tolist(),
            "places": mission.ideal or (),
        }

    async def _read(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """What a model makes of words, for a new run, or for one in flight; it is kept until it is confirmed."""
        reader, words, keys = self.launcher.reader, str(asked.get("words") or ""), _keys(asked.get("runs"))
        if reader is None:
            raise FieldError("words", None, says="no model reads missions: start the viewer with --model")
        base, drawn = self._present(keys) if keys else (Mission(), None)
        if asked.get("edit") is True:
            draft = await reader.edit(words, base, drawn)
        else:
            draft = await reader.read(words, base, flying=bool(keys))
        key = secrets.token_hex(8)
        self._drafts = {**dict([*self._drafts.items()][-MAX_DRAFTS:]), key: draft}
        return {"draft": key, "in_words": printable(draft.in_words)}

    def _present(self, keys: Sequence[str]) -> tuple[Mission, Program | None]:
        """The mission that a run or the watched swarm flies now, and what the robots drew for it, if they did."""
        if self.swarm is not None and [*keys] == [self.swarm.recording.key] and self.swarm.recording.history.missions:
            return build_mission(**self.swarm.recording.history.missions[-1].mission), None
        run = next((self.launcher.runs[key] for key in keys if key in self.launcher.runs), None)
        if run is None:
            raise FieldError("run", None, says=NO_ORDERS)
        return run.orders.mission, parse_program(run.orders.drawn) if run.orders.drawn else None

    def _draft(self, asked: Mapping[str, Any]) -> MissionDraft:
        draft = self._drafts.get(str(asked.get("draft")))
        if draft is None:
            raise FieldError("words", None, says="what the model made of the words is no longer known: read them again")
        return draft

    def _fields(self, asked: Mapping[str, Any], *, spacing: bool) -> dict[str, Any]:
        """The fields of another mission: those of a draft, or of the form."""
        if asked.get("draft") is not None:
            return dict(self._draft(asked).fields)
        return _mission_fields(asked.get("fields"), spacing=spacing)

    def _delete(self, key: str) -> dict[str, Any]:
        with self._deleting:
            run = self.library.runs.get(key)
            if run is None:
                raise FieldError("run", None, says="there is no such record")
            delete_record(run)
            self.library.remove(key)
        return {"done": f"{printable(run.title)} is deleted."}

    def _steer(self, order: str, keys: Sequence[str], asked: Mapping[str, Any]) -> dict[str, Any]:
        """Give an order to every run that is not over; nothing is done where none takes it."""
        runs = [self.launcher.runs[key] for key in keys if key in self.launcher.runs]
        if not runs:
            raise FieldError("run", None, says=NO_ORDERS)
        if order == "change":
            asked = {**asked, "fields": self._fields(asked, spacing=True)}
        flying = [run for run in runs if run.refusal("end") is None] or runs
        replies = [_give(run, order, asked) for run in flying]
        return {"done": f"{replies[0]} (round {flying[0].round + 1})"}


def _give(run: SteeredRun, order: str, asked: Mapping[str, Any]) -> str:
    match order:
        case "kill":
            run.kill(robot := _whole("robot", asked.get("robot")))
            return f"Robot {robot} dies."
        case "hallucinate":
            run.hallucinate(robot := _whole("robot", asked.get("robot")))
            return f"The model of robot {robot} answers nonsense from now on."
        case "lose":
            run.lose(share := _number("loss", asked.get("loss")))
            return f"{share:.0%} of the messages are lost."
        case "pace":
            run.set_pace(pace := _number("pace", asked.get("pace")))
            return f"The run flies {pace:g} rounds a second."
        case "hold":
            run.hold(paused := _true_or_false("paused", asked.get("paused")))
            return "The run is held before its next round." if paused else "The run flies on."
        case "end":
            run.end()
            return "The run ends."
        case "change":
            return GIVEN.format(run.change(asked["fields"]))
        case "proceed":
            return GIVEN.format(run.proceed())
        case _:
            raise FieldError("order", None, says="unknown order")


def _mission_fields(given: object, *, spacing: bool) -> dict[str, Any]:
    allowed = ("shape", "center", "spacing") if spacing else ("shape", "center")
    fields = cast("dict[str, Any]", given) if isinstance(given, dict) else {}
    found = {name: fields[name] for name in allowed if fields.get(name) not in (None, "")}
    _check_center(found.get("center"), space=True)
    if not found:
        raise FieldError("fields", None, says=f"another mission needs at least one of {', '.join(allowed)}")
    return found


def _check_center(given: object, *, space: bool) -> None:
    """Refuse a centre that is not written as the form shows it; in `space` it may have three coordinates."""
    if given in (None, ""):
        return
    numbers = _list(given)
    good = all(
        isinstance(one, int | float) and not isinstance(one, bool) and abs(one) <= MAX_COORDINATE for one in numbers
    )
    if not good or len(numbers) not in ((2, 3) if space else (2,)):
        more = ", or three in space" if space else ""
        raise FieldError("center", None, says=f"two numbers, such as 50, 50{more}")


def _in_form_words(error: FlockError, *, at_field: bool) -> str:
    """An error's sentence with the form's labels for the configuration's names, without the one of its own field."""
    text = str(error)
    if at_field and isinstance(error, InputError) and error.field in LABELS:
        text = error.says
    if isinstance(error, InputError) and error.field == "arena":
        text = f"the formation reaches beyond the walls of the arena: {error.says}"
    text = _NAME.sub(lambda found: LABELS[found[0]], text).replace("safe_distance = ", "the safe distance, ")
    return text[:1].upper() + text[1:]


def _keys(given: object) -> list[str]:
    return [str(key) for key in _list(given)][:2]


def _list(given: object) -> list[object]:
    return cast("list[object]", given) if isinstance(given, list) else []


def _number(name: str, given: object) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise InputError(name, given, "a number")
    try:
        return float(given)
    except OverflowError:
        raise InputError(name, given, "a number below 10^308") from None


def _true_or_false(name: str, given: object) -> bool:
    if not isinstance(given, bool):
        raise InputError(name, given, "true or false")
    return given


def _whole(name: str, given: object) -> int:
    if isinstance(given, bool) or not isinstance(given, int):
        raise InputError(name, given, "a whole number")
    return given
