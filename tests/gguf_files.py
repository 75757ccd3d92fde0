"""Small GGUF files, written from nothing: a head as llama.cpp reads it, and no numbers behind it."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

MODEL = {
    "general.architecture": "llama",
    "general.type": "model",
    "llama.block_count": 2,
    "llama.context_length": 512,
    "llama.embedding_length": 64,
    "llama.attention.head_count": 4,
    "llama.attention.head_count_kv": 2,
    "tokenizer.chat_template": "{{ messages }}",
    "tokenizer.ggml.tokens": ["a", "bc"],
    "tokenizer.ggml.scores": [0.5, 1.5, 2.5],
    "general.quantized": True,
}
TENSORS = {"blk.0.attn_q.weight": (64, 32), "token_embd.weight": (64, 2)}
LORA = {"general.architecture": "llama", "general.type": "adapter", "adapter.type": "lora", "adapter.lora.alpha": 8.0}
LORA_TENSORS = {"blk.0.attn_q.weight.lora_a": (64, 4), "blk.0.attn_q.weight.lora_b": (4, 32)}


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<Q", len(data)) + data


def _value(value: Any) -> tuple[int, bytes]:
    match value:
        case bool():
            return 7, struct.pack("<?", value)
        case int():
            return 4, struct.pack("<I", value)
        case float():
            return 6, struct.pack("<f", value)
        case str():
            return 8, _text(value)
        case _:
            inner = [_value(item) for item in value]
            return 9, struct.pack("<IQ", inner[0][0], len(inner)) + b"".join(data for _, data in inner)


def gguf(
    about: Mapping[str, Any],
    tensors: Mapping[str, Sequence[int]],
    *,
    version: int = 3,
    places: Mapping[str, tuple[int, int]] | None = None,
) -> bytes:
    """The bytes of such a file; `places` are the format and the first byte of each tensor."""
    out = b"GGUF" + struct.pack("<IQQ", version, len(tensors), len(about))
    for name, value in about.items():
        kind, data = _value(value)
        out += _text(name) + struct.pack("<I", kind) + data
    for name, size in tensors.items():
        out += (
            _text(name)
            + struct.pack(f"<I{len(size)}Q", len(size), *size)
            + struct.pack("<IQ", *(places or {}).get(name, (0, 0)))
        )
    return out


def write_model(path: Path, about: Mapping[str, Any] = MODEL, tensors: Mapping[str, Sequence[int]] = TENSORS) -> Path:
    """A file with the head of a small model."""
    path.write_bytes(gguf(about, tensors))
    return path


def write_adapter(path: Path, about: Mapping[str, Any] = LORA, tensors: Any = LORA_TENSORS) -> Path:
    """A file with the head of an adapter for that model."""
    path.write_bytes(gguf(about, tensors))
    return path
