"""Starts runs from the page. What it takes to fly is loaded when something flies: looking must not wait for it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from llm_flock.errors import InputError
from llm_flock.viewer.gallery import Gallery

if TYPE_CHECKING:
    from llm_flock.runtime.config import RunConfig
    from llm_flock.viewer.flight import Flight
    from llm_flock.viewer.plain import Reader

NEEDS_A_MODEL = (
    "This needs a language model: start the viewer with --model PROVIDER:MODEL. The form below works without."
)
MOST_FLIGHTS = 4
"""Runs that are flown at once: they share the processor with the pages."""


@dataclass(slots=True)
class Cockpit:
    """What a viewer can start.

    Attributes:
        gallery: takes the runs.
        runs: folder for their records.
        models: models that cost money or reach out, and that the operator allowed; the first one reads plain words.
        base_url: address that replaces the provider's own.
        reader: reads plain words, None without a model.
        flights: runs by key.
    """

    gallery: Gallery
    runs: Path
    models: Sequence[str] = ()
    base_url: str | None = None
    reader: Reader | None = None
    flights: dict[str, Flight] = field(default_factory=lambda: dict[str, "Flight"]())

    def start(self, fields: dict[str, Any], *, pace: float) -> Flight:
        """Start a run.

        Raises:
            InputError: what the command line would say.
        """
        return self._launch(self._config(fields), pace)

    def start_pair(self, fields: dict[str, Any], *, pace: float, protocols: Sequence[str]) -> list[Flight]:
        """Start the same run with several protocols; nothing takes off unless all of them can."""
        configs = [self._config({**fields, "protocol": name}) for name in protocols]
        return [self._launch(config, pace) for config in configs]

    def _config(self, fields: dict[str, Any]) -> RunConfig:
        from llm_flock.viewer.form import config_of

        config = config_of(fields, self.models)
        if config.model.model not in self.models:
            return config
        return config.model_copy(update={"model": config.model.model_copy(update={"base_url": self.base_url})})

    def _launch(self, config: RunConfig, pace: float) -> Flight:
        from llm_flock.viewer.flight import Flight

        if sum(not flight.over for flight in self.flights.values()) >= MOST_FLIGHTS:
            raise InputError("run", "one more", f"at most {MOST_FLIGHTS} at once: end one of them first")
        mission, protocol = config.mission, config.protocol.protocol
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
        shape = re.sub(r"[^A-Za-z0-9]", "", mission.shape.split(":")[0])
        out = self.runs / f"{stamp}-{shape}-{mission.n_robots}-{protocol}"
        config = config.model_copy(update={"trial": config.trial.model_copy(update={"out": str(out)})})
        title = f"{mission.shape} of {mission.n_robots}, {protocol}, seed {config.trial.seed}"
        reel = self.gallery.add(title, out / "run.mcap")
        flight = self.flights[reel.key] = Flight(config, reel, pace)
        flight.start()
        return flight
