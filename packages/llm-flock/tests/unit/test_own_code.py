"""Classes of the user's own: how they are found, what they may do, and what a record says of them."""

import asyncio
import logging
import re
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from own_models import Echo

import llm_flock
from llm_flock import plugins
from llm_flock.errors import InputError, ModelError
from llm_flock.llm import _own as own
from llm_flock.llm._own import OwnModel
from llm_flock.llm._port import Call, ChatMessage, Reply, Usage
from llm_flock.llm._providers import parse_model
from llm_flock.runtime._rules import consensus_rule
from llm_flock.testing import check_model
from llm_flock.user_code import load_own

CALL = Call(robot=0, round=1, kind="plan", attempt=0, messages=(ChatMessage("user", "Plan?"),))

RULE = """
class Nobody:
    name = "nobody"
    def choose(self, own, heard): ...
"""

MODEL = '''
class Corners:
    """A stand-in that is of no use."""

    simulated = True
    asked = 0
    closed = 0

    async def ask(self, call):
        type(self).asked += 1
        return "no usable answer"

    async def aclose(self):
        type(self).closed += 1
'''


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder, forgotten by Python afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    for name in ("my_own_models", "my_own_rules"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


NAME = "own_models:Echo"


def test_a_rule_in_the_current_folder_is_found(folder: Path) -> None:
    (folder / "my_own_rules.py").write_text(RULE)
    assert consensus_rule("my_own_rules:Nobody").name == "nobody"
    assert sys.path[-1] == str(folder), "last: nothing that is installed is replaced"


def test_a_name_that_is_not_there_leaves_the_path_alone(folder: Path) -> None:
    before = list(sys.path)
    with pytest.raises(InputError, match="No module named 'my_own_rules'"):
        load_own("consensus", "my_own_rules:Nobody", "a rule")
    assert sys.path == before


def test_error_in_a_users_module_is_reported(folder: Path) -> None:
    (folder / "my_own_rules.py").write_text("def (\n")
    with pytest.raises(InputError, match=r"SyntaxError.*line 1"):
        load_own("consensus", "my_own_rules:Nobody", "a rule")


@pytest.mark.parametrize("text", ["a.b:Mine", "a.b:make", "mine:Mine", "__main__:f.<locals>.mine", "mine:Outer.Mine"])
def test_classes_have_names(text: str) -> None:
    assert parse_model(text).kind == "own"


@pytest.mark.parametrize("text", ["nobody:x", "nobody:gpt-5", "opnai:o3-mini", "1a:Mine", "a..b:Mine"])
def test_a_misspelt_provider_is_no_class(text: str) -> None:
    assert parse_model("openai:Mine").kind == "provider"
    with pytest.raises(InputError, match=r"package\.module:Class|did you mean 'openai'"):
        parse_model(text)


def test_lower_case_class_is_reported_to_need_a_capital() -> None:
    for text, told in (("my_models:answer", True), ("opnai:o3-mini", False), ("my_models", False), ("openai:", False)):
        with pytest.raises(InputError) as caught:
            parse_model(text)
        assert ("a class of your own begins with a capital letter" in caught.value.says) == told


def test_a_run_by_name_makes_one_object_and_closes_it(folder: Path) -> None:
    (folder / "my_own_models.py").write_text(MODEL)
    result = llm_flock.run(shape="triangle", n_robots=3, model="my_own_models:Corners", seed=1, out=folder / "run")
    made = sys.modules["my_own_models"].Corners
    assert made.closed == 1 and made.asked == result.summary.model_calls > 0
    assert result.summary.simulated and result.summary.models == ("my_own_models:Corners",)
    record = llm_flock.read_record(folder / "run")
    assert record.run.simulated and {entry.model for entry in record.llm} == {"my_own_models:Corners"}
    (told,) = record.run.unrepeatable or []
    assert "my_own_models:Corners" in told and "only the name" in told


def test_model_given_as_an_object_is_marked_unrepeatable(tmp_path: Path) -> None:
    result = llm_flock.run(n_robots=3, shape="triangle", model=Echo("x"), max_retries=0, rounds=1, out=tmp_path)
    assert result.summary.models == (NAME,) and not result.summary.simulated
    (told,) = llm_flock.read_record(tmp_path).run.unrepeatable or []
    assert "handed over as an object" in told and result.unrepeatable == (told,)


def test_a_model_for_each_robot() -> None:
    one = Echo("x")
    models = [one, "simulated:ideal", one]
    result = llm_flock.run(n_robots=3, shape="triangle", model=models, max_retries=0, rounds=1)
    assert result.config.model.model == f"0={NAME},1=simulated:ideal,2={NAME}"
    with pytest.raises(InputError, match="robot"):
        llm_flock.run(n_robots=4, shape="square", model=models)


@pytest.mark.parametrize("wrong", [Echo, object(), 3, [], [3]])
def test_object_that_is_no_model_is_rejected(wrong: Any) -> None:
    with pytest.raises(InputError) as caught:
        llm_flock.run(model=wrong)
    assert caught.value.field == "model"


def test_a_cassette_of_a_stand_in_stays_one(folder: Path) -> None:
    (folder / "my_own_models.py").write_text(MODEL)
    trial: dict[str, Any] = {"shape": "triangle", "n_robots": 3, "seed": 2, "max_retries": 0, "rounds": 1}
    llm_flock.run(**trial, model="my_own_models:Corners", record_llm=folder / "talk.jsonl")
    again = llm_flock.run(**trial, model=f"replay:{folder / 'talk.jsonl'}")
    assert again.summary.simulated and again.summary.model_calls


def ask(answer: Any) -> Reply:
    return asyncio.run(OwnModel(Echo(answer)).ask(CALL))


def test_text_is_a_reply() -> None:
    assert ask("Plan: \ud800").text == "Plan: ?"
    assert ask(Reply(text="a", model="openai:o3-mini", usage=Usage(input=3))).model == NAME


@pytest.mark.parametrize(
    ("answer", "kind"),
    [
        (None, "garbage"),
        (Reply(text=3, model=""), "garbage"),  # pyright: ignore[reportArgumentType]
        (Reply(text="", model="", usage=Usage(input=-1)), "garbage"),
        (Reply(text="", model="", cost_usd=float("nan")), "garbage"),
        (Reply(text="", model="", settings={"a": object()}), "garbage"),
        (TimeoutError(), "timeout"),
        (ConnectionResetError("reset"), "connection"),
        (ZeroDivisionError("1/0"), "refused"),
        (ModelError("rate_limit", "slow down"), "rate_limit"),
    ],
)
def test_unusable_answer_of_own_code_is_a_failed_call(answer: Any, kind: str) -> None:
    with pytest.raises(ModelError) as caught:
        ask(answer)
    assert caught.value.kind == kind


def test_a_fault_of_the_code_is_logged_once_with_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    model = OwnModel(Echo(ZeroDivisionError("1/0")))
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            with pytest.raises(ModelError, match="ZeroDivisionError: 1/0"):
                asyncio.run(model.ask(CALL))
    assert len(caplog.records) == 1 and caplog.records[0].exc_info


@pytest.mark.parametrize("field", ["consensus", "assignment"])
def test_object_that_is_no_rule_is_rejected(field: str) -> None:
    wrongs: list[Any] = [3, object(), type(consensus_rule("none"))]
    for wrong in wrongs:
        with pytest.raises(InputError, match=field):
            llm_flock.run(**{field: wrong})


def test_own_rules_are_marked_unrepeatable(folder: Path) -> None:
    (folder / "my_own_rules.py").write_text(RULE)
    named = llm_flock.run(n_robots=3, shape="triangle", rounds=1, consensus="my_own_rules:Nobody")
    assert named.config.protocol.consensus == "my_own_rules:Nobody"
    handed = llm_flock.run(n_robots=3, shape="triangle", rounds=1, consensus=consensus_rule("my_own_rules:Nobody"))
    for result in (named, handed):
        assert "my_own_rules:Nobody" in result.unrepeatable[0]
    assert llm_flock.run(n_robots=3, shape="triangle", rounds=1, consensus=consensus_rule("none")).unrepeatable == ()


def test_money_needs_a_price() -> None:
    with pytest.raises(InputError, match="known price"):
        llm_flock.run(model=Echo(), max_cost=1.0)


def test_check_model_takes_an_object_and_says_what_is_wrong() -> None:
    with pytest.raises(AssertionError, match=r"none of the .* answers"):
        check_model(Echo(Reply(text="hm", model="", usage=Usage(input=1))))
    with pytest.raises(AssertionError, match="is refused"):
        check_model("nomodule_at_all:Mine")


class Unspeakable(Exception):
    def __str__(self) -> str:
        raise ValueError("no words")


@pytest.mark.parametrize("raised", [asyncio.CancelledError(), SystemExit(0), Unspeakable()], ids=repr)
def test_any_exception_of_a_model_is_a_failed_call(raised: BaseException) -> None:
    """A cancellation of its own ended the run, and `sys.exit` with exit code 0."""

    class Raising:
        async def ask(self, call: Call) -> str:
            raise raised

    with pytest.raises(ModelError) as caught:
        asyncio.run(OwnModel(Raising()).ask(CALL))
    assert caught.value.kind == "refused" and type(raised).__name__ in str(caught.value)


def test_a_run_that_is_cancelled_is_cancelled_in_a_model_too() -> None:
    class Waiting:
        async def ask(self, call: Call) -> str:
            await asyncio.sleep(60.0)
            return ""

    async def stop() -> None:
        task = asyncio.create_task(OwnModel(Waiting()).ask(CALL))
        await asyncio.sleep(0.01)
        task.cancel()
        await task

    with pytest.raises(asyncio.CancelledError):
        asyncio.run(stop())


@pytest.mark.parametrize("closing", [RuntimeError("stuck"), None])
def test_a_model_that_cannot_be_closed_costs_no_result(
    closing: Exception | None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Closing(Echo):
        async def ask(self, call: Call) -> str:
            return "hm"

        async def aclose(self) -> None:
            if closing is not None:
                raise closing
            await asyncio.sleep(60.0)

    monkeypatch.setattr(own, "CLOSE_S", 0.05)
    asyncio.run(OwnModel(Closing(), name="mine:Closing").aclose())
    assert "mine:Closing could not be closed" in caplog.text


def test_a_stand_in_of_a_distribution_is_shown_as_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    entry = EntryPoint("stands", "own_models:SOURCE", "llm_flock.models")
    monkeypatch.setattr(plugins, "entries", lambda kind: {"stands": entry} if kind == "models" else {})
    trial: dict[str, Any] = {"shape": "triangle", "n_robots": 3, "max_retries": 0, "rounds": 1}
    for model, simulated in (("stands:in", True), ("0=stands:in,1-2=stands:up", True), ("stands:up", False)):
        out = tmp_path / model
        assert llm_flock.run(**trial, model=model, out=out).summary.simulated == simulated
        assert llm_flock.read_record(out).run.simulated == simulated


def test_the_guide_s_source_of_models_flies(monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[4] / "docs" / "how-to" / "extending.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    for name, words in (("my_models", "class Mine"), ("my_source", "class Source")):
        module = ModuleType(name)
        monkeypatch.setitem(sys.modules, name, module)
        exec(next(block for block in blocks if words in block), vars(module))
    announced = tomllib.loads(re.findall(r"^```toml\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[-1])
    (name, value), *more = announced["project"]["entry-points"]["llm_flock.models"].items()
    entry = EntryPoint(name, value, "llm_flock.models")
    monkeypatch.setattr(plugins, "entries", lambda kind: {name: entry} if kind == "models" else {})
    result = llm_flock.run(shape="triangle", n_robots=3, model=plugins.load("models", name).example)
    assert result.formed and result.summary.simulated and not more
    check_model("mine:triangle")
    with pytest.raises(InputError, match="a name after 'mine:'"):
        llm_flock.run(model="mine:")
