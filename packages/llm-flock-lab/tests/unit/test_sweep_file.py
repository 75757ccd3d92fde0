"""A grid in a file becomes trials: every one once, under an address that is its content."""

from pathlib import Path
from typing import Any

import pytest
from sweeps import small, small_file

from llm_flock.errors import InputError
from llm_flock.runtime._config import build_config
from llm_flock_lab._experiments.grid import trial_id
from llm_flock_lab._experiments.sweep_file import load_sweep

EXPERIMENTS = Path(__file__).parents[4] / "experiments"


def test_trials_are_stated_seed_by_seed_over_all_cells(tmp_path: Path) -> None:
    sweep = small(tmp_path)
    assert [(t.cell, t.seed) for t in sweep.trials] == [
        ("triangle/3 flock", 0),
        ("triangle/3 baseline", 0),
        ("triangle/3 flock", 1),
        ("triangle/3 baseline", 1),
    ]
    assert all(t.config.trial.rounds == 15 for t in sweep.trials)
    assert len({t.id for t in sweep.trials}) == 4


def test_seeds_may_be_a_list_or_begin_elsewhere(tmp_path: Path) -> None:
    assert [t.seed for t in small(tmp_path, sweep="first_seed = 7").trials[::2]] == [7, 8]
    path = small_file(tmp_path)
    path.write_text(path.read_text().replace("seeds = 2", "seeds = [3, 1]"))
    assert [t.seed for t in load_sweep(path).trials[::2]] == [3, 1]


def test_an_axis_may_be_a_field_or_a_list_of_named_tables(tmp_path: Path) -> None:
    grid = 'loss = [0.0, 0.2]\nkind = [{ name = "plain" }, { name = "noisy", noise = 0.1, delay = 2 }]'
    sweep = small(tmp_path, seeds=1, grid=grid)
    assert len(sweep.trials) == 8
    last = sweep.trials[-1]
    assert last.cell == "triangle/3 baseline loss=0.2 kind=noisy"
    assert last.axes == {"loss": "0.2", "kind": "noisy"}
    assert (last.config.links.loss, last.config.links.delay, last.config.trial.noise) == (0.2, 2, 0.1)


def test_variables_come_from_the_file_or_from_outside(tmp_path: Path) -> None:
    more = '[variables]\nmodels = ["simulated:ideal"]'
    path = small_file(tmp_path, grid='model = "$models"', more=more)
    assert {t.config.model.model for t in load_sweep(path).trials} == {"simulated:ideal"}
    given = ["simulated:distorted@0.3,overshoot@0.3", "geometry"]
    sweep = load_sweep(path, variables={"models": given})
    assert list(dict.fromkeys(t.config.model.model for t in sweep.trials)) == given
    with pytest.raises(InputError, match="set = 'modles'"):
        load_sweep(path, variables={"modles": given})


def test_override_replaces_the_axis_of_its_name_for_all(tmp_path: Path) -> None:
    sweep = small(tmp_path, grid="loss = [0.0, 0.2]", loss=0.5, rounds=3)
    assert {(t.config.links.loss, t.config.trial.rounds) for t in sweep.trials} == {(0.5, 3)}


def test_the_address_is_the_content_wherever_files_are_put(tmp_path: Path) -> None:
    here = build_config(seed=1)
    assert trial_id(here) == trial_id(build_config(seed=1, out="elsewhere"))
    assert trial_id(here) != trial_id(build_config(seed=2))
    assert trial_id(here) != trial_id(build_config(seed=1, loss=0.1))
    prompts = tmp_path / "prompts"
    prompts.mkdir()
    (prompts / "step.j2").write_text("one")
    before = trial_id(build_config(prompts=str(prompts)))
    (prompts / "step.j2").write_text("two")
    assert trial_id(build_config(prompts=str(prompts))) != before


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"grid": "loss = []"}, "grid.loss"),
        ({"grid": "loss = [0.1, 0.1]"}, "grid.loss"),
        ({"grid": 'model = "$nobody"'}, "grid.model"),
        ({"grid": "kind = [{ noise = 0.1 }]"}, "grid.kind"),
        ({"grid": "nothing = [1]"}, "nothing"),
        ({"grid": 'kind = [{ name = "a" }, { name = "b" }]'}, "grid"),
        ({"grid": "seed = [1]"}, "seed"),
        ({"more": "out = 'x'"}, "out"),
        ({"more": "[providers.nobody]\nmax_concurrent = 1"}, "providers"),
        ({"more": "[budget]\nmax_calls = 0"}, "max_calls"),
        ({"more": "[budget]\nmax_tokens = 0"}, "max_tokens"),
        ({"more": "[budget]\nmax_cost = nan"}, "max_cost"),
        ({"more": "[providers.openai]\ncalls_per_minute = 0"}, "calls_per_minute"),
        ({"more": "[expect]\nprofile = 'nothing'"}, "model"),
        ({"sweep": "trials = 3"}, "trials"),
        ({"more": "seed = 3"}, "seed"),
    ],
)
def test_sweep_names_the_field_that_it_rejects(tmp_path: Path, options: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as error:
        small(tmp_path, **options)
    assert error.value.field.split(".")[-1] == field.split(".")[-1], error.value


@pytest.mark.parametrize("name", ["..", ".", "a/b", ""])
def test_a_name_stays_below_its_folder(tmp_path: Path, name: str) -> None:
    path = tmp_path / "sweep.toml"
    path.write_text(f'[sweep]\nname = "{name}"\nseeds = 1\n[grid]\nshape = ["line"]\n', encoding="utf-8")
    with pytest.raises(InputError, match="not only dots"):
        load_sweep(path)


def test_a_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a file that can be read"):
        load_sweep(tmp_path / "nothing.toml")
    (tmp_path / "bad.toml").write_text("[sweep")
    with pytest.raises(InputError, match="TOML"):
        load_sweep(tmp_path / "bad.toml")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "trials"),
    [
        ("paper", 800),
        ("paper-figures", 800),
        ("simulated", 1200),
        ("faults", 800),
        ("scale", 200),
        ("evidence", 13_400),
    ],
)
def test_the_experiments_are_what_they_say(name: str, trials: int) -> None:
    sweep = load_sweep(EXPERIMENTS / f"{name}.toml")
    assert sweep.file.sweep.name == name and len(sweep.trials) == trials
    assert all(trial.waits == (name == "paper") for trial in sweep.trials)


def test_the_papers_two_sweeps_differ_only_in_their_models() -> None:
    def grid(name: str) -> set[Any]:
        return {
            (t.config.mission, t.config.protocol, t.config.trial.start, t.config.trial.rounds, t.seed)
            for t in load_sweep(EXPERIMENTS / f"{name}.toml").trials
        }

    assert grid("paper") == grid("paper-figures")
    models = {t.config.model.model.partition(":")[0] for t in load_sweep(EXPERIMENTS / "paper.toml").trials}
    assert models == {"openai", "anthropic", "deepseek", "vllm", "qwen"}


def test_the_arena_fits_every_team_of_the_scale_experiment() -> None:
    arenas = {
        (t.config.mission.shape, t.config.mission.n_robots): t.config.mission.arena
        for t in load_sweep(EXPERIMENTS / "scale.toml").trials
    }
    assert arenas["circle", 5] == ((0.0, 0.0), (100.0, 100.0))
    assert arenas["line", 100][1][0] > 500


HEAD = '[sweep]\nname = "x"\nseeds = 1\n'
ODD_SWEEPS = {
    "nested": "a = " + "[" * 100 + "]" * 100,
    "digits": "a = " + "9" * 5_000,
    "budget is no table": f'budget = 5\n{HEAD}[grid]\nteam = ["circle/4"]',
    "a long name": f'[sweep]\nname = "{"x" * 5_000}"\nseeds = 1\n[grid]\nteam = ["circle/4"]',
    "too many seeds": '[sweep]\nname = "x"\nseeds = 1000000000\n[grid]\nteam = ["circle/4"]',
    "too many cells": f"{HEAD}[grid]\nloss = {(rates := [k / 1000 for k in range(400)])}\nnoise = {rates}",
    "an axis of a reserved name": f'{HEAD}[grid]\nteam = ["circle/4"]\nbase = [1]',
    "an axis with a line break": f'{HEAD}[grid]\n"x\\nerror: forged" = [1]',
    "a shape that is a number": f"{HEAD}fit_arena = true\n[grid]\nshape = [5]",
    "robots in words": f'{HEAD}fit_arena = true\n[grid]\nn_robots = ["x"]',
    "more robots than fit into memory": f'{HEAD}fit_arena = true\n[grid]\nteam = ["circle/999999999"]',
    "more places than fit into memory": f'{HEAD}fit_arena = true\n[grid]\nteam = ["circle/4"]\nplaces = [999999999]',
}


@pytest.mark.parametrize("text", ODD_SWEEPS.values(), ids=ODD_SWEEPS.keys())
def test_a_file_that_holds_anything_is_refused_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        load_sweep(path)
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 2_000
