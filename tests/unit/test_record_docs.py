"""docs/reference/record.md says what is in the file: every channel, every field, nothing else."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from llm_flock import events
from llm_flock.record import _scene as scene
from llm_flock.record._schema import CHANNELS, SCENE_TOPIC, LlmEntry, channel_schema

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))
from_code: Any = importlib.import_module("from_code")
PAGE = (ROOT / "docs" / "reference" / "record.md").read_text(encoding="utf-8")
SECTIONS = {part.split("\n", 1)[0].strip(): part for part in PAGE.split("\n### ")[1:]}


def table(section: str, number: int = 0) -> dict[str, tuple[str, ...]]:
    """Rows of a section's table by their first column."""
    tables = re.findall(r"(?:^\|.*\n)+", SECTIONS[section] + "\n", re.MULTILINE)
    rows = [tuple(cell.strip() for cell in line.strip("|").split(" | ")) for line in tables[number].splitlines()[2:]]
    return {row[0].strip("| `"): row[1:] for row in rows}


def test_every_channel_has_a_section() -> None:
    assert set(SECTIONS) == {*CHANNELS, SCENE_TOPIC}


@pytest.mark.parametrize("topic", CHANNELS)
def test_every_channel_draws_its_fields_from_the_code(topic: str) -> None:
    assert f"```{{record-fields}} {topic}\n```" in SECTIONS[topic]
    schema = channel_schema(CHANNELS[topic])
    rows = from_code.record_rows(schema, CHANNELS[topic])
    assert CHANNELS[topic].model_fields.keys() <= {name for name, _, _ in rows}
    assert {name for name, says, _ in rows if "volatile" in says} == {
        name for name, field in schema["properties"].items() if "volatile" in field
    }


def test_fields_of_objects_inside_a_call_are_listed() -> None:
    rows = {name: says for name, says, _ in from_code.record_rows(channel_schema(LlmEntry), LlmEntry)}
    assert rows["messages[].role"] == "string" and rows["usage.input"] == "integer"
    assert rows["rejected"] == "string, optional" and rows["latency_s"] == "number, volatile"


def test_volatile_results_are_named() -> None:
    (says,) = re.findall(r"Of the summary's result, (.*) are volatile", PAGE.replace("\n", " "))
    assert set(re.findall(r"`(\w+)`", says)) == {"wall_s", "latency_mean_s", "record", "flight"}


def test_every_kind_of_event_is_explained() -> None:
    rows = table("/protocol")
    assert {kind: frozenset(re.findall(r"`(\w+)`", row[1])) for kind, row in rows.items()} == events.NOTES


def test_origins_are_those_of_the_agent() -> None:
    says = CHANNELS["/state"].model_fields["origins"].description or ""
    assert set(re.findall(r"\w+", says.partition(":")[2])) - {"or"} == {origin.value for origin in events.Origin}


def test_entities_of_the_scene_are_explained() -> None:
    source = Path(scene.__file__).read_text(encoding="utf-8")
    assert set(table("/scene")) == set(re.findall(r'\bentity\("(\w+)"', source))
