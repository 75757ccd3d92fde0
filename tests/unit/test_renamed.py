"""Old names work as their present ones, in settings, flags, labels, sweeps and stored results."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest

from llm_flock import renamed
from llm_flock.errors import InputError
from llm_flock.experiments.store import TRIALS, Store, read_trial
from llm_flock.experiments.sweep import fly_sweep
from llm_flock.experiments.sweep_file import Sweep, load_sweep
from llm_flock.experiments.trial import TrialResult
from llm_flock.runtime.config import RunConfig, build_config


@pytest.fixture(autouse=True)
def _fresh_warnings() -> None:
    renamed._warn.cache_clear()


def sweep_file(folder: Path, consensus: str, gaps: str, rounds: str) -> Path:
    """A sweep of four cells over settings that were renamed; `rounds` is the name of the axis."""
    path = folder / "sweep.toml"
    path.write_text(
        f'[sweep]\nname = "old"\nseeds = 1\n'
        f'[run.mission]\nshape = "triangle"\nn_robots = 3\n[run.model]\nmodel = "simulated:ideal"\n'
        f'[run.trial]\nrounds = 2\n[grid]\nconsensus = ["{consensus}", "influence"]\ngaps = ["{gaps}"]\n'
        f"{rounds} = [1, 2]\n"
    )
    return path


def old_sweep(folder: Path) -> Path:
    """The same sweep in the words of the version before."""
    return sweep_file(folder, "pedigree", "remake", "ticks")


def labels(sweep: Sweep) -> dict[str, str]:
    """Labels of cells, by trial."""
    return {spec.id: spec.cell for spec in sweep.trials}


def test_old_settings_work_with_one_warning_each(caplog: pytest.LogCaptureFixture) -> None:
    configs = [build_config({"protocol": {"ticks": 4, "gaps": "remake"}}, consensus="pedigree") for _ in range(3)]
    config = configs[-1]
    assert (config.protocol.comm_rounds, config.protocol.gaps, config.protocol.consensus) == (4, "replan", "provenance")
    assert sum(record.levelno == logging.WARNING for record in caplog.records) == 3


def test_a_setting_under_both_names_is_refused() -> None:
    with pytest.raises(InputError, match=r"ticks.*together with comm_rounds"):
        build_config({"protocol": {"ticks": 2, "comm_rounds": 3}})


def test_flags() -> None:
    assert renamed.current_flag("--ticks") == "--comm-rounds"
    assert renamed.current_flag("--ticks=3") == "--comm-rounds=3"
    assert renamed.current_flag("ticks") == "ticks" and renamed.current_flag("--rounds") == "--rounds"


def test_labels() -> None:
    assert (
        renamed.current_label("circle/4 pedigree gaps=remake ticks=2")
        == "circle/4 provenance gaps=replan comm_rounds=2"
    )
    assert renamed.current_label("circle/4 fault=loss") == "circle/4 fault=loss"


def test_an_old_sweep_has_the_same_trials_and_cells(tmp_path: Path) -> None:
    old = load_sweep(old_sweep(tmp_path))
    new = load_sweep(sweep_file(tmp_path, "provenance", "replan", "comm_rounds"))
    assert len(old.trials) == 4 and labels(old) == labels(new)
    assert old.trials[0].axes == {"gaps": "replan", "comm_rounds": "1"}


@pytest.mark.parametrize("flag", ["ticks", "comm_rounds"])
def test_an_override_replaces_an_axis_under_either_name(tmp_path: Path, flag: str) -> None:
    override: dict[str, Any] = {flag: 3}
    found = load_sweep(old_sweep(tmp_path), **override)
    assert [spec.config.protocol.comm_rounds for spec in found.trials] == [3, 3]


def test_a_sweep_goes_on_after_its_file_was_renamed(tmp_path: Path) -> None:
    out = tmp_path / "results"
    fly_sweep(load_sweep(old_sweep(tmp_path)), out, executor="one")
    plan = out / "plan.json"
    plan.write_text(
        plan.read_text()
        .replace("provenance", "pedigree")
        .replace("gaps=replan", "gaps=remake")
        .replace("comm_rounds", "ticks")
    )
    new = load_sweep(sweep_file(tmp_path, "provenance", "replan", "comm_rounds"))
    assert "pedigree" in plan.read_text()
    assert fly_sweep(new, out, executor="one").finished == 4
    assert "pedigree" not in plan.read_text()


def test_a_trial_of_an_earlier_version_can_be_flown_again(tmp_path: Path) -> None:
    config = build_config(shape="triangle", n_robots=3).model_dump(mode="json")
    config["protocol"] |= {"consensus": "pedigree", "gaps": "remake", "ticks": config["protocol"].pop("comm_rounds")}
    Store(tmp_path).save(
        TrialResult(
            id="a",
            cell="triangle/3 pedigree gaps=remake",
            axes={"gaps": "remake"},
            config=config,
            summary=None,
            rounds={},
            error="ValueError: no",
            cut=False,
            simulated=True,
            code="1",
        )
    )
    found = read_trial(tmp_path / TRIALS / "a.json")
    assert found.cell == "triangle/3 provenance gaps=replan" and found.axes == {"gaps": "replan"}
    assert RunConfig.model_validate(found.config).protocol.gaps == "replan"
