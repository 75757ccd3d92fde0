"""Teaching a small model: examples, batches, figures and files, without what training itself needs."""

import json
from pathlib import Path

import numpy as np
import pytest

from llm_flock.errors import InputError
from llm_flock_onboard._distill.adapter import Adapter, turned_rows, write_gguf
from llm_flock_onboard._distill.batches import Lesson, make_batch, plan_epoch, shared_prefix
from llm_flock_onboard._distill.choices import choice_examples
from llm_flock_onboard._distill.examples import HELD_OUT_TEAMS, TEAMS, draw_mission, read_examples, write_examples


def test_held_out_missions_differ_in_shape_centre_and_spacing() -> None:
    rng = np.random.default_rng(0)
    taught = [draw_mission(rng, "train", TEAMS) for _ in range(40)]
    held = [draw_mission(rng, "held-out", HELD_OUT_TEAMS) for _ in range(40)]
    assert not {m.shape for m in taught} & {m.shape for m in held}
    assert max(m.spacing for m in taught) < min(m.spacing for m in held)
    assert max(max(m.center) for m in taught) < min(min(m.center) for m in held)


def test_examples_are_kept_as_json_lines(tmp_path: Path) -> None:
    found = list(choice_examples(0, 3, "train"))
    assert write_examples(tmp_path / "a.jsonl", found) == 3
    assert read_examples(tmp_path / "a.jsonl") == found
    for text in ("", "{}", "no json", json.dumps({"kind": "step"})):
        (tmp_path / "b.jsonl").write_text(text)
        with pytest.raises(InputError, match="data"):
            read_examples(tmp_path / "b.jsonl")
    with pytest.raises(InputError, match="data"):
        read_examples(tmp_path / "c.jsonl")


def test_batch_shares_a_common_prefix_and_learns_only_answers() -> None:
    rows = [Lesson((1, 2, 3, 4), (7, 8)), Lesson((1, 2, 5), (9,))]
    assert shared_prefix(rows) == 2
    batch = make_batch(rows)
    assert batch.prefix == (1, 2)
    assert batch.tokens.tolist() == [[3, 4, 7], [5, 0, 0]]
    assert batch.labels.tolist() == [[-1, 7, 8], [9, -1, -1]]
    alone = make_batch([Lesson((1, 2), (3,))])
    assert alone.prefix == (1,) and alone.tokens.tolist() == [[2]] and alone.labels.tolist() == [[3]]


def test_an_epoch_has_every_row_once_and_keeps_to_the_budget() -> None:
    rng = np.random.default_rng(0)
    rows = [Lesson((1, 2, int(rng.integers(3)), *range(int(rng.integers(1, 9)))), (5, 6)) for _ in range(300)]
    steps = plan_epoch(rows, 60, np.random.default_rng(1))
    assert all(len(step) == 1 for step in steps)
    batches = [batch for step in steps for batch in step]
    assert sorted(i for batch in batches for i in batch) == list(range(300))
    assert steps != plan_epoch(rows, 60, np.random.default_rng(2))
    for batch in batches:
        made = make_batch([rows[i] for i in batch])
        assert len(made.prefix) + made.tokens.size <= 60
    assert np.mean([len(batch) for batch in batches]) > 4
    assert plan_epoch(rows[:2], 1, rng) in ([[[0]], [[1]]], [[[1]], [[0]]]), "a row that is too long goes alone"


def test_a_step_has_batches_of_different_kinds() -> None:
    kinds = [0] * 150 + [9] * 150
    rows = [Lesson((1, kind, i), (5, 6)) for i, kind in enumerate(kinds)]
    steps = plan_epoch(rows, 60, np.random.default_rng(1), together=2)
    assert sorted(i for step in steps for batch in step for i in batch) == list(range(300))
    assert {len(step) for step in steps} <= {1, 2}
    mixed = sum({kinds[i] for batch in step for i in batch} == {0, 9} for step in steps)
    assert mixed > 0.8 * len(steps)


def test_rows_of_queries_are_in_the_engines_order() -> None:
    # Two heads of four rows: the halves of each head are interleaved.
    rows = np.arange(8, dtype=np.float32).reshape(8, 1)
    assert turned_rows(rows, 2)[:, 0].tolist() == [0, 2, 1, 3, 4, 6, 5, 7]


def adapter() -> Adapter:
    rng = np.random.default_rng(0)
    sizes = {"blk.0.attn_q": (8, 8), "blk.0.attn_k": (8, 4), "blk.0.ffn_up": (8, 16)}
    factors = {
        name: (rng.random((2, ins)).astype(np.float32), rng.random((outs, 2)).astype(np.float32))
        for name, (ins, outs) in sizes.items()
    }
    return Adapter(rank=2, alpha=4.0, heads=2, kv_heads=1, factors=factors)


def test_factors_are_kept_and_read_again(tmp_path: Path) -> None:
    adapter().save(tmp_path / "factors.npz")
    again = Adapter.load(tmp_path / "factors.npz")
    assert (again.rank, again.alpha, again.heads, again.kv_heads) == (2, 4.0, 2, 1)
    for name, pair in adapter().factors.items():
        assert all(np.array_equal(a, b) for a, b in zip(pair, again.factors[name], strict=True))
    (tmp_path / "other.npz").write_bytes(b"nothing")
    for file in ("other.npz", "missing.npz"):
        with pytest.raises(InputError, match="adapter"):
            Adapter.load(tmp_path / file)


def test_an_adapter_is_written_as_llama_cpp_reads_it(tmp_path: Path) -> None:
    gguf = pytest.importorskip("gguf")
    made = adapter()
    assert write_gguf(made, tmp_path / "a.gguf", name="test") == (tmp_path / "a.gguf").stat().st_size
    reader = gguf.GGUFReader(tmp_path / "a.gguf")
    told = {key: field.contents() for key, field in reader.fields.items()}
    assert told["general.type"] == "adapter" and told["adapter.type"] == "lora"
    assert told["general.architecture"] == "llama" and told["adapter.lora.alpha"] == 4.0
    tensors = {tensor.name: np.array(tensor.data) for tensor in reader.tensors}
    a, b = made.factors["blk.0.attn_q"]
    assert np.allclose(tensors["blk.0.attn_q.weight.lora_a"], a, atol=1e-3)
    assert np.allclose(tensors["blk.0.attn_q.weight.lora_b"], turned_rows(b, 2), atol=1e-3)
    assert np.allclose(tensors["blk.0.ffn_up.weight.lora_b"], made.factors["blk.0.ffn_up"][1], atol=1e-3)
