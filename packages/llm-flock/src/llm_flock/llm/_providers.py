"""The table of providers, the names of models (`provider:model`), and the interface of plug-ins with models."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias
from urllib.parse import urlsplit

from llm_flock.errors import InputError, unknown
from llm_flock.llm._port import Usage
from llm_flock.printable import hidden

if TYPE_CHECKING:
    from llm_flock.llm._port import CallSettings, FrameName, LanguageModel
    from llm_flock.mission import Mission
    from llm_flock.planner import PlanQuestion

MAX_URL_LENGTH = 2_000  # longest address of a provider [characters]

SEND_KEY_TO = "LLM_FLOCK_SEND_KEY_TO"
"""Environment variable with hosts, separated by commas, that files may have keys sent to."""

LOOPBACK = ("localhost", "127.0.0.1", "::1")

ModelKind: TypeAlias = Literal["provider", "plugin", "simulated", "replay", "geometry", "own"]


@dataclass(frozen=True, slots=True)
class ProviderInfo:
    """One line of the table of providers.

    `base_url` is None where the operator must give one. `key_required`: its own address refuses calls without a key.
    """

    name: str
    key_env: str
    base_url: str | None
    example: str
    key_required: bool = False

    def key_for(self, url: str, environ: Mapping[str, str], *, typed: bool) -> str:
        """The key that goes to an address that `check_url` took; empty where none is set. InputError if it must not.

        It goes to the provider's own host, this machine, hosts of `SEND_KEY_TO`, and where the operator `typed` it; but
        to no other machine unencrypted.
        """
        key, parts = environ.get(self.key_env, "").strip(), urlsplit(url)
        host = parts.hostname or ""
        if not key or host in LOOPBACK:
            return key
        if parts.scheme != "https":
            says = f"{self.key_env} would go to {host} in plain text: use https, or unset {self.key_env}"
            raise InputError("base_url", url, says=says)
        allowed = [name.strip() for name in environ.get(SEND_KEY_TO, "").lower().split(",")]
        if not typed and host not in (urlsplit(self.base_url or "").hostname, *allowed):
            says = f"to send {self.key_env} to {host}, type --base-url yourself or export {SEND_KEY_TO}={host}"
            raise InputError("base_url", url, says=f"{says}; or unset {self.key_env}")
        return key


_OPENAI_URL = "https://api.openai.com/v1"
_QWEN_URL = "https://dashscope-intl.aliyuncs.com/compatible-mode/v1"
_TABLE = (
    ProviderInfo("openai", "OPENAI_API_KEY", _OPENAI_URL, "openai:o3-mini", key_required=True),
    ProviderInfo("openai-responses", "OPENAI_API_KEY", _OPENAI_URL, "openai-responses:gpt-5-mini", key_required=True),
    ProviderInfo(
        "anthropic", "ANTHROPIC_API_KEY", "https://api.anthropic.com", "anthropic:claude-sonnet-4-6", key_required=True
    ),
    ProviderInfo(
        "deepseek", "DEEPSEEK_API_KEY", "https://api.deepseek.com", "deepseek:deepseek-reasoner", key_required=True
    ),
    ProviderInfo("qwen", "DASHSCOPE_API_KEY", _QWEN_URL, "qwen:qwen-plus", key_required=True),
    ProviderInfo("llama", "LLAMA_API_KEY", None, "llama:llama-3.3-70b-instruct"),
    ProviderInfo("ollama", "OLLAMA_API_KEY", "http://localhost:11434/v1", "ollama:qwen3:8b"),
    ProviderInfo("vllm", "VLLM_API_KEY", "http://localhost:8000/v1", "vllm:Qwen/Qwen3-8B"),
    ProviderInfo("llamacpp", "LLAMACPP_API_KEY", "http://localhost:8080/v1", "llamacpp:local"),
    ProviderInfo("openai-compatible", "OPENAI_COMPATIBLE_API_KEY", None, "openai-compatible:any-model"),
)
PROVIDERS: Mapping[str, ProviderInfo] = {info.name: info for info in _TABLE}
"""The table of providers by name, in the order of the documentation."""


def model_forms() -> str:
    """The forms of a model string, as a phrase."""
    from llm_flock import plugins

    installed = "".join(f"{prefix}:MODEL, " for prefix in plugins.entries("models"))
    return (
        f"PROVIDER:MODEL with a provider of {', '.join(PROVIDERS)}; or {installed}simulated:PROFILE, replay:FILE, "
        "geometry, or package.module:Class"
    )


_OWN = re.compile(r"(?:[^\W\d]\w*\.)+[^\W\d]\w*:[^\W\d][\w.<>]*|[^\W\d]\w*:(?:[\w.<>]+\.)?[A-Z]\w*|__main__:[\w.<>]+")
"""A class of the user's own. If the module has no dot, the class must begin with a capital letter, so that a misspelt
provider is not taken for a class."""

_RESPONSES_ONLY = re.compile(r"(?:^|-)(?:pro|codex|deep-research)(?:-|$)")


def needs_responses(provider: str, model: str, base_url: str) -> bool:
    """Whether to ask a model through OpenAI's Responses API instead of chat completions.

    OpenAI serves some families only there: o1-pro, o3-pro and gpt-5-pro, codex, and deep-research, of any version.
    At other addresses, which may translate, only the provider `openai-responses` uses it.
    """
    if provider != "openai":
        return provider == "openai-responses"
    return base_url == PROVIDERS["openai"].base_url and _RESPONSES_ONLY.search(model) is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelName:
    """A parsed model string; `provider` is in the table, the prefix of a plug-in, or else the kind.

    `model` is the part after the first colon: model name, profile of a simulated model, path of a cassette, or a class.
    """

    text: str
    kind: ModelKind
    provider: str
    model: str

    @property
    def info(self) -> ProviderInfo:
        """The provider's line in the table. Only for kind `provider`."""
        return PROVIDERS[self.provider]


def parse_model(text: str) -> ModelName:
    """Read `provider:model`, `simulated:PROFILE`, `replay:FILE`, `geometry`, `package.module:Class`, or a plug-in's.

    The name may come from a record, so it causes no import. ExtraMissing if an extra has to be installed.
    """
    text = text.strip()
    provider, colon, model = text.partition(":")
    if text == "geometry":
        return ModelName(text=text, kind="geometry", provider="geometry", model="")
    from llm_flock import plugins
    from llm_flock.extras import EXTRAS, ExtraMissing

    kinds: dict[str, ModelKind] = {**dict.fromkeys(PROVIDERS, "provider"), "simulated": "simulated", "replay": "replay"}
    kinds |= dict.fromkeys(plugins.entries("models"), "plugin")
    kind = kinds.get(provider)
    if kind is None and colon and provider in EXTRAS:
        raise ExtraMissing(f"--model {text}", provider)
    if kind is None and _OWN.fullmatch(text):
        return ModelName(text=text, kind="own", provider="own", model=model)
    if kind is None or not colon:
        says = unknown(f"provider {provider!r}", provider, (*kinds, "package.module:Class")) if colon else ""
        if provider.isidentifier() and model.isidentifier():
            says += " (a class of your own begins with a capital letter)"
        raise InputError("model", text, model_forms(), says=says)
    if not model:
        expected = {"simulated": "a profile", "replay": "a file"}.get(provider, "a model name")
        if kind == "plugin":
            expected = plugins.load("models", provider).expects
        raise InputError("model", text, f"{expected} after '{provider}:'")
    if kind == "provider" and re.search(r"[\s,=]", model):
        raise InputError("model", text, "a model name without spaces, commas or '='; ranges are written 0-4=A,5-9=B")
    return ModelName(text=text, kind=kind, provider=provider, model=model)


def cost_usd(provider: str | None, model: str, usage: Usage) -> float | None:
    """Price of one call by the installed lists [US dollars], None if unknown; nothing is downloaded."""
    provider = "openai" if provider == "openai-responses" else provider
    if provider not in ("openai", "anthropic", "deepseek"):
        return None
    from genai_prices import calc_price
    from genai_prices.types import Usage as PricedUsage

    tokens = PricedUsage(
        input_tokens=usage.input, output_tokens=usage.output, cache_read_tokens=min(usage.cached, usage.input)
    )
    try:
        return float(calc_price(tokens, model, provider_id=provider).total_price)
    except LookupError:
        return None


def parse_base_urls(text: str | None, models: Iterable[str]) -> dict[str, str]:
    """Addresses that replace those of the providers in use: one URL, or `provider=URL,provider=URL`.

    Raises:
        InputError: for field `base_url`: not an http(s) address, a password in it, a provider that is not in use, one
            address for several providers (each would get the other's key), or a provider without an address.
    """
    used = {name.provider: name.info for name in map(parse_model, models) if name.kind == "provider"}
    urls: dict[str, str] = {}
    if text and re.match(r"\s*[a-z-]+\s*=", text):
        for part in text.split(","):
            provider, _, url = (piece.strip() for piece in part.partition("="))
            if provider not in used:
                raise InputError("base_url", provider, f"a provider in use: {', '.join(used) or 'none is'}")
            urls[provider] = check_url(url)
    elif text:
        if len(used) > 1:
            raise InputError("base_url", "one address", f"provider=URL,... as {', '.join(used)} are in use")
        urls = dict.fromkeys(used, check_url(text.strip()))
    for provider, info in used.items():
        if info.base_url is None and provider not in urls:
            raise InputError("base_url", None, f"an address for '{provider}', such as http://localhost:8000/v1")
    return urls


def check_url(url: str) -> str:
    """The address without a trailing slash; InputError for a user name, password or query, which records would show."""
    try:
        parts = urlsplit(url)
        host, secret, port = parts.hostname, parts.username or parts.password, parts.port
    except ValueError:
        raise InputError("base_url", url, "http://HOST[:PORT]/PATH or https://...") from None
    if len(url) > MAX_URL_LENGTH or hidden(url) is not None:
        raise InputError("base_url", url, f"at most {MAX_URL_LENGTH} visible characters")
    if secret:
        raise InputError("base_url", f"{parts.scheme}://...@{host}", "an address without a user name or password")
    if parts.query or parts.fragment:
        raise InputError("base_url", f"{parts.scheme}://{host}...?...", "an address without a query or a fragment")
    if parts.scheme not in {"http", "https"} or not host or port == 0:
        raise InputError("base_url", url, "http://HOST[:PORT]/PATH or https://...")
    bare = url.rstrip("/").removesuffix("/chat/completions")
    if bare != url.rstrip("/"):
        raise InputError("base_url", url, f"{bare}, to which this path is added")
    return bare


@dataclass(frozen=True, slots=True, kw_only=True)
class Habits:
    """How to ask a model, where the configuration leaves it open.

    Attributes:
        prompts: name of a packaged set of prompts.
        frame: coordinates of the prompts.
        plans: whether to ask it for this plan, which else comes from geometry; None asks for all.
        taught: whether it was taught the plan of this mission; None where that is not known.
        contained: whether it costs nothing, uses no network and reads no file outside installed packages.
        simulated: whether it is a stand-in, which all output must state.
    """

    prompts: str = "full"
    frame: FrameName = "world"
    plans: Callable[[PlanQuestion], bool] | None = None
    taught: Callable[[Mission], bool] | None = None
    contained: bool = False
    simulated: bool = False


class ModelHost(Protocol):
    """Holds what the models of one team share, such as an engine."""

    def model(self, text: str, settings: CallSettings | None) -> LanguageModel:
        """The model of one robot, named as in the configuration; InputError if it certainly cannot work."""
        ...

    async def aclose(self) -> None:
        """Release everything. Do not ask a model of this host afterwards."""
        ...


class ModelSource(Protocol):
    """A plug-in of the kind `models`; its name is the prefix.

    Attributes:
        expects: what follows the prefix, as a phrase for error messages.
        example: a model string that works.
    """

    expects: str
    example: str

    @property
    def at_once(self) -> int:
        """Number of questions that it answers at the same time; the time-outs of others begin later."""
        ...

    def host(self) -> ModelHost:
        """A host for one team, which loads nothing before the first question."""
        ...

    def habits(self, model: str) -> Habits:
        """How to ask a model, by the part of its name after the prefix. Reads no file."""
        ...

    def digests(self, model: str) -> Mapping[str, str]:
        """Digests of the model's files by name; InputError if one is missing or unfit."""
        ...

    def versions(self, model: str) -> Mapping[str, str]:
        """As `digests`, with the files that were made from them, for records."""
        ...


def source_of(prefix: str) -> ModelSource:
    """The plug-in of this prefix; KeyError if there is none, FieldError if it cannot be imported."""
    from llm_flock import plugins

    return plugins.load("models", prefix)


def habits_of(text: str) -> Habits:
    """How to ask the model of this name; the defaults without a plug-in of its prefix."""
    prefix, _, model = text.partition(":")
    if not model:
        return Habits()
    from llm_flock import plugins

    if prefix in plugins.entries("models"):
        return source_of(prefix).habits(model)
    return Habits(simulated=prefix == "simulated")
