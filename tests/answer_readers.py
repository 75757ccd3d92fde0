"""Read an answer of one kind: a shorthand for tests, without an `AnswerForm` at each call."""

from __future__ import annotations

from llm_flock.arrays import Point
from llm_flock.llm._answers import read_plan, read_waypoints
from llm_flock.llm._port import AnswerForm
from llm_flock.plan import Plan


def parse_plan(text: str, n: int, dim: int, *, json: bool = False) -> tuple[Plan, int]:
    return read_plan(text, AnswerForm(n=n, dim=dim, json=json))


def parse_plan_json(text: str, n: int, dim: int) -> tuple[Plan, int]:
    return parse_plan(text, n, dim, json=True)


def parse_step(text: str, dim: int, *, json: bool = False) -> Point:
    (point,) = read_waypoints(text, AnswerForm(n=1, dim=dim, json=json))
    return point


def parse_step_json(text: str, dim: int) -> Point:
    return parse_step(text, dim, json=True)


def parse_path(text: str, horizon: int, dim: int, *, json: bool = False) -> tuple[Point, ...]:
    return read_waypoints(text, AnswerForm(n=1, dim=dim, horizon=horizon, json=json))


def parse_path_json(text: str, horizon: int, dim: int) -> tuple[Point, ...]:
    return parse_path(text, horizon, dim, json=True)
