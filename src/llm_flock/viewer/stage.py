"""The page of a run, or of two side by side: arena, time line, mind, plots and events."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from nicegui import events, ui

from llm_flock.viewer import parts
from llm_flock.viewer.happenings import in_words
from llm_flock.viewer.mindview import show_mind
from llm_flock.viewer.reel import Reel
from llm_flock.viewer.widgets import Drawing

SPEEDS = {0.5: "0.5 / s", 1: "1 / s", 2: "2 / s", 4: "4 / s", 10: "10 / s", 30: "30 / s"}
"""Rounds a second."""

HINT = "Select a robot: click on it, or choose its number. Shift-click a second one to compare."
MOST_EVENTS = 100
REFRESH_S = 0.4
"""Time between two renewals of the words while the cursor runs [s]."""

CLOCK = "flockClock('main')"


@dataclass(slots=True)
class Cursor:
    """Where the page stands: the round, and who is looked at in which run."""

    round: int = 0
    last: int = 0
    open: bool = True
    selected: list[int] = field(default_factory=list[int])


class Stage:
    """Builds the page and keeps its words in step with the cursor.

    Args:
        reels: one run, or several with one clock.
        steer: builds the controls of runs that can be steered, None where there is nothing to steer.
    """

    def __init__(self, reels: Sequence[Reel], steer: Callable[[], None] | None = None) -> None:
        self.reels = reels
        self._steer = steer
        self.cursor = Cursor()
        self._arenas: list[Drawing] = []
        self._options: list[int] = []
        self._stale = False
        self._told: dict[str, Any] | None = None

    def build(self) -> None:
        """The whole page below its header."""
        keys = [reel.key for reel in self.reels]
        with ui.element("main").classes("flock-stage" + (" flock-pair" if len(keys) > 1 else "")):
            with ui.element("section").classes("flock-field").props('aria-label="Arena"'):
                self._layers()
                with ui.element("div").classes("flock-arenas"):
                    for number, reel in enumerate(self.reels):
                        with ui.element("figure").classes("flock-arena"):
                            if len(keys) > 1:
                                ui.label(reel.title).classes("flock-caption")
                            drawing = Drawing(parts.arena(reel.key, reel.title)).mark(f"arena-{reel.key}")
                            drawing.on("select", lambda event, k=number: self._picked(k, event))
                            self._arenas.append(drawing)
                    self._zoom()
            with ui.element("aside").classes("flock-side").props('aria-label="Mind, plots and events"'):
                self._side(keys)
            with ui.element("section").classes("flock-time").props('aria-label="Time"'):
                self._transport()
                line = Drawing(parts.timeline(keys))
                line.on("cursor", self._moved)
            ui.timer(REFRESH_S, self._refresh_stale)

    # ---------------------------------------------------------------- parts

    def _layers(self) -> None:
        with ui.row().classes("flock-layers"):
            for name, words, on in parts.LAYERS:
                box = ui.checkbox(words, value=on).props("dense size=sm")
                box.on_value_change(lambda event, name=name: self._tell_all("layer", name, bool(event.value)))

    def _zoom(self) -> None:
        with ui.row().classes("flock-zoom"):
            for icon, words, act in (
                ("add", "Zoom in", ("zoom", 1.25)),
                ("remove", "Zoom out", ("zoom", 0.8)),
                ("fit_screen", "Show all", ("fit",)),
            ):
                ui.button(icon=icon, on_click=partial(self._tell_all, *act)).props(
                    f'flat dense size=sm aria-label="{words}"'
                ).tooltip(words)

    def _side(self, keys: Sequence[str]) -> None:
        with ui.tabs().props("dense align=left no-caps").classes("flock-tabs") as self._tabs:
            mind = ui.tab("Mind", icon="psychology")
            plots = ui.tab("Plots", icon="show_chart")
            happened = ui.tab("Events", icon="list")
            steered = None if self._steer is None else ui.tab("Steer", icon="sports_esports")
        shown = "Steer" if steered is not None else "Plots" if len(keys) > 1 else "Mind"
        with ui.tab_panels(self._tabs, value=shown, animated=False, keep_alive=True).classes("flock-panels"):
            with ui.tab_panel(mind).classes("flock-panel"):
                with ui.row().classes("flock-choose"):
                    self._first = ui.select([], label="Robot", clearable=True).props("dense outlined options-dense")
                    self._second = ui.select([], label="Compare with", clearable=True)
                    self._second.props("dense outlined options-dense")
                    for box in (self._first, self._second):
                        box.on_value_change(self._chosen)
                self._words = ui.element("div").classes("flock-minds").mark("minds")
            with ui.tab_panel(plots).classes("flock-panel flock-plots"):
                Drawing(parts.plots(keys))
            with ui.tab_panel(happened).classes("flock-panel"):
                self._events = ui.element("div").mark("events")
            if self._steer is not None and steered is not None:
                with ui.tab_panel(steered).classes("flock-panel"):
                    self._steer()
        self._tabs.on_value_change(self._refresh)  # not before all panels are there

    def _transport(self) -> None:
        def button(icon: str, words: str, script: str) -> ui.button:
            made = ui.button(icon=icon).props(f'flat dense aria-label="{words}"').tooltip(words)
            return made.on("click", js_handler=f"() => {CLOCK}.{script}")

        with ui.row().classes("flock-transport"):
            button("skip_previous", "To the start (Home)", "seek(0)")
            button("chevron_left", "One round back (left arrow)", "step(-1)")
            self._play = button("play_arrow", "Play or pause (space)", "toggle()").mark("play")
            button("chevron_right", "One round on (right arrow)", "step(1)")
            button("skip_next", "To the end (End)", "live()")
            speed = ui.select(SPEEDS, value=4, label="Speed").props("dense outlined options-dense")
            speed.classes("flock-speed").on_value_change(
                lambda event: ui.run_javascript(f"{CLOCK}.speed = {float(event.value)}")
            )
            self._simulated = ui.badge("simulated language models", color="grey-8").mark("simulated")
            self._simulated.set_visibility(False)
            self._where = ui.label("round 0").classes("flock-where").mark("where").props('aria-live="polite"')
            self._state = ui.badge("").classes("flock-state").mark("state")

    def _tell_all(self, name: str, *given: Any) -> None:
        for drawing in self._arenas:
            drawing.tell(name, *given)

    # ---------------------------------------------------------------- what comes from the browser

    def _moved(self, event: events.GenericEventArguments) -> None:
        told: dict[str, Any] = event.args
        again, self._told = told == self._told, told
        cursor = self.cursor
        cursor.round, cursor.last, cursor.open = int(told["round"]), int(told["last"]), bool(told["open"])
        self._where.set_text(f"round {cursor.round} of {cursor.last}")
        self._play.props(f"icon={'pause' if told['playing'] or told['following'] else 'play_arrow'}")
        state = str(told["failure"]) or (
            "live" if told["following"] else _still(self.reels) if cursor.open else _end(self.reels[0])
        )
        self._state.set_text(state)
        self._state.props(f"color={'negative' if told['failure'] else 'positive' if told['following'] else 'grey-8'}")
        self._simulated.set_visibility(any(reel.simulated for reel in self.reels))
        self._offer()
        # Nobody reads at ten rounds a second: while the cursor runs, the words follow more slowly than the picture.
        self._stale = bool(told["playing"] or told["following"])
        if not self._stale and not again:  # said twice, lest it be lost: what somebody reads is not renewed for that
            self._refresh()

    def _refresh_stale(self) -> None:
        if self._stale:
            self._stale = False
            self._refresh()

    def _picked(self, number: int, event: events.GenericEventArguments) -> None:
        robot, second = int(event.args["robot"]), bool(event.args["second"])
        self._offer()
        self._tabs.set_value("Mind")
        (self._second if second and self._first.value is not None else self._first).set_value((number, robot))

    def _chosen(self) -> None:
        for number, drawing in enumerate(self._arenas):
            chosen = [box.value[1] for box in (self._first, self._second) if box.value and box.value[0] == number]
            drawing.tell("select", chosen)
        self._refresh()

    # ---------------------------------------------------------------- words

    def _offer(self) -> None:
        """Robots to choose from, as soon as it is known how many there are."""
        sizes = [reel.n_robots if reel.ready else 0 for reel in self.reels]
        if sizes == self._options:
            return
        self._options = sizes
        prefix = len(sizes) > 1
        choices = {
            (k, robot): f"{self.reels[k].title}: {robot}" if prefix else str(robot)
            for k, n in enumerate(sizes)
            for robot in range(n)
        }
        for box in (self._first, self._second):
            box.set_options(choices)  # pyright: ignore[reportUnknownMemberType]

    def _refresh(self) -> None:
        """Renew the words of the tab that is open."""
        if self._tabs.value == "Mind":
            self._show_minds()
        elif self._tabs.value == "Events":
            self._show_events()

    def _show_minds(self) -> None:
        number = self.cursor.round
        self._words.clear()
        with self._words:
            chosen: list[tuple[int, int]] = [box.value for box in (self._first, self._second) if box.value]
            if not chosen:
                ui.label(HINT).classes("flock-hint")
            for k, robot in chosen:
                if number <= self.reels[k].rounds:
                    show_mind(self.reels[k], robot, number)

    def _show_events(self) -> None:
        number = self.cursor.round
        self._events.clear()
        with self._events:
            for reel in self.reels:
                if len(self.reels) > 1:
                    ui.label(reel.title).classes("flock-subtitle")
                happened = reel.events(number)
                ui.label(f"{len(happened)} events in round {number}").classes("flock-hint")
                for event in happened[:MOST_EVENTS]:
                    with ui.row().classes("flock-event"):
                        ui.label(f"robot {event.robot}").classes("flock-who")
                        ui.label(in_words(event, reel.plan_name)).classes("flock-what")
                if len(happened) > MOST_EVENTS:
                    ui.label(f"and {len(happened) - MOST_EVENTS} more").classes("flock-hint")


def _still(reels: Sequence[Reel]) -> str:
    return "still running" if any(reel.live for reel in reels) else "reading …"


def _end(reel: Reel) -> str:
    if reel.result is None:
        return "ended early"
    formed = reel.result.get("rounds_to_formed")
    if reel.result.get("formed"):
        return "formed" if formed is None else f"formed in round {formed}"
    return f"not formed ({reel.result.get('stopped', 'ended')})"
