"""Controls of runs in flight: their pace, another mission, and faults."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import ui

from llm_flock.errors import FlockError
from llm_flock.mission import Mission
from llm_flock.viewer.start_form import numbers
from llm_flock.viewer.steered_run import SteeredRun, check_shape

if TYPE_CHECKING:
    from llm_flock.viewer.swarm import SwarmSource

ReadFields = Callable[[], dict[str, Any]]
"""Reads the boxes of a form; raises InputError where one holds something else than it should."""

GIVEN = "mission given to robot {}; the others hear of it from there"


class RunControls:
    """The tab that steers one run, or several in the same way."""

    def __init__(self, runs: Sequence[SteeredRun]) -> None:
        self.runs = runs

    def build(self) -> None:
        """Build all controls."""
        first, mission = self.runs[0], self.runs[0].config.mission
        self._status = _status()
        with ui.row().classes("flock-choose flock-acts"):
            pace = ui.number("Rounds / s", value=first.pace, min=0.1, max=100).props("dense outlined")
            pace.on_value_change(lambda event: self._set_pace(event.value))
            pause = ui.button("Pause", icon="pause").props("no-caps outline dense")
            ui.button("End run", icon="stop", on_click=self._end).props("no-caps outline dense")

            def toggle() -> None:
                paused = not first.paused
                for run in self.runs:
                    run.paused = paused
                pause.set_text("Go on" if paused else "Pause")
                pause.props(f"icon={'play_arrow' if paused else 'pause'}")

            pause.on_click(toggle)

        async def change(read: ReadFields) -> None:
            self._all(lambda run: run.change(read()), GIVEN)

        _mission_form(mission, change, spacing=True)
        ui.label("Faults").classes("flock-subtitle")
        with ui.row().classes("flock-choose flock-acts"):
            robot = ui.select(list(range(mission.n_robots)), label="Robot", value=0).props(
                "dense outlined options-dense"
            )
            for label, icon, order, done in (
                ("Kill", "dangerous", SteeredRun.kill, "robot killed"),
                ("Hallucinate", "psychology_alt", SteeredRun.hallucinate, "nonsense answers from now on"),
            ):
                inject = partial(self._all, lambda run, order=order: order(run, int(robot.value)), done)
                ui.button(label, icon=icon, on_click=inject).props("no-caps outline dense color=negative")
        ui.label("Messages lost").classes("flock-role")
        loss = ui.slider(min=0, max=0.9, step=0.1, value=first.config.links.loss).props(
            'label snap markers aria-label="Messages lost"'
        )
        loss.on_value_change(lambda event: self._lose(float(event.value or 0.0)))

    def _lose(self, share: float) -> None:
        self._all(lambda run: run.lose(share), f"{share:.0%} of messages are lost")

    def _all(self, order: Callable[[SteeredRun], Any], done: str) -> None:
        """Give an order to every run that is not over, and say so; `done` may have room for the first result."""
        results: list[Any] = []
        try:
            for run in self.runs:
                if not run.over:
                    results.append(order(run))
        except FlockError as error:
            self._say(f"error: {error}", bad=True)
            return
        if not results:
            self._say("error: the run is over", bad=True)
            return
        self._say(done.format(results[0]) + f" (round {self.runs[0].round + 1})")

    def _say(self, text: str, *, bad: bool = False) -> None:
        self._status.set_text(text)
        self._status.classes(add="flock-error" if bad else "", remove="" if bad else "flock-error")

    def _set_pace(self, value: float | None) -> None:
        if value is not None and 0.1 <= value <= 100:
            for run in self.runs:
                run.pace = float(value)

    def _end(self) -> None:
        for run in self.runs:
            run.end()
        self._say("the run ends")


def swarm_controls(swarm: SwarmSource) -> None:
    """Build the tab that gives a running swarm another mission."""
    status = _status()

    async def change(read: ReadFields) -> None:
        try:
            fields = read()
            check_shape(fields["shape"])
            taker = await swarm.change({name: value for name, value in fields.items() if value is not None})
        except FlockError as error:
            status.set_text(f"error: {error}")
            return
        status.set_text(GIVEN.format(taker))

    _mission_form(swarm.config.mission, change, spacing=False)


def _status() -> ui.label:
    """The line that reports what came of the last order."""
    return ui.label("").classes("flock-hint flock-steered").props('role="status"')


def _mission_form(mission: Mission, change: Callable[[ReadFields], Awaitable[None]], *, spacing: bool) -> None:
    """Boxes for another mission, and the button that calls `change` with their values."""
    ui.label("Another mission").classes("flock-subtitle")
    with ui.row().classes("flock-choose"):
        boxes: dict[str, Any] = {
            "shape": ui.input("Shape", value=mission.shape),
            "center": ui.input("Centre", value=", ".join(f"{x:g}" for x in mission.center)),
        }
        if spacing:
            boxes["spacing"] = ui.number("Spacing [units]", value=mission.spacing)
    for box in boxes.values():
        box.props("dense outlined")

    def read() -> dict[str, Any]:
        fields = {name: box.value for name, box in boxes.items()}
        return {**fields, "center": numbers("center", str(fields["center"]))}

    ui.button("Give the mission", icon="flag", on_click=partial(change, read)).props("no-caps outline")
