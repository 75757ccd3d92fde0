"""The form that starts simulated runs, one or two side by side, and reads missions in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from nicegui import ui

from llm_flock import formations
from llm_flock.errors import FlockError, InputError
from llm_flock.viewer.launcher import NEEDS_A_MODEL, Launcher

PROTOCOLS = ("flock", "paper", "baseline")
MODELS = (
    "simulated:ideal",
    "simulated:distorted@0.3,overshoot@0.3",
    "simulated:malformed@0.3,flaky@0.1",
    "simulated:collapse@0.3",
    "local:smollm2",
    "geometry",
)


class StartForm:
    """The form on the page."""

    def __init__(self, launcher: Launcher) -> None:
        self.launcher = launcher
        self._boxes: dict[str, Any] = {}

    def build(self) -> None:
        """The box for plain words, the form, and its buttons."""
        with ui.element("section").classes("flock-card").props('aria-label="Mission in plain words"'):
            ui.label("Say it in words").classes("flock-subtitle")
            self._build_words()
        with ui.element("section").classes("flock-card").props('aria-label="New run"'):
            ui.label("Fly a simulated run").classes("flock-subtitle")
            self._build_fields()
            self._error = ui.label("").classes("flock-error").props('role="alert"')
            with ui.row():
                one = partial(self._launch, None, "/run/{}")
                ui.button("Start", icon="flight_takeoff", on_click=one).props("no-caps")
                pair = partial(self._launch, ("paper", "flock"), "/pair/{}/{}")
                words = "Paper against flock, side by side"
                ui.button(words, icon="compare", on_click=pair).props("outline no-caps")

    def _build_words(self) -> None:
        reader = self.launcher.reader
        box = ui.textarea(placeholder="eight drones in a square around 40, 60, 8 apart").props(
            'outlined autogrow dense aria-label="Mission in plain words" maxlength=2000'
        )
        note = ui.label("" if reader else NEEDS_A_MODEL).classes("flock-hint")
        offer = ui.element("div")

        async def read() -> None:
            assert reader is not None
            offer.clear()
            note.set_text("asking the model …")
            button.disable()
            try:
                draft = await reader.read(str(box.value or ""))
            except FlockError as error:
                note.set_text(f"error: {error}")
                return
            finally:
                button.enable()
            note.set_text("This is what the model made of it. Nothing flies before you say so.")
            with offer, ui.element("div").classes("flock-call"):
                ui.label(draft.in_words).classes("flock-said")
                take = partial(self._take, draft.fields)
                ui.button("Take it over into the form", on_click=take).props("no-caps outline")

        button = ui.button("Read", icon="translate", on_click=read).props("no-caps outline")
        if reader is None:
            button.disable()
            box.disable()

    def _build_fields(self) -> None:
        shapes = [shape.name for shape in formations.shapes() if shape.name != "points"]
        boxes = self._boxes
        with ui.element("div").classes("flock-form"):
            boxes["shape"] = ui.input("Shape", value="circle", autocomplete=shapes)
            boxes["shape"].tooltip("A name from `llm-flock shapes`, such as circle, polygon:5, text:HI")
            boxes["n_robots"] = ui.number("Robots", value=10, precision=0)
            boxes["center"] = ui.input("Centre", value="50, 50")
            boxes["spacing"] = ui.number("Spacing [units]", value=10)
            boxes["protocol"] = ui.select(list(PROTOCOLS), label="Protocol", value="flock")
            models = list(dict.fromkeys((*self.launcher.models, *MODELS)))
            boxes["model"] = ui.input("Model", value="simulated:distorted@0.3,overshoot@0.3", autocomplete=models)
            boxes["seed"] = ui.number("Seed", value=0, precision=0)
            boxes["rounds"] = ui.number("Rounds at most", value=200, precision=0)
            boxes["loss"] = ui.number("Messages lost [share]", value=0, step=0.05)
            boxes["start"] = ui.select(["separated", "uniform", "connected"], label="Starts", value="separated")
            self._pace = ui.number("Rounds a second", value=4).props("dense outlined")
            self._on = ui.checkbox("Keep flying after it has formed", value=True)
        for name, box in boxes.items():
            box.props("dense outlined options-dense" if name in ("protocol", "start") else "dense outlined")
        for wide in (boxes["model"], self._on):
            wide.classes("flock-wide")

    def _take(self, fields: Mapping[str, Any]) -> None:
        for name, value in fields.items():
            shown = ", ".join(f"{part:g}" for part in value) if name == "center" else value
            self._boxes[name].set_value(shown)
        ui.notify("Taken over: look at it, then start", type="info")

    def _values(self) -> dict[str, Any]:
        fields = {name: box.value for name, box in self._boxes.items()}
        for name in ("n_robots", "seed", "rounds"):
            value = fields[name]
            fields[name] = int(value) if value is not None and float(value).is_integer() else value
        fields["center"] = numbers("center", str(fields["center"] or ""))
        fields["stop_when_formed"] = not self._on.value
        return fields

    def _launch(self, protocols: Sequence[str] | None, address: str) -> None:
        try:
            fields, pace = self._values(), float(self._pace.value or 0)
            if not 0.1 <= pace <= 100:
                raise InputError("rounds a second", pace, "from 0.1 to 100")
            started = self.launcher.start(fields, pace=pace, protocols=protocols)
        except FlockError as error:
            self._error.set_text(f"error: {error}")
            return
        ui.navigate.to(address.format(*(one.recording.key for one in started)))


def numbers(name: str, text: str) -> tuple[float, ...] | None:
    """The numbers of a text, separated by commas; None for an empty text.

    Raises:
        InputError: the text is something else.
    """
    if not text.strip():
        return None
    try:
        return tuple(float(part) for part in text.strip("[]() ").split(","))
    except ValueError:
        raise InputError(name, text, "numbers with commas between them, such as 50,50") from None
