"""The forecast of a sweep: what is spent, what will be, and when it is over."""

from pathlib import Path

import pytest
from sweeps import small

from llm_flock.cli._expected import short
from llm_flock.llm._limits import Spent
from llm_flock_lab._cli.sweep_display import progress_text
from llm_flock_lab._experiments.grid import TrialSpec
from llm_flock_lab._experiments.tally import Tally
from llm_flock_lab._experiments.trial import TrialResult


def finish(
    tally: Tally, spec: TrialSpec, calls: int, *, formed: bool = True, error: str | None = None, cut: bool = False
) -> None:
    summary = {"formed": formed, "model_calls": calls, "tokens": 10 * calls, "cost_usd": calls / 100}
    plain = {"id": spec.id, "cell": spec.cell, "axes": {}, "config": {}, "rounds": {}, "code": ""}
    tally.finished(spec, TrialResult(**plain, summary=summary, error=error, cut=cut, simulated=True))


def test_the_eta_weighs_trials_by_what_their_cell_uses(tmp_path: Path) -> None:
    now = [0.0]
    tally = Tally(clock=lambda: now[0])
    specs = small(tmp_path, seeds=2).trials
    tally.begin((), specs)
    assert tally.eta_s is None and tally.trials == 4
    now[0] = 40.0
    finish(tally, specs[0], 100)
    finish(tally, specs[1], 300, formed=False)
    assert tally.eta_s == pytest.approx(40.0)
    assert tally.forecast == Spent(calls=800, tokens=8000, cost_usd=8.0)
    finish(tally, specs[2], 100)
    assert tally.eta_s == pytest.approx(40.0 * 300 / 500)
    finish(tally, specs[3], 300, formed=False, error="x", cut=True)
    assert tally.eta_s == 0 and (tally.over, tally.formed, tally.broken, tally.cut) == (4, 2, 1, 1)


def test_the_line_says_what_is_spent_and_what_is_expected(tmp_path: Path) -> None:
    specs = small(tmp_path, seeds=1).trials
    tally = Tally()
    tally.begin((), specs)
    assert progress_text(tally).startswith("0/2 trials · 0 formed · ETA ?")
    finish(tally, specs[0], 100, error="x", formed=False)
    tally.spent(Spent(calls=120, tokens=1200, cost_usd=1.2), None)
    text = progress_text(tally)
    assert "1 broken off" in text and "calls 120 of ~200" in text and "1.20 of ~2.00 USD" in text


def test_large_counts_are_short() -> None:
    assert (short(12345.4), short(2.5e6)) == ("12,345", "2.50 M")
