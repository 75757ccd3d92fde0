"""The look of plans, robots and words, the same in every figure and animation."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Generator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from llm_flock.errors import InputError
from llm_flock.printable import one_line, shape_title
from llm_flock.record import NO_PLAN, PALETTE, letters, protocol_text

if TYPE_CHECKING:
    from llm_flock.record import RunRecord

INK = "#222222"
FAINT = "#9A9A9A"
PAPER = "#FFFFFF"
DANGER = "#C81E1E"
"""Marks robots that are too close to one another; as in the viewer."""

QUIET = "#56606B"
"""Marks robots that only hide one another in the picture; as in the viewer."""

BRIGHT = 0.6  # relative luminance from which a thin line is hard to see on white
LETTERS_AN_INCH = 15  # letters of a title that surely fit into an inch

GRID = "#E4E4E4"
SERIES: tuple[str, ...] = ("#0072B2", "#D55E00", "#009E73", "#A8548A", "#B07A00", "#3D8FBF", "#757575")
"""Colours of curves and dots, each dark enough for a thin line on white."""

SERIES_ON_DARK: tuple[str, ...] = ("#5AB0EE", "#FF8B4D", "#3CC99A", "#E49BC6", "#F0B840", "#9AD4F5", "#B8B8B8")
"""The same series on a dark page."""

LINES: tuple[str, ...] = ("-", "--", "-.", ":")
MARKERS: tuple[str, ...] = ("o", "s", "^", "D", "v", "P", "X", "*")

RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 8.0,
    "figure.titlesize": 10.0,
    "axes.edgecolor": "#888888",
    "axes.linewidth": 0.8,
    "axes.spines.top": True,
    "axes.spines.right": True,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    # Labels and names are shown as they are: a dollar sign begins no formula.
    "text.parse_math": False,
    "figure.facecolor": PAPER,
    "axes.facecolor": PAPER,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "svg.hashsalt": "llm-flock",
    # TrueType letters in a PDF: journals refuse those of Type 3.
    "pdf.fonttype": 42,
}
"""Settings of all figures; a user's own settings do not change them."""


FONT = RC["font.size"]  # size of letters [points]; those of titles are larger, those at axes smaller, in proportion


def house_style(font: float = FONT) -> AbstractContextManager[None]:
    """Settings in force while a figure with letters of a size [points] is made."""
    # Matplotlib is slow to load, and the viewer needs only the looks of plans.
    from matplotlib import rc_context  # pyright: ignore[reportUnknownVariableType]

    return rc_context({name: value * font / FONT if name.endswith("size") else value for name, value in RC.items()})


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanLook:
    """How a plan is shown, never by colour alone: a letter, the fill of robots, lines on paper, ink on it, and rims."""

    name: str
    fill: str
    line: str
    ink: str
    rim: str


MAX_TITLE = 400  # longest title [characters]

WITHOUT_PLAN = PlanLook(name="", fill=NO_PLAN, line=FAINT, ink=INK, rim=":")
NOT_BEGUN = PlanLook(name="", fill=FAINT, line=FAINT, ink=PAPER, rim=":")
"""A robot that is not awake yet; as in the viewer."""


def plan_looks(record: RunRecord) -> dict[str | None, PlanLook]:
    """A look for every plan of a record, in the order in which they were first seen; None is no plan at all."""
    seen = dict.fromkeys(plan.plan_id for plan in record.plans)
    for state in record.states:
        seen.update(dict.fromkeys(plan_id for plan_id in state.plan_ids if plan_id is not None))
    looks: dict[str | None, PlanLook] = {None: WITHOUT_PLAN}
    for number, plan_id in enumerate(seen):
        looks[plan_id] = plan_look(number)
    return looks


@cache
def plan_look(number: int) -> PlanLook:
    """The look of a run's plan, from 0 in the order in which plans were first seen."""
    fill = PALETTE[number % len(PALETTE)]
    rim = LINES[number // len(PALETTE) % len(LINES)]
    return PlanLook(name=letters(number), fill=fill, line=line_colour(fill), ink=ink_on(fill), rim=rim)


def ink_on(fill: str) -> str:
    """Black or white, whichever has the higher contrast on a colour."""
    light = luminance(fill)
    return PAPER if 1.05 / (light + 0.05) > (light + 0.05) / 0.05 else INK


def line_colour(fill: str) -> str:
    """The colour itself, or a darker one where it would be lost on white paper."""
    if luminance(fill) < BRIGHT:
        return fill
    return "#" + "".join(f"{round(0.78 * int(fill[i : i + 2], 16)):02X}" for i in (1, 3, 5))


def luminance(colour: str) -> float:
    """Relative luminance of a colour such as #0072B2, from 0 for black to 1 for white (WCAG 2.2)."""
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def heading(record: RunRecord, inches: float) -> str:
    """Shape, N, protocol and model, and whether the model was simulated; broken to fit a width."""
    n = record.mission.mission["n_robots"]
    robots = "1 robot" if n == 1 else f"{n} robots"
    above = "from above and from the side" if record.positions.shape[2] > 2 else ""
    named = protocol_text(record.run.config)
    protocol = f"protocol: {named}" if named else ""
    parts = (shapes(record), robots, protocol, model_names([record]), above)
    return fit_title(" · ".join(part for part in parts if part), inches)


def shapes(record: RunRecord) -> str:
    """The shape, or the shapes of all missions in their order; with the number of places where it is given."""
    names = [
        shape_title(str(info.mission["shape"]))
        + ("" if info.mission.get("places") is None else f" of {info.mission['places']}")
        for info in record.missions
    ]
    return ", then ".join(name for name, _ in itertools.groupby(names))


def fit_title(text: str, inches: float) -> str:
    return textwrap.fill(one_line(text, MAX_TITLE), max(20, int(LETTERS_AN_INCH * inches)), break_on_hyphens=False)


def model_names(records: Sequence[RunRecord]) -> str:
    """The models of the runs, and whether any of them was simulated."""
    names = dict.fromkeys(name for record in records for name in record.models)
    if not names:
        names = dict.fromkeys(str(record.run.config.get("model", {}).get("model", "")) for record in records)
    shown = ", ".join(name for name in names if name)
    simulated = "simulated language models" if any(record.run.simulated for record in records) else ""
    return " · ".join(part for part in (shown, simulated) if part)


@contextmanager
def whole_file(path: Path) -> Generator[Path]:
    """A new file that takes the place of `path` at the end; nothing is left of half a one. Missing folders are made.

    It lies in a new folder, so no link that was there leads elsewhere. InputError where nothing can be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".", dir=path.parent) as folder:
            part = Path(folder) / path.name
            yield part
            part.replace(path)
    except OSError as error:
        raise InputError("out", str(path), f"a place that can be written to ({error.strerror})") from None
