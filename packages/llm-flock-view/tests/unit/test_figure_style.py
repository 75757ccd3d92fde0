"""The looks of plans, letters and lines can be told apart and read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from sample_records import make_record

from llm_flock.record._reader import read_record
from llm_flock.record._scene import PALETTE
from llm_flock_view._figures.panel import short
from llm_flock_view._figures.style import ink_on, letters, line_colour, luminance, plan_looks


def test_plans_look_different_even_without_colour(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=20, rounds=1, llm=False))
    looks = plan_looks(record)
    assert list(looks)[1:] == [plan.plan_id for plan in record.plans]
    assert len({look.name for look in looks.values()}) == 21
    assert len({(look.fill, look.rim) for look in looks.values()}) == 21
    assert looks[None].name == ""


def test_a_plan_that_was_not_announced_still_has_a_look(tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=5, rounds=10))
    assert set(plan_looks(replace(record, plans=()))) - {None} <= {plan.plan_id for plan in record.plans}
    assert len(plan_looks(replace(record, plans=()))) > 1


def test_letters_count_on() -> None:
    assert [letters(k) for k in (0, 25, 26, 27, 51, 52, 701, 702)] == ["A", "Z", "AA", "AB", "AZ", "BA", "ZZ", "AAA"]


def test_letters_and_lines_can_be_read() -> None:
    for fill in PALETTE:
        light, letter = luminance(fill), luminance(ink_on(fill))
        contrast = (max(light, letter) + 0.05) / (min(light, letter) + 0.05)
        assert contrast >= 3.9, fill
        assert luminance(line_colour(fill)) <= 0.6, fill
    assert line_colour(PALETTE[0]) == PALETTE[0]


def test_influence_in_few_signs() -> None:
    assert [short(x) for x in (0.0, 0.1, 0.25, 1.0)] == ["0", ".10", ".25", "1"]
