"""llama.cpp inside this process, through xllamacpp: one engine for all robots of all runs that use the same files.

Questions are function calls, each in a thread that waits for the answer. The library's HTTP server cannot be left out;
it listens on a Unix socket in a folder that only this user may open, so that no port is opened.
"""

from __future__ import annotations

import os
import secrets
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future
from importlib import import_module
from pathlib import Path
from typing import Any

from llm_flock.errors import InputError, ModelError
from llm_flock.llm import Reply, Usage
from llm_flock_onboard._local.gguf import read_header
from llm_flock_onboard._local.weights import Weights

STOPPED = "the engine was stopped"

CLOSE_S = 10.0
"""Longest wait for answers that are cut short [s]; an engine that hangs must not keep the process alive."""


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count() -> int:
    """Threads that compute. One core is left free: with all of them busy, generation is many times slower."""
    return max(1, cores() - 1)


def slot_count() -> int:
    """Questions answered at once: few, because they share cores and memory."""
    return min(16, max(4, 2 * thread_count()))


class Engine:
    """One loaded model, for many threads at once; InputError if it cannot load the files.

    Each question answered at once has a context of its own, the longest question with its answer [tokens].
    """

    def __init__(self, weights: Weights, context: int) -> None:
        self.weights = weights
        self.context = context
        self.slots = slot_count()
        self._free_slots = threading.Semaphore(self.slots)
        self._threads: set[threading.Thread] = set()
        self._closing = threading.Event()
        self._folder = Path(tempfile.mkdtemp(prefix="llm-flock-"))
        try:
            self._server: Any = self._load()
        except BaseException:
            self.close()
            raise

    def _load(self) -> Any:
        tokens = self.slots * self.context
        check_memory(self.weights, tokens)
        library: Any = import_module("xllamacpp")  # takes 100 MB: imported only where it is used
        files = self.weights.loaded()
        params = library.CommonParams()
        params.model.path = str(files[0])
        if self.weights.adapter is not None:
            params.lora_adapters = [library.CommonAdapterLoraInfo(str(self.weights.adapter), 1.0)]
        params.n_parallel = self.slots
        params.n_ctx = tokens
        # A context for each question: in a shared one, a question that is too long ends all the others.
        params.kv_unified = False
        params.n_batch = params.n_ubatch = 512  # memory for intermediate results grows with it
        params.cpuparams.n_threads = params.cpuparams_batch.n_threads = thread_count()
        params.cache_ram_mib = params.n_ctx_checkpoints = 0
        params.enable_reasoning = 0
        params.fit_params = params.warmup = params.ui = params.endpoint_slots = False
        params.endpoint_metrics = True
        params.verbosity = -1  # it logs nothing
        params.api_keys = [secrets.token_hex(16)]
        params.hostnames = [str(self._folder / "engine.sock") if hasattr(socket, "AF_UNIX") else "127.0.0.1"]
        try:
            server = library.Server(params)
            # The engine's thread answers, so it has started. Stopped before that, it would never end.
            server.handle_metrics()
        except RuntimeError:
            names = " and ".join(map(str, files))
            allowed = f"what the engine can load: {names} may be damaged, of a kind it does not know, or too large"
            raise InputError("model", str(files[0]), allowed) from None
        return server

    def submit(self, body: Mapping[str, Any], stop: threading.Event) -> Future[Reply]:
        """Answer a request as llama.cpp's server takes it, or fail with ModelError; set `stop` to cut it short."""
        answer: Future[Reply] = Future()
        # A daemon: the process can end while the engine works.
        thread = threading.Thread(target=self._work, args=(answer, dict(body), stop), name="engine", daemon=True)
        self._threads.add(thread)
        thread.start()
        return answer

    def _work(self, answer: Future[Reply], body: dict[str, Any], stop: threading.Event) -> None:
        with self._free_slots:
            if answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(self._ask(body, stop))
                except Exception as error:  # noqa: BLE001 - the caller gets it with the answer
                    answer.set_exception(error)
        self._threads.discard(threading.current_thread())

    def _ask(self, body: dict[str, Any], stop: threading.Event) -> Reply:
        text, reasons, thoughts = list[str](), list[str](), list[str]()
        used: dict[str, Any] = {}
        errors: list[dict[str, Any]] = []

        def take(chunk: dict[str, Any]) -> bool:
            if "error" in chunk:
                errors.append(chunk["error"])
            for choice in chunk.get("choices", ()):
                delta: dict[str, Any] = choice.get("delta") or {}
                text.append(delta.get("content") or "")
                thoughts.append(delta.get("reasoning_content") or "")
                reasons.append(choice.get("finish_reason") or "")
            used.update(chunk.get("usage") or {})
            return stop.is_set() or self._closing.is_set()

        server = self._server
        if server is None or self._closing.is_set():
            raise ModelError("refused", STOPPED)
        try:
            server.handle_chat_completions({**body, "stream": True, "stream_options": {"include_usage": True}}, take)
        except (ValueError, RuntimeError) as error:
            raise ModelError("refused", f"the engine does not take this question: {error}") from None
        if errors:
            kind = "server" if errors[0].get("code", 0) >= 500 else "refused"
            raise ModelError(kind, str(errors[0].get("message", "the engine does not say why")))
        if self._closing.is_set():
            raise ModelError("refused", STOPPED)
        details: dict[str, int] = used.get("prompt_tokens_details") or {}
        usage = Usage(
            input=used.get("prompt_tokens", 0),
            output=used.get("completion_tokens", 0),
            cached=details.get("cached_tokens", 0),
        )
        reason = next(filter(None, reversed(reasons)), None)
        return Reply(text="".join(text), model="", usage=usage, finish_reason=reason, thought=any(thoughts))

    def close(self) -> None:
        """Stop at once and cut answers short; may be called again."""
        self._closing.set()
        end = time.monotonic() + CLOSE_S
        for thread in tuple(self._threads):
            thread.join(max(0.0, end - time.monotonic()))
        self._server = None  # the last reference: the engine's own threads end with it
        shutil.rmtree(self._folder, ignore_errors=True)


def check_memory(weights: Weights, tokens: int, free: int | None = None) -> None:
    """Refuse weights that do not fit into memory: the system would kill this process without a message.

    `tokens` is the total context of all questions answered at once; `free` memory is asked of the system [bytes].
    """
    free = _free_bytes() if free is None else free
    needed = sum(file.stat().st_size for file in weights.loaded())
    # 256 MiB are an upper estimate of the engine's memory beside weights and cache.
    needed += tokens * read_header(weights.model).cache_bytes + 256 * 2**20
    if free is not None and needed > free:
        allowed = f"a model that fits: this one takes about {needed / 2**30:.1f} GiB, {free / 2**30:.1f} GiB are free"
        raise InputError("model", str(weights.model), allowed)


def _free_bytes() -> int | None:
    """Free memory [bytes], None where the system does not tell."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    found = (line.split()[1] for line in lines if line.startswith("MemAvailable:"))
    return next((int(kib) * 1024 for kib in found), None)


class Engines:
    """The engines of one process: each is shared, and stopped with its last user."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users: dict[Engine, int] = {}

    def lease(self, weights: Weights, context: int) -> Engine:
        """An engine with these files and at least this context, loaded if there is none. Pair with `give_back`."""
        with self._lock:
            fit = (e for e in self._users if e.weights == weights and e.context >= context)
            engine = next(fit, None) or Engine(weights, context)
            self._users[engine] = self._users.get(engine, 0) + 1
            return engine

    def give_back(self, engine: Engine) -> None:
        """End one lease; the engine stops with the last one."""
        with self._lock:
            self._users[engine] -= 1
            if self._users[engine]:
                return
            del self._users[engine]
        engine.close()

    @property
    def running(self) -> int:
        """Number of loaded engines."""
        return len(self._users)


ENGINES = Engines()
"""The engines of this process."""
