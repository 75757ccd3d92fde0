"""The page of a run, or of two side by side: arena, timeline, mind, plots and events."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from nicegui import events, ui
from nicegui.element import Element

from llm_flock.record.words import work_text
from llm_flock.viewer import canvases
from llm_flock.viewer.canvases import Canvas
from llm_flock.viewer.events import in_words
from llm_flock.viewer.recording import Recording
from llm_flock.viewer.robot_panel import show_robot

SPEEDS = {0.5: "0.5 / s", 1: "1 / s", 2: "2 / s", 4: "4 / s", 10: "10 / s", 30: "30 / s"}
"""Rounds a second."""

HINT = "Select a robot: click on it, or choose its number. Shift-click a second one to compare."
MOST_EVENTS = 100
REFRESH_S = 0.4
"""Time between two updates of the text while the cursor runs [s]."""

CLOCK = "flockClock('main')"


class CanvasElement(Element, component="static/element.js", esm={"llm-flock-viewer": "static"}):
    """A canvas as an element of a page."""

    def __init__(self, canvas: Canvas) -> None:
        super().__init__()
        self._props["kind"] = canvas.kind
        self._props["options"] = canvas.options

    def call(self, name: str, *arguments: Any) -> None:
        """Call a method of the canvas in the browser."""
        self.run_method("call", name, *arguments)


class Player:
    """Builds the page of one run, or of several with one clock, and keeps its text in step with the cursor.

    Where runs can be steered, `controls` builds the controls.
    """

    def __init__(self, runs: Sequence[Recording], controls: Callable[[], None] | None = None) -> None:
        self.runs = runs
        self.round = 0
        self._controls = controls
        self._arenas: list[CanvasElement] = []
        self._sizes: list[int] = []
        self._stale = False
        self._cursor: dict[str, Any] | None = None

    def build(self) -> None:
        """The whole page below its header."""
        keys = [run.key for run in self.runs]
        with ui.element("main").classes("flock-player" + (" flock-pair" if len(keys) > 1 else "")):
            with ui.element("section").classes("flock-field").props('aria-label="Arena"'):
                self._build_layers()
                with ui.element("div").classes("flock-arenas"):
                    for number, run in enumerate(self.runs):
                        with ui.element("figure").classes("flock-arena"):
                            if len(keys) > 1:
                                ui.label(run.title).classes("flock-caption")
                            element = CanvasElement(canvases.arena(run.key, run.title))
                            element.on("select", lambda event, k=number: self._picked(k, event))
                            self._arenas.append(element)
                    self._build_zoom()
            with ui.element("aside").classes("flock-side").props('aria-label="Mind, plots and events"'):
                self._build_side(keys)
            with ui.element("section").classes("flock-time").props('aria-label="Time"'):
                self._build_transport()
                CanvasElement(canvases.timeline(keys)).on("cursor", self._moved)
            ui.timer(REFRESH_S, self._refresh_stale)

    def _build_layers(self) -> None:
        with ui.row().classes("flock-layers"):
            for name, words, on in canvases.LAYERS:
                box = ui.checkbox(words, value=on).props("dense size=sm")
                box.on_value_change(lambda event, name=name: self._call_arenas("layer", name, bool(event.value)))

    def _build_zoom(self) -> None:
        with ui.row().classes("flock-zoom"):
            for icon, words, act in (
                ("add", "Zoom in", ("zoom", 1.25)),
                ("remove", "Zoom out", ("zoom", 0.8)),
                ("fit_screen", "Show all", ("fit",)),
            ):
                ui.button(icon=icon, on_click=partial(self._call_arenas, *act)).props(
                    f'flat dense size=sm aria-label="{words}"'
                ).tooltip(words)

    def _build_side(self, keys: Sequence[str]) -> None:
        with ui.tabs().props("dense align=left no-caps").classes("flock-tabs") as self._tabs:
            mind = ui.tab("Mind", icon="psychology")
            plots = ui.tab("Plots", icon="show_chart")
            happened = ui.tab("Events", icon="list")
            steering = None if self._controls is None else ui.tab("Steer", icon="sports_esports")
        shown = "Steer" if steering is not None else "Plots" if len(keys) > 1 else "Mind"
        with ui.tab_panels(self._tabs, value=shown, animated=False, keep_alive=True).classes("flock-panels"):
            with ui.tab_panel(mind).classes("flock-panel"):
                with ui.row().classes("flock-choose"):
                    self._first = ui.select([], label="Robot", clearable=True).props("dense outlined options-dense")
                    self._second = ui.select([], label="Compare with", clearable=True)
                    self._second.props("dense outlined options-dense")
                    for box in (self._first, self._second):
                        box.on_value_change(self._chosen)
                self._words = ui.element("div").classes("flock-minds")
            with ui.tab_panel(plots).classes("flock-panel flock-plots"):
                CanvasElement(canvases.plots(keys))
            with ui.tab_panel(happened).classes("flock-panel"):
                self._events = ui.element("div")
            if self._controls is not None and steering is not None:
                with ui.tab_panel(steering).classes("flock-panel"):
                    self._controls()
        self._tabs.on_value_change(self._refresh)  # not before all panels are there

    def _build_transport(self) -> None:
        def button(icon: str, words: str, script: str) -> ui.button:
            made = ui.button(icon=icon).props(f'flat dense aria-label="{words}"').tooltip(words)
            return made.on("click", js_handler=f"() => {CLOCK}.{script}")

        with ui.row().classes("flock-transport"):
            button("skip_previous", "To the start (Home)", "seek(0)")
            button("chevron_left", "One round back (left arrow)", "step(-1)")
            self._play = button("play_arrow", "Play or pause (space)", "toggle()")
            button("chevron_right", "One round on (right arrow)", "step(1)")
            button("skip_next", "To the end (End)", "live()")
            speed = ui.select(SPEEDS, value=4, label="Speed").props("dense outlined options-dense")
            speed.classes("flock-speed").on_value_change(
                lambda event: ui.run_javascript(f"{CLOCK}.speed = {float(event.value)}")
            )
            self._simulated = ui.badge("simulated language models", color="grey-8")
            self._simulated.set_visibility(False)
            self._where = ui.label("round 0").classes("flock-where").props('aria-live="polite"')
            self._state = ui.badge("").classes("flock-state")
            with self._state:
                self._work = ui.tooltip("")

    def _call_arenas(self, name: str, *arguments: Any) -> None:
        for element in self._arenas:
            element.call(name, *arguments)

    def _moved(self, event: events.GenericEventArguments) -> None:
        cursor: dict[str, Any] = event.args
        repeated, self._cursor = cursor == self._cursor, cursor
        moving, failure = bool(cursor["playing"] or cursor["following"]), str(cursor["failure"])
        self.round = int(cursor["round"])
        self._where.set_text(f"round {self.round} of {int(cursor['last'])}")
        self._play.props(f"icon={'pause' if moving else 'play_arrow'}")
        if cursor["following"]:
            state = "live"
        elif cursor["open"]:
            state = "still running" if any(run.live for run in self.runs) else "reading …"
        else:
            state = _end(self.runs[0])
            self._work.set_text(work_text(self.runs[0].result or {}) or state)
        self._state.set_text(failure or state)
        self._state.props(f"color={'negative' if failure else 'positive' if cursor['following'] else 'grey-8'}")
        self._simulated.set_visibility(any(run.simulated for run in self.runs))
        self._offer_robots()
        # While the cursor runs, the text follows more slowly than the picture.
        self._stale = moving
        if not moving and not repeated:  # the browser says it twice in case a message is lost; the text stays put then
            self._refresh()

    def _refresh_stale(self) -> None:
        if self._stale:
            self._stale = False
            self._refresh()

    def _picked(self, number: int, event: events.GenericEventArguments) -> None:
        robot, second = int(event.args["robot"]), bool(event.args["second"])
        self._offer_robots()
        self._tabs.set_value("Mind")
        (self._second if second and self._first.value is not None else self._first).set_value((number, robot))

    def _chosen(self) -> None:
        for number, element in enumerate(self._arenas):
            chosen = [box.value[1] for box in (self._first, self._second) if box.value and box.value[0] == number]
            element.call("select", chosen)
        self._refresh()

    def _offer_robots(self) -> None:
        """Fill the selection boxes once the team sizes are known."""
        sizes = [run.n_robots if run.ready else 0 for run in self.runs]
        if sizes == self._sizes:
            return
        self._sizes = sizes
        prefix = len(sizes) > 1
        choices = {
            (k, robot): f"{self.runs[k].title}: {robot}" if prefix else str(robot)
            for k, n in enumerate(sizes)
            for robot in range(n)
        }
        for box in (self._first, self._second):
            box.set_options(choices)  # pyright: ignore[reportUnknownMemberType]

    def _refresh(self) -> None:
        """Update the text of the open tab."""
        if self._tabs.value == "Mind":
            self._show_robots()
        elif self._tabs.value == "Events":
            self._show_events()

    def _show_robots(self) -> None:
        number = self.round
        self._words.clear()
        with self._words:
            chosen: list[tuple[int, int]] = [box.value for box in (self._first, self._second) if box.value]
            if not chosen:
                ui.label(HINT).classes("flock-hint")
            for k, robot in chosen:
                if number <= self.runs[k].rounds:
                    show_robot(self.runs[k], robot, number)

    def _show_events(self) -> None:
        number = self.round
        self._events.clear()
        with self._events:
            for run in self.runs:
                if len(self.runs) > 1:
                    ui.label(run.title).classes("flock-subtitle")
                listed = run.events(number)
                ui.label(f"{len(listed)} events in round {number}").classes("flock-hint")
                for event in listed[:MOST_EVENTS]:
                    with ui.row().classes("flock-event"):
                        ui.label(f"robot {event.robot}").classes("flock-who")
                        ui.label(in_words(event, run.plan_name)).classes("flock-what")
                if len(listed) > MOST_EVENTS:
                    ui.label(f"and {len(listed) - MOST_EVENTS} more").classes("flock-hint")


def _end(run: Recording) -> str:
    if run.result is None:
        return "ended early"
    formed = run.result.get("rounds_to_formed")
    if run.result.get("formed"):
        # Older records do not say whether the models did it alone.
        helped = "" if run.result.get("formed_by_models", True) else ", with help for the models"
        return ("formed" if formed is None else f"formed in round {formed}") + helped
    if run.result.get("stopped") == "no_plan":
        return "not formed: no model proposed an acceptable plan"
    return f"not formed ({run.result.get('stopped', 'ended')})"
