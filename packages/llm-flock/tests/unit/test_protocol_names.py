"""One name for the protocol of a run, in figures, pages and tables."""

from __future__ import annotations

from typing import Any

import pytest

from llm_flock.record._words import caveats, protocol_text, rules_text
from llm_flock.runtime._config import build_config


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({}, "flock"),
        ({"protocol": "paper"}, "paper"),
        ({"protocol": "baseline"}, "baseline"),
        ({"assignment": "index"}, "flock with index assignment"),
        ({"protocol": "paper", "ties": "lowest-id"}, "paper with ties to the lowest id"),
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


def test_caveats_say_what_the_error_is_blind_to() -> None:
    mission = {"safe_distance": 3.0, "spacing": 10.0}
    assert caveats({}, mission) == []
    assert caveats({"min_separation": 3.0 - 1e-7, "steps_over_limit": 0, "center_distance": 1.0}, mission) == []
    assert caveats({"min_separation": 0.04, "steps_over_limit": 1, "center_distance": 65.2}, mission) == [
        "robots came as near as 0.040, below the safe distance 3",
        "1 step over the limit ended there",
        "the team is 65.20 beside the centre of its mission",
    ]
