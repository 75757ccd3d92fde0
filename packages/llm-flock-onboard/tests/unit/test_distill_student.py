"""A student small enough for a test: what a batch costs, what is learnt, and what is kept."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from llm_flock.errors import InputError
from llm_flock_onboard._distill.batches import Lesson, make_batch
from llm_flock_onboard._distill.student import LAYERS, Student
from llm_flock_onboard._distill.training import TrainingOptions, TrainingProgress, train

torch: Any = pytest.importorskip("torch")
transformers: Any = pytest.importorskip("transformers")
# Newer versions have another name for it.
pytestmark = pytest.mark.filterwarnings("ignore:.*past_key_values:FutureWarning")


def student(rank: int = 4) -> Student:
    """A random model of two blocks, the same one every time."""
    torch.manual_seed(1)
    config = transformers.LlamaConfig(
        vocab_size=32,
        hidden_size=16,
        intermediate_size=24,
        num_hidden_layers=2,
        num_attention_heads=4,
        num_key_value_heads=2,
        # Transformers' default draws weights so small that no adapter could change the scores much.
        initializer_range=0.3,
    )
    model = transformers.LlamaForCausalLM(config).requires_grad_(False)
    made = Student(model, SimpleNamespace(eos_token_id=0), {}, rank, 1.0, "cpu")
    for i, block in enumerate(model.model.layers):
        for name, short in LAYERS.items():
            made.attach(f"blk.{i}.{short}", block.get_submodule(name))
    return made


ROWS = [Lesson((1, 2, 3, 4), (7, 8)), Lesson((1, 2, 5), (9,)), Lesson((1, 2, 6, 6, 4), (7, 7))]


def test_a_common_beginning_changes_the_cost_and_not_the_loss() -> None:
    one = student()
    with torch.no_grad():
        for _, b in one.factors.values():
            b.normal_()
    together = one.loss(make_batch(ROWS))
    together.backward()
    grads = [p.grad.clone() for p in one.parameters]
    for p in one.parameters:
        p.grad = None
    tokens = sum(len(row.answer) for row in ROWS)
    parts: list[Any] = []
    for row in ROWS:
        ids = torch.tensor([[*row.prompt, *row.answer]])
        scores = one.model(input_ids=ids).logits[0, len(row.prompt) - 1 : -1]
        parts.append(torch.nn.functional.cross_entropy(scores, ids[0, len(row.prompt) :], reduction="sum"))
    apart: Any = sum(parts) / tokens
    apart.backward()
    assert float(together.detach()) == pytest.approx(float(apart.detach()), rel=1e-5)
    for mine, p in zip(grads, one.parameters, strict=True):
        assert torch.allclose(mine, p.grad, atol=1e-5)


def test_fresh_factors_change_nothing_and_training_does(tmp_path: Path) -> None:
    one, plain = student(), student()
    ids = torch.tensor([[1, 2, 3]])
    assert torch.equal(one.model(input_ids=ids).logits, plain.model(input_ids=ids).logits)
    told: list[TrainingProgress] = []
    end = train(one, ROWS, TrainingOptions(steps=90, rate=0.05, tokens=40), tmp_path, on_progress=told.append)
    assert [p.step for p in told] == list(range(1, 91)) and told[-1] == end and end.examples >= 90
    assert end.loss < 0.5 * told[0].loss and end.left_s == 0.0
    kept = one.adapter()
    a, b = kept.factors["blk.1.ffn_down"]
    assert a.shape == (4, 24) and b.shape == (16, 4) and np.abs(b).max() > 0
    assert (kept.rank, kept.alpha, kept.heads, kept.kv_heads) == (4, 4.0, 4, 2)


def test_training_resumes_from_its_checkpoint(tmp_path: Path) -> None:
    train(student(), ROWS, TrainingOptions(steps=10, rate=0.01, tokens=40), tmp_path)
    again, told = student(), list[TrainingProgress]()
    train(again, ROWS, TrainingOptions(steps=20, rate=0.01, tokens=40), tmp_path, resume=True, on_progress=told.append)
    assert [p.step for p in told] == list(range(11, 21))
    with pytest.raises(InputError, match="resume"):
        train(student(rank=2), ROWS, TrainingOptions(steps=20), tmp_path, resume=True)
    with pytest.raises(InputError, match="resume"):
        train(student(), ROWS, TrainingOptions(steps=20), tmp_path / "other", resume=True)


def test_training_begins_from_given_factors(tmp_path: Path) -> None:
    one = student()
    with torch.no_grad():
        for _, b in one.factors.values():
            b.normal_()
    kept = one.adapter()
    kept.save(tmp_path / "whole.npz")
    bare = {f"{name}.{part}": x for name, pair in kept.factors.items() for part, x in zip("ab", pair, strict=True)}
    np.savez(tmp_path / "bare.npz", **bare)  # type: ignore[arg-type]
    for name in ("whole.npz", "bare.npz"):
        again = student()
        again.begin_from([tmp_path / name])
        assert all(torch.equal(x, y) for x, y in zip(one.parameters, again.parameters, strict=True))
    for made, file in ((student(rank=2), "bare.npz"), (student(), "none.npz")):
        with pytest.raises(InputError, match="start"):
            made.begin_from([tmp_path / file])


def test_a_training_by_time_ends_and_its_rate_falls(tmp_path: Path) -> None:
    options = TrainingOptions(steps=10**6, minutes=0.02, rate=0.01, tokens=40)
    end = train(student(), ROWS, options, tmp_path)
    assert 1 <= end.step < 10**6 and (tmp_path / "factors.npz").is_file()
    assert options.rate_at(10**4, 0.0) == 0.01 and options.rate_at(10**4, 1.2) == 0.0


def test_the_rate_rises_stays_and_falls() -> None:
    options = TrainingOptions(steps=100, rate=1.0, warm_up=10, descent=0.5)
    assert [options.rate_at(step) for step in (0, 9, 30, 49, 75, 99)] == pytest.approx([0.1, 1.0, 1.0, 1.0, 0.5, 0.02])
