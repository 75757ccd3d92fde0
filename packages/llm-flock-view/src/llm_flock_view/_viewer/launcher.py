"""Starts runs from the page. The simulation is loaded once its form is open: pages that only show runs do not wait."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from llm_flock.errors import InputError
from llm_flock.printable import shape_title
from llm_flock_view._viewer.library import Library, identity
from llm_flock_view._viewer.paths import RECORD_NAME
from llm_flock_view._viewer.recording import Recording

if TYPE_CHECKING:
    from llm_flock.llm import MissionDraft, MissionReader
    from llm_flock.runtime import RunConfig
    from llm_flock_view._viewer.steered_run import SteeredRun

NEEDS_A_MODEL = (
    "This needs a language model: start the viewer with --model PROVIDER:MODEL. The form above works without."
)
MAX_RUNS = 4
"""Runs that fly at the same time: they share the processor with the pages."""


BEGINS_S = 10.0  # longest time until the record of a run has begun [s]
WARM_AFTER_S = 0.3  # the form is shown first [s]


def fly_nothing() -> None:
    """Fly two robots for a round, in memory: that loads all that a run needs."""
    import asyncio

    from llm_flock.runtime import run_async
    from llm_flock_view._viewer.steered_run import config_of

    config = config_of({"n_robots": 2, "shape": "line", "rounds": 1})
    asyncio.run(run_async(config=config, progress=False, trace=False))


@dataclass(slots=True)
class Launcher:
    """Starts runs, and knows those that it started, by key; `models`, which may cost money, the operator allowed."""

    library: Library
    folder: Path
    models: Sequence[str] = ()
    base_url: str | None = None
    reader: MissionReader | None = None
    runs: dict[str, SteeredRun] = field(default_factory=lambda: dict[str, "SteeredRun"]())
    _warm: threading.Timer | None = None

    def warm(self) -> None:
        """Load what a run needs beside the page, once: else the first run shows nothing for seconds."""
        if self._warm is None:
            # No daemon: one that is loading a library while the interpreter ends takes the process down.
            self._warm = threading.Timer(WARM_AFTER_S, fly_nothing)
            self._warm.start()

    def loaded(self) -> None:
        """Wait until that is loaded: threads that load the same libraries at once may get halves of them."""
        if self._warm is not None:
            self._warm.join()

    def start(
        self,
        fields: dict[str, Any],
        *,
        pace: float,
        protocols: Sequence[str] | None = None,
        draft: MissionDraft | None = None,
    ) -> list[SteeredRun]:
        """Start a run of the form's fields, or one with each of several protocols; all of them start, or none.

        The mission of a `draft` replaces that of the form.
        """
        from llm_flock_view._viewer.steered_run import config_of

        chosen = [fields] if protocols is None else [{**fields, "protocol": name} for name in protocols]
        configs = [config_of(each, self.models, self.base_url, draft) for each in chosen]
        flying = sum(not run.over for run in self.runs.values())
        if flying + len(configs) > MAX_RUNS:
            asked = f"{len(configs)} more than {flying}"
            raise InputError("run", asked, f"at most {MAX_RUNS} at once: end some of them first")
        runs = [self._launch(config, pace) for config in configs]
        for run in runs:
            self._show(run)
        return runs

    def _launch(self, config: RunConfig, pace: float) -> SteeredRun:
        from llm_flock_view._viewer.steered_run import SteeredRun

        mission, protocol = config.mission, config.protocol.protocol
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
        shape = re.sub(r"[^A-Za-z0-9]", "", mission.shape.split(":")[0])
        out = self.folder / f"{stamp}-{shape}-{mission.n_robots}-{protocol}"
        trial = config.trial.model_copy(update={"out": str(out)})
        config = config.model_copy(update={"trial": trial})
        title = f"{shape_title(mission.shape)} of {mission.n_robots}, {protocol}, seed {config.trial.seed}"
        recording = Recording("", title, out / RECORD_NAME, live=True)
        self.library.expect(out / RECORD_NAME)
        run = SteeredRun(config, recording, pace)
        recording.steer = run.state
        run.start()
        return run

    def _show(self, run: SteeredRun) -> None:
        """Add a run under the key of its record, which has to begin first; one that fails at once has another key."""
        path, end = run.recording.path, time.monotonic() + BEGINS_S
        while path is not None and identity(path) is None and not run.over and time.monotonic() < end:
            time.sleep(0.01)
        self.runs[self.library.put(run.recording).key] = run
