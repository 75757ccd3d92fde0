"""A trained adapter as a GGUF file that llama.cpp loads beside its base model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from llm_flock.errors import InputError
from llm_flock_onboard._distill import need

Matrix: TypeAlias = np.ndarray[Any, np.dtype[np.float32]]

MAX_BYTES = 20_000_000
"""Largest adapter that LLM-Flock ships."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Adapter:
    """Low-rank factors of a llama-like model: A (rank, inputs) and B (outputs, rank) by layer, `blk.0.attn_q`.

    Their product is scaled by `alpha / rank`. `heads` are the attention heads of the base, `kv_heads` those of its keys
    and values.
    """

    rank: int
    alpha: float
    heads: int
    kv_heads: int
    factors: Mapping[str, tuple[Matrix, Matrix]]

    def save(self, path: Path) -> None:
        """Write a NumPy file."""
        arrays = {
            f"{name}.{part}": x for name, pair in self.factors.items() for part, x in zip("ab", pair, strict=True)
        }
        about = np.array([self.rank, self.alpha, self.heads, self.kv_heads], dtype=np.float64)
        with path.open("wb") as file:
            np.savez(file, about=about, **arrays)  # pyright: ignore[reportArgumentType]

    @classmethod
    def load(cls, path: Path) -> Adapter:
        """Read a file of `save`; InputError if it cannot be read, or holds something else."""
        try:
            with np.load(path) as file:
                rank, alpha, heads, kv_heads = file["about"].tolist()
                names = sorted({key.rpartition(".")[0] for key in file.files if key != "about"})
                factors = {name: (file[f"{name}.a"], file[f"{name}.b"]) for name in names}
        except (OSError, ValueError, KeyError) as error:
            raise InputError("adapter", str(path), f"factors as `distill train` keeps them ({error})") from None
        return cls(rank=int(rank), alpha=alpha, heads=int(heads), kv_heads=int(kv_heads), factors=factors)


def turned_rows(matrix: Matrix, heads: int) -> Matrix:
    """Rows of a query or key projection in llama.cpp's order.

    Rotary embeddings turn pairs of rows: (i, i + half) in transformers, (2 i, 2 i + 1) in llama.cpp.
    """
    rows, *rest = matrix.shape
    return matrix.reshape(heads, 2, rows // heads // 2, *rest).swapaxes(1, 2).reshape(matrix.shape)


def write_gguf(adapter: Adapter, path: Path, *, name: str) -> int:
    """Write an adapter for llama.cpp, in half precision, and return its size [bytes]."""
    gguf = need("gguf")
    writer = gguf.GGUFWriter(path, "llama")
    writer.add_type("adapter")
    writer.add_string("adapter.type", "lora")
    writer.add_float32("adapter.lora.alpha", float(adapter.alpha))
    writer.add_name(name)
    writer.add_license("apache-2.0")
    heads = {"attn_q": adapter.heads, "attn_k": adapter.kv_heads}
    for layer, (a, b) in adapter.factors.items():
        kind = layer.rpartition(".")[2]
        turned = turned_rows(b, heads[kind]) if kind in heads else b
        for part, matrix in (("lora_a", a), ("lora_b", turned)):
            writer.add_tensor(f"{layer}.weight.{part}", np.ascontiguousarray(matrix, dtype=np.float16))
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()
    return path.stat().st_size
