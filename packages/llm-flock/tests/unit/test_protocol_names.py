"""One name for the protocol of a run, in figures, pages and tables."""

from __future__ import annotations

from typing import Any

import pytest

from llm_flock.record._words import protocol_text, rules_text
from llm_flock.runtime._config import build_config


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({}, "flock"),
        ({"protocol": "paper"}, "paper"),
        ({"protocol": "baseline"}, "baseline"),
        ({"assignment": "index"}, "flock with index assignment"),
        (
            {"protocol": "paper", "consensus": "none", "shield": True, "sense_range": 20.0},
            "paper with no consensus, a shield",
        ),
        ({"shield": False, "verify": False, "fallback": "hold"}, "flock with no shield"),
    ],
)
def test_a_protocol_has_the_name_of_its_preset_and_what_differs(fields: dict[str, Any], name: str) -> None:
    assert protocol_text(build_config({}, **fields).model_dump(mode="json")) == name


def test_older_records_tell_their_rules_or_nothing() -> None:
    assert protocol_text({}) == "" and protocol_text({"protocol": {"protocol": "flock"}}) == "flock"
    assert protocol_text({"protocol": {"consensus": "provenance", "assignment": "auction"}}) == "provenance + auction"


def test_rules_are_named_where_they_are_a_protocol() -> None:
    assert rules_text("influence", "nearest", shield=False) == "paper-literal (influence + nearest, shield off)"
    assert rules_text("influence", "nearest", shield=True) == "influence + nearest, shield on"
