"""`run` as a program, an editor and a notebook see it."""

import asyncio
import inspect
import threading
import typing
from concurrent.futures import Future
from pathlib import Path
from typing import Annotated, Any, Unpack, get_args, get_origin

import numpy as np
import pytest

import llm_flock
from llm_flock.errors import InputError
from llm_flock.llm._limits import CallLane
from llm_flock.llm._own import ModelChoice
from llm_flock.runtime._api import Parameters, wait_for
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._result import RunResult
from llm_flock.runtime._trial import TrialProgress

SURROUNDINGS = {"config", "on_round", "progress", "trace", "sink", "lane", "steer"}
WIDER = {"consensus", "assignment", "model", "temperature", "model_seed", "prompts", "record_llm", "out"}
SMALL: dict[str, Any] = {"shape": "triangle", "n_robots": 3, "seed": 1}


def plain(annotation: Any) -> str:
    """A type without limits, and with every sequence alike: users may give lists where the configuration has tuples."""
    if get_origin(annotation) is Annotated:
        return plain(get_args(annotation)[0])
    if get_origin(annotation) in (tuple, typing.get_origin(typing.Sequence[int])):
        inner = sorted({plain(part) for part in get_args(annotation) if part is not Ellipsis})
        return f"rows of {' '.join(inner).replace(' | Mapping', '')}"
    if get_origin(annotation) in (typing.Union, type(int | None)):
        return " | ".join(sorted(plain(part) for part in get_args(annotation) if get_origin(part) is not MAPPING))
    return getattr(annotation, "__name__", None) if not get_args(annotation) else str(annotation)  # type: ignore[return-value]


MAPPING = typing.get_origin(typing.Mapping[str, int])


def test_the_signature_has_every_field_of_the_configuration() -> None:
    hints = typing.get_type_hints(Parameters, None, {"CallLane": CallLane, "ModelChoice": ModelChoice})
    fields: dict[str, Any] = {}
    for section in RunConfig.model_fields.values():
        kind: Any = section.annotation
        fields |= kind.model_fields
    assert set(hints) - SURROUNDINGS == set(fields)
    for name, field in fields.items():
        if name not in WIDER:
            assert plain(hints[name]) == plain(field.annotation), name


def test_both_functions_show_it_and_say_what_they_return() -> None:
    run, run_async = inspect.signature(llm_flock.run), inspect.signature(llm_flock.run_async)
    assert run.parameters == run_async.parameters
    assert typing.get_type_hints(llm_flock.run)["given"] == Unpack[Parameters]
    assert run.return_annotation == run_async.return_annotation == RunResult.__name__
    assert inspect.iscoroutinefunction(llm_flock.run_async)


def test_values_may_be_paths_and_arrays(tmp_path: Path) -> None:
    start = np.array([[40.0, 40.0], [60.0, 40.0], [50.0, 60.0]])
    arrays: dict[str, Any] = {"start_positions": start, "center": np.array([50, 50]), "max_step": np.float64(5)}
    result = llm_flock.run(**SMALL, **arrays, out=tmp_path)
    assert np.array_equal(result.positions[0], start) and (tmp_path / "run.mcap").exists()
    for path in (tmp_path, str(tmp_path), tmp_path / "run.mcap", str(tmp_path / "run.mcap")):
        assert np.array_equal(llm_flock.read_record(path).positions, result.positions)


def test_given_defaults_override_the_mission() -> None:
    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    assert llm_flock.run(mission, rounds=0).summary.n_robots == 3
    assert llm_flock.run(mission, shape="circle", n_robots=10, rounds=0).summary.n_robots == 10
    with pytest.raises(InputError, match="either config"):
        llm_flock.run(config=RunConfig(), seed=0)
    with pytest.raises(InputError, match="a Mission"):
        llm_flock.run("circle")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="nonsense"):
        llm_flock.run(nonsense=3)  # pyright: ignore[reportCallIssue]


def test_run_works_inside_a_running_event_loop() -> None:
    async def cell() -> tuple[Any, Any]:
        return llm_flock.run(**SMALL), await llm_flock.run_async(**SMALL)

    blocking, awaited = asyncio.run(cell())
    assert np.array_equal(blocking.positions, awaited.positions)
    assert np.array_equal(blocking.positions, llm_flock.run(**SMALL).positions)


def test_errors_come_through_a_running_loop() -> None:
    async def cell() -> None:
        llm_flock.run(n_robots=0)

    with pytest.raises(InputError, match="n_robots"):
        asyncio.run(cell())


def test_a_run_may_start_another() -> None:
    found: list[bool] = []

    def again(now: TrialProgress) -> None:
        if now.round == 1:
            found.append(llm_flock.run(**SMALL).formed)

    async def cell() -> None:
        llm_flock.run(**SMALL, on_round=again)

    asyncio.run(cell())
    assert found == [True]


def test_ctrl_c_in_a_notebook_ends_the_run_before_it_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended = threading.Event(), threading.Event()

    async def forever() -> None:
        begun.set()
        try:
            await asyncio.sleep(3600)
        finally:
            ended.set()

    class Interrupted(Future[Any]):
        def result(self, timeout: float | None = None) -> Any:
            begun.wait()
            raise KeyboardInterrupt

    monkeypatch.setattr("concurrent.futures._base.Future", Interrupted)

    async def cell() -> None:
        wait_for(forever())

    with pytest.raises(KeyboardInterrupt):
        asyncio.run(cell())
    assert ended.is_set()


def test_an_error_in_a_script_begins_with_itself() -> None:
    async def failing() -> None:
        raise ValueError("mine")

    with pytest.raises(ValueError, match="mine") as caught:
        wait_for(failing())
    assert caught.value.__context__ is None, "no running event loop ... during handling"
