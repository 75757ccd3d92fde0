"""Controls of runs in flight: their pace, another mission, and faults."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from nicegui import ui

from llm_flock.errors import FlockError
from llm_flock.viewer.cockpit import numbers
from llm_flock.viewer.connect import Swarm
from llm_flock.viewer.flight import Flight
from llm_flock.viewer.form import check_shape


class Controls:
    """The tab that steers one run, or several in the same way.

    Args:
        flights: the runs.
    """

    def __init__(self, flights: Sequence[Flight]) -> None:
        self.flights = flights

    def build(self) -> None:
        """All controls."""
        mission = self.flights[0].config.mission
        self._said = ui.label("").classes("flock-hint flock-steered").mark("steered").props('role="status"')
        with ui.row().classes("flock-choose flock-acts"):
            pace = ui.number("Rounds / s", value=self.flights[0].pace, min=0.1, max=100).props("dense outlined")
            pace.on_value_change(lambda event: self._pace(event.value))
            pause = ui.button("Pause", icon="pause").props("no-caps outline dense").mark("pause-flight")
            ui.button("End run", icon="stop", on_click=self._end).props("no-caps outline dense").mark("end-flight")

            def turn() -> None:
                stopped = not self.flights[0].paused
                for flight in self.flights:
                    flight.paused = stopped
                pause.set_text("Go on" if stopped else "Pause")
                pause.props(f"icon={'play_arrow' if stopped else 'pause'}")

            pause.on_click(turn)
        ui.label("Another mission").classes("flock-subtitle")
        with ui.row().classes("flock-choose"):
            shape = ui.input("Shape", value=mission.shape).props("dense outlined").mark("change-shape")
            center = ui.input("Centre", value=", ".join(f"{x:g}" for x in mission.center)).props("dense outlined")
            center.mark("change-center")
            spacing = ui.number("Spacing [units]", value=mission.spacing).props("dense outlined").mark("change-spacing")

        def change() -> None:
            self._all(
                lambda flight: flight.change(
                    {"shape": shape.value, "center": numbers("center", str(center.value)), "spacing": spacing.value}
                ),
                "mission given to robot {}; the others hear of it from there",
            )

        ui.button("Give the mission", icon="flag", on_click=change).props("no-caps outline").mark("give-mission")
        ui.label("Faults").classes("flock-subtitle")
        with ui.row().classes("flock-choose flock-acts"):
            robot = ui.select(list(range(mission.n_robots)), label="Robot", value=0)
            robot.props("dense outlined options-dense").mark("fault-robot")
            ui.button(
                "Kill", icon="dangerous", on_click=lambda: self._all(lambda f: f.kill(int(robot.value)), "robot killed")
            ).props("no-caps outline dense color=negative").mark("kill")
            ui.button(
                "Hallucinate",
                icon="psychology_alt",
                on_click=lambda: self._all(lambda f: f.hallucinate(int(robot.value)), "nonsense answers from now on"),
            ).props("no-caps outline dense color=negative").mark("hallucinate")
        ui.label("Messages lost").classes("flock-role")
        loss = ui.slider(min=0, max=0.9, step=0.1, value=self.flights[0].config.links.loss).props(
            'label snap markers aria-label="Messages lost"'
        )
        loss.mark("loss").on_value_change(lambda event: self._lose(float(event.value or 0.0)))

    def _lose(self, share: float) -> None:
        self._all(lambda flight: flight.lose(share), f"{share:.0%} of messages are lost")

    def _all(self, order: Callable[[Flight], Any], said: str) -> None:
        taken: list[Any] = []
        try:
            for flight in self.flights:
                if not flight.over:
                    taken.append(order(flight))
        except FlockError as error:
            self._say(f"error: {error}", bad=True)
            return
        if not taken:
            self._say("error: the run is over", bad=True)
            return
        self._say(said.format(taken[0]) + f" (round {self.flights[0].round + 1})")

    def _say(self, text: str, *, bad: bool = False) -> None:
        self._said.set_text(text)
        self._said.classes(add="flock-error" if bad else "", remove="" if bad else "flock-error")

    def _pace(self, value: float | None) -> None:
        if value is not None and 0.1 <= value <= 100:
            for flight in self.flights:
                flight.pace = float(value)

    def _end(self) -> None:
        for flight in self.flights:
            flight.paused = False
            flight.end()
        self._say("the run ends")


class SwarmControls:
    """The tab that gives a running swarm another mission.

    Args:
        swarm: the swarm.
    """

    def __init__(self, swarm: Swarm) -> None:
        self.swarm = swarm

    def build(self) -> None:
        """All controls."""
        mission = self.swarm.config.mission
        said = ui.label("").classes("flock-hint flock-steered").mark("steered").props('role="status"')
        ui.label("Another mission").classes("flock-subtitle")
        with ui.row().classes("flock-choose"):
            shape = ui.input("Shape", value=mission.shape).props("dense outlined").mark("change-shape")
            center = ui.input("Centre", value=", ".join(f"{x:g}" for x in mission.center)).props("dense outlined")
            center.mark("change-center")

        async def change() -> None:
            try:
                check_shape(shape.value)
                fields = {"shape": shape.value, "center": numbers("center", str(center.value))}
                taker = await self.swarm.change({k: v for k, v in fields.items() if v is not None})
            except FlockError as error:
                said.set_text(f"error: {error}")
                return
            said.set_text(f"mission given to robot {taker}; the others hear of it from there")

        ui.button("Give the mission", icon="flag", on_click=change).props("no-caps outline").mark("give-mission")
