"""The packaged weights in a faster format: the same numbers, made once, and only where they can be kept."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from gguf_files import MODEL, gguf, write_model

from llm_flock_onboard._local import requantize
from llm_flock_onboard._local.gguf import read_header
from llm_flock_onboard._local.requantize import F32, Q4_1, Q8_0, cache_folder, q8_from_q4, requantize_file
from llm_flock_onboard._local.weights import Weights

SIZES = {"norm": (32,), "matrix": (64, 3), "table": (32, 2)}
"""The matrix alone takes no multiple of 32 bytes as Q4_1: what follows it has to be moved."""
DIGEST = "0123456789abcdef" * 4


def numbers_of(blocks, kind):
    """What is written in a format, by its definition and one by one."""
    out = []
    for block in blocks:
        data = block.tobytes()
        if kind == Q4_1:
            scale, least = struct.unpack_from("<ee", data)
            out += [(byte & 15) * scale + least for byte in data[4:]] + [(b >> 4) * scale + least for b in data[4:]]
        else:
            (scale,) = struct.unpack_from("<e", data)
            out += [q * scale for q in struct.unpack_from("<32b", data, 2)]
    return np.array(out)


def random_blocks(n):
    rng = np.random.default_rng(1)
    blocks = rng.integers(0, 256, (n, 20), dtype=np.uint8)
    blocks[:, :4] = rng.normal(0, 0.1, (n, 2)).astype("<f2").view(np.uint8)
    return blocks


def write_small(path):
    """A model of three tensors: plain numbers, a matrix in the slow format, and one in the fast."""
    norm, table = np.arange(32, dtype="<f4").tobytes(), bytes(range(68))
    matrix = random_blocks(6).tobytes()
    kinds = {"norm": F32, "matrix": Q4_1, "table": Q8_0}
    data = {"norm": norm, "matrix": matrix, "table": table}
    whole, at = b"", {}
    for name, part in data.items():
        at[name] = len(whole)
        whole += part + bytes(-len(part) % 32)
    head = gguf(MODEL, SIZES, places={name: (kinds[name], at[name]) for name in SIZES})
    path.write_bytes(head + bytes(-len(head) % 32) + whole)
    return path, data


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "llm-flock"


def test_the_numbers_stay_what_they_were():
    blocks = random_blocks(50)
    blocks[0, :4] = 0  # all the same, and zero: no scale to divide by
    new = q8_from_q4(blocks)
    assert new.shape == (50, 34)
    before, after = numbers_of(blocks, Q4_1).reshape(50, 32), numbers_of(new, Q8_0).reshape(50, 32)
    largest = np.abs(before).max(axis=1, keepdims=True)
    # Half a step, and the rounding of the scale to half precision.
    assert (np.abs(after - before) <= largest * (0.5 / 127 + 2.0**-10)).all()
    assert not after[0].any()


def test_a_file_is_made_once_and_the_rest_of_it_stays(tmp_path, cache):
    source, data = write_small(tmp_path / "m.gguf")
    head = read_header(source)
    target = requantize_file(source, head, DIGEST)
    assert target == cache / "m-as-Q8_0-0123456789abcdef.gguf" and [target] == list(cache.iterdir())
    new = read_header(target)
    assert new.metadata == head.metadata and new.data_begin == head.data_begin
    assert {name: tensor.format for name, tensor in new.tensors.items()} == {"norm": F32, "matrix": Q8_0, "table": Q8_0}
    whole = target.read_bytes()
    parts = {name: whole[new.data_begin + tensor.offset :] for name, tensor in new.tensors.items()}
    assert all(tensor.offset % 32 == 0 for tensor in new.tensors.values())
    assert {name: tensor.shape for name, tensor in new.tensors.items()} == SIZES
    assert parts["norm"].startswith(data["norm"]) and parts["table"].startswith(data["table"])
    matrix = q8_from_q4(np.frombuffer(data["matrix"], np.uint8).reshape(-1, 20)).tobytes()
    assert parts["matrix"].startswith(matrix)
    made = target.stat().st_mtime_ns
    assert requantize_file(source, head, DIGEST) == target and target.stat().st_mtime_ns == made
    target.write_bytes(whole[:-1])
    assert requantize_file(source, head, DIGEST).read_bytes() == whole, "what somebody cut short is made again"


def test_weights_that_cannot_be_cached_are_read_unchanged(tmp_path, monkeypatch, caplog, cache):
    source, _ = write_small(tmp_path / "m.gguf")
    cache.parent.write_text("no folder")
    assert requantize_file(source, read_header(source), DIGEST) == source
    assert "m.gguf is read as it is, slowly" in caplog.text

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "full"))
    monkeypatch.setattr(requantize, "_parts", full)
    assert requantize_file(source, read_header(source), DIGEST) == source
    assert list((tmp_path / "full" / "llm-flock").iterdir()) == [], "nothing half done stays behind"


def test_files_without_the_slow_format_or_with_another_stay(tmp_path, cache):
    plain = write_model(tmp_path / "plain.gguf")
    assert requantize_file(plain, read_header(plain), DIGEST) == plain and not cache.exists()
    strange = tmp_path / "strange.gguf"
    strange.write_bytes(gguf(MODEL, {"a": (32,), "b": (32,)}, places={"a": (Q4_1, 0), "b": (14, 32)}))
    assert requantize_file(strange, read_header(strange), DIGEST) == strange and not cache.exists()


def test_only_packaged_weights_are_requantized_both_recorded(tmp_path, cache):
    source, _ = write_small(tmp_path / "m.gguf")
    own = Weights(source)
    assert own.loaded() == (source,) and own.versions() == own.digests()
    packaged = Weights(source, packaged=True)
    digest = packaged.digests()["m.gguf"].removeprefix("sha256:")
    assert packaged.loaded()[0].name == f"m-as-Q8_0-{digest[:16]}.gguf"
    assert list(packaged.digests()) == ["m.gguf"]
    assert list(packaged.versions()) == ["m.gguf", packaged.loaded()[0].name]


def test_the_cache_is_where_the_system_says(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "llm-flock"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "llm-flock"
