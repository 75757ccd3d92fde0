"""Builds a language model for each robot from the options: ranges, settings, and a shared pool of connections."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self, get_args

import numpy as np

from llm_flock.errors import InputError, unknown
from llm_flock.llm._dialect import Dialect
from llm_flock.llm._port import Call, CallSettings, Effort, LanguageModel, Reply, Usage
from llm_flock.llm._providers import PROVIDERS, ModelHost, ModelName, cost_usd, parse_model, source_of

if TYPE_CHECKING:
    import httpx2
    from pydantic_ai.models import Model


_RANGE = r"\s*[0-9]{1,9}(?:\s*-\s*(?:[0-9]{1,9})?)?\s*="
_STARTS_WITH_RANGE = re.compile(_RANGE)
_NEXT_RANGE = re.compile(rf",(?={_RANGE})")


def per_robot(field: str, text: str, n: int) -> tuple[str, ...]:
    """Assign values to robots: `A` for all, `0-4=A,5-9=B`, `3=A,0-2=B` or `0-4=A,5-=B` by ranges.

    Values may contain commas: only a comma before a range separates. InputError unless each robot has one value.
    """
    if not _STARTS_WITH_RANGE.match(text):
        return (text.strip(),) * n
    values: list[str | None] = [None] * n
    for part in _NEXT_RANGE.split(text):
        robots, _, value = part.partition("=")
        low, dash, high = robots.partition("-")
        first, last = int(low), int(high.strip() or (n - 1 if dash else low))
        if first > last or last >= n:
            raise InputError(field, part.strip(), f"a range of robots within 0..{n - 1}, lower id first")
        if not value.strip():
            raise InputError(field, part.strip(), "a value after '='")
        for robot in range(first, last + 1):
            if values[robot] is not None:
                raise InputError(field, text, says=f"robot {robot} is named twice")
            values[robot] = value.strip()
    gaps = [str(robot) for robot, value in enumerate(values) if value is None]
    if gaps:
        raise InputError(field, text, f"a value for every robot; there is none for {', '.join(gaps[:8])}")
    return tuple(value for value in values if value is not None)


def parse_models(text: str, n: int) -> tuple[str, ...]:
    """The model string of each of n robots, checked by `parse_model`; for ranges see `per_robot`."""
    models = per_robot("model", text, n)
    for model in dict.fromkeys(models):
        parse_model(model)
    return models


def parse_settings(
    n: int,
    *,
    temperature: str | None = None,
    seed: str | None = None,
    reasoning: str | None = None,
    max_tokens: int | None = None,
) -> tuple[CallSettings, ...]:
    """Sampling settings of each of n robots, written as in `per_robot`; one cap on the tokens of an answer for all."""
    efforts = list[Any]((None,) * n if reasoning is None else per_robot("reasoning_effort", reasoning, n))
    for effort in efforts:
        if effort is not None and effort not in get_args(Effort):
            raise InputError("reasoning_effort", effort, says=unknown("effort", effort, get_args(Effort)))
    columns = zip(
        _numbers("temperature", temperature, n, float, 2, "a number from 0 to 2"),
        _numbers("model_seed", seed, n, int, 2**63 - 1, "a whole number of at least 0"),
        efforts,
        strict=True,
    )
    return tuple(CallSettings(temperature=t, seed=s, reasoning=r, max_tokens=max_tokens) for t, s, r in columns)


def _numbers(
    field: str, text: str | None, n: int, read: Callable[[str], float], most: int, allowed: str
) -> Iterable[Any]:
    for value in (None,) * n if text is None else per_robot(field, text, n):
        try:
            number = None if value is None else read(value)
        except ValueError:
            number = math.nan
        if number is not None and not 0 <= number <= most:
            raise InputError(field, value, allowed)
        yield number


def waits(model: str) -> bool:
    """Whether a model mostly waits for answers, so that runs with it need little processor time."""
    name = parse_model(model)
    if name.kind != "simulated":
        return name.kind in ("provider", "plugin", "own")
    from llm_flock.llm._simulated.profiles import parse_profile

    return any(parse_profile(name.model).rates.get(fault, 0.0) > 0 for fault in ("slow", "flaky"))


def model_digests(model: str) -> Mapping[str, str]:
    """Digests of the files of a plug-in's model, by name; empty for other models. InputError if a file is unfit."""
    name = parse_model(model)
    return source_of(name.provider).digests(name.model) if name.kind == "plugin" else {}


def parse_history(text: str) -> int | None:
    """Read `none`, `last:K` (K >= 1) or `full`: the number of earlier exchanges that a model sees, None for all."""
    if text in ("none", "full"):
        return 0 if text == "none" else None
    last, _, count = text.partition(":")
    if last != "last" or not (count.isascii() and count.isdecimal() and len(count) <= 9 and int(count) >= 1):
        raise InputError("history", text, "none, full, or last:K with a whole number K >= 1")
    return int(count)


def check_priced(max_cost_usd: float | None, models: Iterable[str], base_urls: Mapping[str, str]) -> None:
    """InputError for a money budget with models of unknown price, on which it would have no effect.

    A provider at another address and a class of the user's own may charge anything.
    """
    if max_cost_usd is None:
        return
    one = Usage(input=1, output=1)
    names = [name for name in map(parse_model, dict.fromkeys(models)) if name.kind in ("provider", "own")]
    unknown = [
        name.text
        for name in names
        if name.kind == "own" or name.provider in base_urls or cost_usd(name.provider, name.model, one) is None
    ]
    if unknown:
        allowed = f"models with a known price, not {', '.join(unknown)}: use max_tokens or max_calls"
        raise InputError("max_cost", max_cost_usd, allowed)


class _NeverAsked:
    """Replaces a provider's model, or the user's own, where a configuration is only checked."""

    def __init__(self, name: str) -> None:
        self.name = name

    async def ask(self, call: Call) -> Reply:
        raise AssertionError(f"{self.name} was to be checked, not asked")


class ModelPool:
    """Builds models on one HTTP client, and a host for each plug-in; many runs of one event loop may share them.

    It is an async context manager. Keys are read from the environment (`environ`) when a model is first needed, and
    removed from all texts of replies. Without `asks`, it needs no keys: its models are only checked, never asked.
    """

    def __init__(self, *, environ: Mapping[str, str] | None = None, asks: bool = True) -> None:
        self.asks = asks
        self._environ = os.environ if environ is None else environ
        self._models: dict[tuple[str, str, str, float], tuple[Model[Any], Dialect]] = {}
        self._http: httpx2.AsyncClient | None = None
        self._hosts: dict[str, ModelHost] = {}

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Close all connections and the hosts of plug-ins. Do not ask a model of this pool afterwards."""
        while self._hosts:
            await self._hosts.popitem()[1].aclose()
        if self._http is not None:
            await self._http.aclose()
        self._http = None
        self._models.clear()

    def model(
        self,
        text: str,
        *,
        rng: np.random.Generator,
        settings: CallSettings | None = None,
        base_urls: Mapping[str, str] = MappingProxyType({}),
        timeout_s: float = 600.0,
        typed: bool = False,
    ) -> LanguageModel:
        """The language model of one robot: a provider's, a simulated one, or a plug-in's.

        Only simulated models use `rng`. `base_urls`, `typed` by the operator or not, replace the providers' addresses.
        `timeout_s` is the longest wait for a response, a second bound after that of `limits` [s].

        Raises:
            InputError: unknown name, missing key, address or file; or a replay, geometry or class: made elsewhere.
        """
        name = parse_model(text)
        if name.kind == "plugin":
            if name.provider not in self._hosts:
                self._hosts[name.provider] = source_of(name.provider).host()
            return self._hosts[name.provider].model(name.text, settings)
        if name.kind in ("provider", "own") and not self.asks:
            return _NeverAsked(name.text)
        if name.kind not in ("simulated", "provider"):
            raise InputError("model", text, "no replay, geometry or class here")
        if name.kind == "simulated":
            from llm_flock.llm._simulated.model import SimulatedModel
            from llm_flock.llm._simulated.profiles import parse_profile

            return SimulatedModel(parse_profile(name.model), rng, settings)
        hosted, dialect = self._hosted_model(name, base_urls, timeout_s, typed)
        # pydantic-ai takes about a second to import: wrong input is reported without it.
        from llm_flock.llm._client import PydanticModel

        # An error of one provider may quote the key of another.
        keys = (self._environ.get(info.key_env, "").strip() for info in PROVIDERS.values())
        priced = name.provider not in base_urls
        secrets = tuple(filter(None, keys))
        return PydanticModel(hosted, name=name.text, settings=settings, secrets=secrets, priced=priced, dialect=dialect)

    def _hosted_model(
        self, name: ModelName, base_urls: Mapping[str, str], timeout_s: float, typed: bool
    ) -> tuple[Model[Any], Dialect]:
        info = name.info
        address = base_urls.get(name.provider, info.base_url)
        if address is None:
            raise InputError("base_url", None, f"an address for '{name.provider}', such as http://localhost:8000/v1")
        key = info.key_for(address, self._environ, typed=typed)
        if not key and info.key_required and name.provider not in base_urls:
            raise InputError("model", name.text, says=f"needs a key: export {info.key_env}=...")
        from llm_flock.extras import require

        require("anthropic" if name.provider == "anthropic" else "openai", f"--model {name.text}")
        # The SDKs take most of a second to import, and a run with simulated models needs none of them.
        import llm_flock.llm._hosted as hosted

        if self._http is None:
            self._http = hosted.new_http_client()
        key_of_model = (name.provider, name.model, address, timeout_s)
        if key_of_model not in self._models:
            built = hosted.build_model(
                name.provider, name.model, base_url=address, key=key, http=self._http, timeout_s=timeout_s
            )
            self._models[key_of_model] = built, Dialect(address, name.text)
        return self._models[key_of_model]
