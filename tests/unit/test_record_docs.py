"""docs/reference/record.md says what is in the file: every channel, every field, nothing else."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest

from llm_flock.protocol import events
from llm_flock.record import scene
from llm_flock.record.schema import (
    CHANNELS,
    FORMAT_VERSION,
    SCENE_TOPIC,
    VOLATILE_RESULTS,
    Entry,
    channel_schema,
    volatile_fields,
)

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reference" / "record.md").read_text(encoding="utf-8")
SECTIONS = {part.split("\n", 1)[0].strip(): part for part in PAGE.split("\n### ")[1:]}


def table(section: str, number: int = 0) -> dict[str, tuple[str, ...]]:
    """Rows of a section's table by their first column."""
    tables = re.findall(r"(?:^\|.*\n)+", SECTIONS[section] + "\n", re.MULTILINE)
    rows = [tuple(cell.strip() for cell in line.strip("|").split(" | ")) for line in tables[number].splitlines()[2:]]
    return {row[0].strip("| `"): row[1:] for row in rows}


def fields(model: type[Entry], prefix: str = "") -> dict[str, tuple[type[Entry], str]]:
    """Every field of a channel, those inside other objects too, as the page writes them."""
    found: dict[str, tuple[type[Entry], str]] = {}
    for name, info in model.model_fields.items():
        found[prefix + name] = (model, name)
        for kind in (info.annotation, *get_args(info.annotation)):
            if isinstance(kind, type) and issubclass(kind, Entry):
                found |= fields(kind, f"{prefix}{name}{'.' if kind is info.annotation else '[].'}")
    return found


def test_every_channel_has_a_section() -> None:
    assert set(SECTIONS) == {*CHANNELS, SCENE_TOPIC}


@pytest.mark.parametrize("topic", CHANNELS)
def test_every_field_has_a_row_with_its_type(topic: str) -> None:
    rows = table(topic)
    expected = fields(CHANNELS[topic])
    assert list(rows) == list(expected)
    for name, (model, field) in expected.items():
        schema = channel_schema(model)["properties"][field]
        says, meaning = rows[name]
        first = says.split(",")[0].split()[0]
        assert first == {"array": "list"}.get(schema["type"], schema["type"]), name
        assert meaning
        info = model.model_fields[field]
        assert ("optional" in says) == (info.default is None and not info.is_required()), name
        assert ("volatile" in says) == (name in volatile_fields(topic)), name


def test_volatile_results_and_version_are_named() -> None:
    assert set(re.findall(r"`(\w+)`", table("/summary")["result"][1].split(";")[1])) == VOLATILE_RESULTS
    assert f"now {FORMAT_VERSION};" in table("/run")["format_version"][1]


def test_every_kind_of_event_is_explained() -> None:
    rows = table("/protocol", 1)
    assert {kind: frozenset(re.findall(r"`(\w+)`", row[1])) for kind, row in rows.items()} == events.NOTES


def test_origins_are_those_of_the_agent() -> None:
    assert set(re.findall(r"`(\w+)`", table("/state")["origins"][1])) == {origin.value for origin in events.Origin}


def test_entities_of_the_scene_are_explained() -> None:
    source = Path(scene.__file__).read_text(encoding="utf-8")
    assert set(table("/scene")) == set(re.findall(r'\bentity\("(\w+)"', source))
