"""One configuration file, flags that override it, presets, and what is refused."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from llm_flock.errors import InputError
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.consensus import InfluenceConsensus
from llm_flock.runtime._config import RunConfig, build_config, load_config
from llm_flock.runtime._rules import PRESETS, assignment_rule, consensus_rule


def test_field_names_are_unique_over_all_sections() -> None:
    names: list[str] = []
    for info in RunConfig.model_fields.values():
        assert isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel)
        names.extend(info.annotation.model_fields)
    assert len(names) == len(set(names))


def test_every_field_says_what_it_is() -> None:
    for info in RunConfig.model_fields.values():
        assert isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel)
        assert all(field.description for field in info.annotation.model_fields.values())


@pytest.mark.parametrize("preset", list(PRESETS))
def test_presets_fill_what_was_left_open(preset: str) -> None:
    protocol = build_config(protocol=preset).protocol
    assert {k: getattr(protocol, k) for k in PRESETS[preset]} == dict(PRESETS[preset])


def test_single_options_override_the_preset() -> None:
    protocol = build_config(protocol="paper", consensus="provenance", shield=True).protocol
    assert (protocol.consensus, protocol.assignment, protocol.shield) == ("provenance", "nearest-free", True)


def test_flags_override_the_file(tmp_path: Path) -> None:
    file = tmp_path / "flock.toml"
    file.write_text('[mission]\nshape = "square"\nn_robots = 8\n[trial]\nseed = 3\n[model]\ntemperature = 0.5\n')
    config = load_config(file, n_robots=12, loss=0.25)
    assert (config.mission.shape, config.mission.n_robots, config.trial.seed) == ("square", 12, 3)
    assert (config.links.loss, config.model.temperature) == (0.25, "0.5")
    assert load_config(None) == build_config()


def test_a_resolved_configuration_reads_back_as_itself() -> None:
    config = build_config(shape="polygon:5", n_robots=5, loss=0.1, protocol="paper")
    assert build_config(config.model_dump(mode="json")) == config


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("[mission\n", "config"),
        ("[colours]\nred = 1\n", "colours"),
        ("mission = 3\n", "mission"),
        ("[mission]\nrobots = 3\n", "robots"),
        ("[mission]\npoints = 5\n", "points"),
        ("[mission]\npoints = []\n", "points"),
        ("[mission]\ncenter = [50, 'x']\n", "center.1"),
        ("[trial]\nrounds = -1\n", "rounds"),
        ("[trial]\nstart_positions = [[1, 2], [3, inf]]\n", "start_positions.1.1"),
        ("[links]\nloss = 1.5\n", "loss"),
        ("[protocol]\nprotocol = 'best'\n", "protocol"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path: Path, text: str, field: str) -> None:
    file = tmp_path / "flock.toml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        load_config(file)
    assert caught.value.field == field


def test_a_missing_file_and_an_unknown_field_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a file that can be read"):
        load_config(tmp_path / "none.toml")
    with pytest.raises(InputError, match="speed"):
        build_config(speed=3)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"comm_range": 10.0}, "sense_range"),
        ({"noise": 1.0}, "noise"),
        ({"noise": float("nan")}, "noise"),
        ({"timeout_s": 0.0}, "timeout_s"),
        ({"max_concurrent": 0}, "max_concurrent"),
        ({"max_retries": -1}, "max_retries"),
        ({"max_tries": 0}, "max_tries"),
        ({"max_calls": 0}, "max_calls"),
        ({"max_tokens": 0}, "max_tokens"),
        ({"max_cost": 0.0}, "max_cost"),
        ({"max_cost": float("nan")}, "max_cost"),
        ({"answers": "xml"}, "answers"),
    ],
)
def test_bad_options_are_refused_by_name(options: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        build_config(**options)
    assert caught.value.field == field


def test_without_the_shield_a_short_sense_range_is_allowed() -> None:
    assert build_config(comm_range=10.0, shield=False).mission.comm_range == 10.0


def test_points_come_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "places.csv"
    file.write_text("x,y\n0,0\n10,0\n0,10\n")
    mission = build_config(shape=f"points:{file}").mission
    assert (mission.shape, mission.n_robots) == ("points", 3)
    assert mission.points == ((0.0, 0.0), (10.0, 0.0), (0.0, 10.0))


def test_rules_are_found_by_name_or_by_address() -> None:
    assert consensus_rule("influence") == InfluenceConsensus()
    assert assignment_rule("llm_flock.protocol._agreement.auction:AuctionAssignment") == AuctionAssignment()
    for name in ("best", "no.such.module:Rule", "llm_flock.protocol._agreement.consensus:NoSuchRule", "os:getcwd"):
        with pytest.raises(InputError, match="consensus"):
            consensus_rule(name)


def test_what_is_left_out_has_to_be_there() -> None:
    assert build_config(without="exchanges").protocol.rules()[1] == AuctionAssignment(swaps=False)
    assert build_config(without="path-cost").protocol.rules()[1] == AuctionAssignment(straight=True)
    for options in ({"protocol": "paper"}, {"shield": False}, {"assignment": "nearest-free"}):
        with pytest.raises(InputError, match="away from the auction and the shield only"):
            build_config(without="search", **options)
    with pytest.raises(InputError, match="without"):
        build_config(without="rendezvous")


HUGE = "0x" + "f" * 20_000
ODD_FILES = {
    "nested lists": "a = " + "[" * 100 + "]" * 100,
    "digits": "a = " + "9" * 5_000,
    "a huge number": f"[mission]\nspacing = {HUGE}",
    "a huge number of robots": f"[mission]\nn_robots = {HUGE}",
    "a huge time-out": f"[protocol]\ntime_out = {HUGE}",
    "endless exchange": "[protocol]\ncomm_rounds = 100000000",
    "a huge change": f"[[trial.changes]]\nround = 1\nrobot = {HUGE}\nset = {{}}",
    "a section with a line break": '["x\\nerror: forged"]\na = 1',
    "a long text": '[mission]\nshape = "' + "x" * 1_000_000 + '"',
    "NUL in the name of a file": '[mission]\nshape = "points:\\u0000"',
    "NUL in a model": '[model]\nmodel = "local:\\u0000.gguf"',
    "a field called self": "[[trial.changes]]\nround = 1\nrobot = 0\nset = {self = 1}",
    "no module": '[protocol]\nassignment = ":"',
}


@pytest.mark.parametrize("text", ODD_FILES.values(), ids=ODD_FILES.keys())
def test_a_file_that_holds_anything_is_refused_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        load_config(path).protocol.rules()
    said = str(refused.value)
    assert "\n" not in said and len(said) < 2_000 and ": " in said


def test_text_that_neither_files_nor_records_can_hold_is_refused() -> None:
    for out in ("a\0b", "a\udcff"):
        with pytest.raises(InputError, match="out"):
            build_config(out=out)
    with pytest.raises(InputError, match="base"):
        build_config({"base": {}})
