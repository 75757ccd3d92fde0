"""Models on board without their engine: the questions that reach it, who shares it, and how much it may take."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pytest
from gguf_files import write_model

from llm_flock.errors import InputError, ModelError
from llm_flock.llm._client import CallSettings
from llm_flock.llm._models import ModelPool
from llm_flock.llm._port import AnswerForm, Call, ChatMessage, Reply, Usage
from llm_flock.llm._providers import parse_model
from llm_flock_onboard._local import engine, weights
from llm_flock_onboard._local.engine import Engines, check_memory, slot_count, thread_count
from llm_flock_onboard._local.model import MIN_CONTEXT, EngineLeases, LocalModel, context_for
from llm_flock_onboard._local.weights import Weights


class StandIn:
    """An engine that answers when it is told to."""

    def __init__(self, files, context):
        self.weights, self.context = files, context
        self.bodies: list[dict] = []
        self.stops: list[threading.Event] = []
        self.answer: Future[Reply] = Future()
        self.closed = 0
        self.answer.set_result(
            Reply(
                text="Position: [1, 2]",
                model="",
                usage=Usage(input=9, output=5, cached=4),
                finish_reason="length",
                thought=True,
            )
        )

    def submit(self, body, stop):
        self.bodies.append(dict(body))
        self.stops.append(stop)
        return self.answer

    def close(self):
        self.closed += 1


@pytest.fixture(autouse=True)
def engine_there(monkeypatch):
    monkeypatch.setattr(weights.util, "find_spec", lambda name: object())
    monkeypatch.setattr(engine, "Engine", StandIn)


@pytest.fixture
def file(tmp_path):
    return write_model(tmp_path / "m.gguf")


def the_engine(engines: Engines) -> StandIn:
    """The only one that is loaded."""
    (engine,) = engines._users
    assert isinstance(engine, StandIn)
    return engine


def question(form: AnswerForm | None = None, text: str = "Where to?", schema=None) -> Call:
    messages = (ChatMessage("system", "Be brief."), ChatMessage("user", text))
    return Call(robot=0, round=1, kind="step", attempt=0, messages=messages, form=form, schema=schema)


def test_a_call_is_asked_in_its_form_and_costs_nothing(file):
    engines = Engines()
    form = AnswerForm(n=3, dim=2)

    async def go():
        leases = EngineLeases(engines)
        model = LocalModel(f"local:{file}", leases)
        reply = await model.ask(question(form))
        leased = the_engine(engines)
        await leases.aclose()
        return model, reply, leased

    model, reply, leased = asyncio.run(go())
    assert model.name == reply.model == f"local:{file}"
    assert reply.text == "Position: [1, 2]" and reply.cost_usd == 0.0
    assert reply.usage == Usage(input=9, output=5, cached=4)
    assert reply.settings == {"temperature": 0.0}
    (body,) = leased.bodies
    assert body["messages"] == [{"role": "system", "content": "Be brief."}, {"role": "user", "content": "Where to?"}]
    assert body["temperature"] == 0.0 and "Position: " in body["grammar"] and body["max_tokens"] > 50
    assert leased.closed == 1 and engines.running == 0


def test_what_every_answer_begins_with_is_put_into_its_mouth(file):
    async def go():
        engines = Engines()
        leases = EngineLeases(engines)
        reply = await LocalModel(f"local:{file}", leases).ask(question(AnswerForm(n=3, dim=2, reasons=False)))
        leased = the_engine(engines)
        await leases.aclose()
        return reply, leased.bodies[0]

    reply, body = asyncio.run(go())
    assert reply.text == "Position:Position: [1, 2]", "what the engine says, which is only the rest"
    assert body["messages"][-1] == {"role": "assistant", "content": "Position:"}
    assert "Position" not in body["grammar"]


def test_without_a_form_a_schema_holds_the_answer(file):
    async def go(call):
        engines = Engines()
        leases = EngineLeases(engines)
        await LocalModel(f"local:{file}", leases, CallSettings(temperature=0.7, seed=3)).ask(call)
        leased = the_engine(engines)
        return leased.bodies[0]

    body = asyncio.run(go(question(schema={"type": "object"})))
    assert body["json_schema"] == {"type": "object"} and "grammar" not in body
    assert body["temperature"] == 0.7 and body["seed"] == 3
    assert "json_schema" not in asyncio.run(go(question()))


def test_robots_and_runs_share_one_engine_while_in_use(file):
    engines = Engines()

    async def go():
        first, second = EngineLeases(engines), EngineLeases(engines)
        models = [LocalModel(f"local:{file}", leases) for leases in (first, first, second)]
        await asyncio.gather(*(model.ask(question()) for model in models))
        leased = the_engine(engines)
        assert len(leased.bodies) == 3
        await first.aclose()
        assert leased.closed == 0 and engines.running == 1
        await second.aclose()
        assert leased.closed == 1 and engines.running == 0

    asyncio.run(go())


def test_an_engine_that_holds_too_little_is_not_shared(file):
    engines = Engines()
    small, large = engines.lease(Weights(file), 256), engines.lease(Weights(file), 512)
    assert small is not large
    assert engines.lease(Weights(file), 300) is large


def test_context_follows_the_question_up_to_the_trained_length(file):
    few, many = AnswerForm(n=3, dim=2, reasons=False), AnswerForm(n=200, dim=3)
    assert context_for(question(few)) == MIN_CONTEXT
    plan = Call(robot=0, round=1, kind="plan", attempt=0, messages=question().messages, form=many)
    assert context_for(plan) > 8 * context_for(question(few))
    context = context_for(question(text="1 " * 3000))
    assert context & (context - 1) == 0 and context >= 2 * 4000

    async def go():
        engines = Engines()
        await LocalModel(f"local:{file}", EngineLeases(engines)).ask(question())
        return next(iter(engines._users)).context

    assert asyncio.run(go()) == 512  # as the file says


def test_cancelled_question_stops_the_answer(file):
    async def go():
        engines = Engines()
        model = LocalModel(f"local:{file}", EngineLeases(engines))
        await model.ask(question())
        leased = the_engine(engines)
        leased.answer = Future()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.01):
                await model.ask(question())
        return leased.stops[-1]

    assert asyncio.run(go()).is_set()


def test_faults_of_the_engine_are_model_errors(file):
    async def go():
        engines = Engines()
        model = LocalModel(f"local:{file}", EngineLeases(engines))
        await model.ask(question())
        leased = the_engine(engines)
        leased.answer = Future()
        leased.answer.set_exception(ModelError("refused", "too long"))
        await model.ask(question())

    with pytest.raises(ModelError, match="too long"):
        asyncio.run(go())


def test_a_cap_shortens_an_answer_and_never_lengthens_it(file):
    async def go(settings):
        engines = Engines()
        reply = await LocalModel(f"local:{file}", EngineLeases(engines), settings).ask(question())
        return the_engine(engines).bodies[-1]["max_tokens"], reply

    longest, reply = asyncio.run(go(CallSettings()))
    assert (reply.finish_reason, reply.thought) == ("length", True)
    assert asyncio.run(go(CallSettings(max_tokens=7)))[0] == 7 < longest
    assert asyncio.run(go(CallSettings(max_tokens=10**6)))[0] == longest


def test_a_reasoning_effort_is_refused(file):
    with pytest.raises(InputError, match="reasoning_effort"):
        LocalModel(f"local:{file}", EngineLeases(), CallSettings(reasoning="low"))


def test_the_pool_builds_models_on_board_without_loading_them(file):
    model = ModelPool(environ={}).model(f"local:{file}", rng=np.random.default_rng(0))
    assert isinstance(model, LocalModel)
    assert engine.ENGINES.running == 0
    name = parse_model(f"local:{file}")
    assert (name.kind, name.provider, name.model) == ("plugin", "local", str(file))
    with pytest.raises(InputError, match="smollm2 or a GGUF file"):
        parse_model("local:")


def test_model_too_large_for_the_memory_is_not_loaded(file):
    check_memory(Weights(file), 1000, free=2**30)
    with pytest.raises(InputError, match=r"takes about 0.3 GiB, 0.2 GiB are free"):
        check_memory(Weights(file), 1000, free=2**28)
    with pytest.raises(InputError, match="are free"):
        check_memory(Weights(file), 10**12)  # by what this machine tells of itself


def test_one_core_is_left_to_the_rest(monkeypatch):
    for cores, threads, slots in ((1, 1, 4), (2, 1, 4), (4, 3, 6), (64, 63, 16)):
        monkeypatch.setattr(engine, "cores", lambda cores=cores: cores)
        assert (thread_count(), slot_count()) == (threads, slots)


def test_cores_are_those_of_this_process(monkeypatch):
    monkeypatch.setattr(engine, "os", SimpleNamespace(cpu_count=lambda: None))
    assert engine.cores() == 1


def test_engine_still_loading_is_stopped_with_the_pool(file, monkeypatch):
    loading, engines = threading.Event(), Engines()
    made: list[StandIn] = []

    class Slow(StandIn):
        def __init__(self, *args):
            loading.wait(10)
            super().__init__(*args)
            made.append(self)

    monkeypatch.setattr(engine, "Engine", Slow)

    async def go():
        leases = EngineLeases(engines)
        asked = asyncio.create_task(LocalModel(f"local:{file}", leases).ask(question()))
        await asyncio.sleep(0.01)
        asked.cancel()
        closing = asyncio.create_task(leases.aclose())
        await asyncio.sleep(0.01)
        loading.set()
        await closing
        assert asked.cancelled()

    asyncio.run(go())
    assert made[0].closed == 1 and engines.running == 0


def test_engine_that_cannot_be_loaded_fails_every_question(file, monkeypatch):
    def fail(*_):
        raise InputError("model", str(file), "what the engine can load")

    monkeypatch.setattr(engine, "Engine", fail)

    async def go():
        leases = EngineLeases(Engines())
        models = [LocalModel(f"local:{file}", leases) for _ in range(3)]
        told = await asyncio.gather(*(model.ask(question()) for model in models), return_exceptions=True)
        await leases.aclose()
        return told

    assert all(isinstance(error, InputError) for error in asyncio.run(go()))
