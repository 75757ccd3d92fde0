"""Exports a record as a file: the record, a replay page, a figure or an animation."""

from __future__ import annotations

import tempfile
from pathlib import Path

from llm_flock.errors import FieldError, RecordError
from llm_flock.record import read_record
from llm_flock_view._viewer.canvases import FIGURES, PAGE_NAME, export_kinds
from llm_flock_view._viewer.paths import RECORD_NAME
from llm_flock_view._viewer.replay_page import write_page


def export(record: Path, name: str) -> bytes:
    """The bytes of the exported file; `name` is one of `export_kinds`."""
    if name not in [file_name for _, file_name in export_kinds()]:
        raise FieldError("export", name, says="there is no such export")
    if not record.is_file():
        raise RecordError(
            f"{record.name} is no longer on the disk: it was deleted or moved after the viewer had read it"
        )
    if name == RECORD_NAME:
        return record.read_bytes()
    # Matplotlib is slow to load.
    from llm_flock_view._figures import figures
    from llm_flock_view._figures.animation import animate

    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / name
        if name == PAGE_NAME:
            write_page(record, target)
        elif target.suffix[1:] in FIGURES:
            figures.save(figures.snapshots(read_record(record)), target)
        else:
            animate(read_record(record), target)
        return target.read_bytes()
