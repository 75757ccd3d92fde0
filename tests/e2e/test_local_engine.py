"""Models on board with their real engine: seconds each, no network."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
import time

import pytest
from answer_readers import parse_path, parse_plan, parse_plan_json, parse_step, parse_step_json
from gguf_files import write_model

from llm_flock.errors import AnswerError, InputError, ModelError
from llm_flock.llm._client import CallSettings
from llm_flock.llm._port import AnswerForm, Call, ChatMessage
from llm_flock.llm._thoughts import whole_answer
from llm_flock_onboard._local.engine import ENGINES, Engine, slot_count
from llm_flock_onboard._local.model import EngineLeases, LocalModel
from llm_flock_onboard._local.weights import Weights, find_weights

pytest.importorskip("xllamacpp")
pytestmark = pytest.mark.usefixtures("own_cache")

STOCK = "local:smollm2+none"
MISSION = {"shape": "line", "n_robots": 2, "center": [10, 10], "arena": [[0, 0], [20, 20]], "spacing": 6}


def question(kind, form: AnswerForm, text: str, robot: int = 0) -> Call:
    messages = (ChatMessage("system", "You steer a robot. Answer in numbers."), ChatMessage("user", text))
    return Call(robot=robot, round=1, kind=kind, attempt=0, messages=messages, form=form)


@pytest.fixture(scope="module")
def engine(own_cache):
    engine = Engine(find_weights("smollm2+none"), 512)
    yield engine
    engine.close()


async def ask(call: Call, **settings):
    leases = EngineLeases()
    try:
        return await LocalModel(STOCK, leases, CallSettings(**settings)).ask(call)
    finally:
        await leases.aclose()


def test_every_answer_is_in_the_form_that_was_asked_for():
    """However badly a model answers: at a high temperature it does."""
    forms = [
        ("step", AnswerForm(n=3, dim=2, reasons=False), lambda text: parse_step(text, 2)),
        ("step", AnswerForm(n=3, dim=3, horizon=2, reasons=False), lambda text: parse_path(text, 2, 3)),
        ("step", AnswerForm(n=3, dim=2, json=True), lambda text: parse_step_json(text, 2)),
        ("plan", AnswerForm(n=3, dim=2, reasons=False), lambda text: parse_plan(text, 3, 2)),
        ("plan", AnswerForm(n=2, dim=2, json=True), lambda text: parse_plan_json(text, 2, 2)),
        ("step", AnswerForm(n=3, dim=2), lambda text: parse_step(text, 2)),
    ]

    async def go():
        leases = EngineLeases()
        model = LocalModel(STOCK, leases, CallSettings(temperature=1.5, seed=1))
        calls = [question(kind, form, f"Robot {i}, where to?", i) for i, (kind, form, _) in enumerate(forms)]
        try:
            return await asyncio.gather(*map(model.ask, calls))
        finally:
            await leases.aclose()

    replies = asyncio.run(go())
    for (kind, form, reader), reply in zip(forms, replies, strict=True):
        assert reader(reply.text), (kind, form, reply.text)
        assert reply.usage.input > 20 and reply.usage.output > 5 and reply.cost_usd == 0.0
        assert (reply.finish_reason, reply.thought) == ("stop", False)
    assert ENGINES.running == 0


def test_a_capped_answer_says_that_it_was_cut_off():
    form = AnswerForm(n=3, dim=2, json=True)
    reply = asyncio.run(ask(question("plan", form, "Where to?"), max_tokens=4))
    assert (reply.finish_reason, reply.usage.output) == ("length", 4)
    with pytest.raises(AnswerError, match="cut off at 4 tokens"):
        whole_answer(reply)


def test_common_beginning_of_two_questions_is_read_once(engine):
    body = {"messages": [{"role": "system", "content": "Be brief. " * 20}], "max_tokens": 1}
    for place in ("here", "there"):
        asked = {**body, "messages": [*body["messages"], {"role": "user", "content": f"Robot {place}?"}]}
        told = engine.submit(asked, threading.Event()).result()
    assert told.usage.cached > 40


def test_too_long_question_is_refused_and_the_engine_goes_on(engine):
    body = {"messages": [{"role": "user", "content": "word " * 1000}], "max_tokens": 1}
    with pytest.raises(ModelError, match="exceeds the available context") as caught:
        engine.submit(body, threading.Event()).result()
    assert caught.value.kind == "refused"
    with pytest.raises(ModelError, match="does not take this question"):
        engine.submit({"messages": "none"}, threading.Event()).result()
    body["messages"] = [{"role": "user", "content": "Hello"}]
    assert engine.submit(body, threading.Event()).result().usage.output == 1


def test_answer_that_is_no_longer_needed_is_cut_short(engine):
    body = {"messages": [{"role": "user", "content": "Count."}], "max_tokens": 400, "ignore_eos": True}
    stop = threading.Event()
    answer = engine.submit(body, stop)
    time.sleep(0.5)
    stop.set()
    began = time.monotonic()
    assert answer.result().usage.output < 400
    assert time.monotonic() - began < 5


def test_a_stopped_engine_leaves_nothing_behind():
    before = set(threading.enumerate())
    engine = Engine(find_weights("smollm2+none"), 512)
    folder = engine._folder
    body = {"messages": [{"role": "user", "content": "Count."}], "max_tokens": 400, "ignore_eos": True}
    answers = [engine.submit(body, threading.Event()) for _ in range(slot_count() + 1)]
    time.sleep(0.5)
    assert folder.is_dir() and folder.stat().st_mode & 0o077 == 0
    engine.close()
    engine.close()
    assert not folder.exists() and engine._server is None
    assert all(answer.cancelled() or isinstance(answer.exception(), ModelError) for answer in answers)
    assert set(threading.enumerate()) <= before


STOP_AT_ONCE = """
from llm_flock_onboard._local.engine import Engine
from llm_flock_onboard._local.weights import find_weights
for _ in range(3):
    Engine(find_weights("smollm2+none"), 256).close()
"""


def test_an_engine_can_be_stopped_as_soon_as_it_is_loaded():
    """As by Ctrl-C while it loads; in a process of its own, which may hang."""
    subprocess.run([sys.executable, "-c", STOP_AT_ONCE], timeout=60, check=True)


def test_a_file_that_only_looks_like_a_model_is_refused(tmp_path):
    with pytest.raises(InputError, match="may be damaged"):
        Engine(Weights(write_model(tmp_path / "m.gguf")), 256)
