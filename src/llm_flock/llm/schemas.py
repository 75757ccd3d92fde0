"""JSON schemas of answers, for providers that hold a model to one."""

from __future__ import annotations

from typing import Any

from llm_flock.llm.port import AnswerForm, Kind


def answer_schema(kind: Kind, form: AnswerForm) -> dict[str, Any]:
    """JSON schema of an answer in this form."""
    if kind == "plan":
        return plan_schema(form.n, form.dim)
    return step_schema(form.dim) if form.horizon == 1 else path_schema(form.horizon, form.dim)


def plan_schema(n: int, dim: int) -> dict[str, Any]:
    """JSON schema of an answer to the plan question."""
    points = {"type": "array", "items": _point_schema(dim), "minItems": n, "maxItems": n}
    return _object_schema({"plan": points, "my_plan": {"type": "integer", "minimum": 0, "maximum": n - 1}})


def step_schema(dim: int) -> dict[str, Any]:
    """JSON schema of an answer to the step question."""
    return _object_schema({"position": _point_schema(dim)})


def path_schema(horizon: int, dim: int) -> dict[str, Any]:
    """JSON schema of an answer to the step question where it may be a path."""
    return _object_schema({"path": {"type": "array", "items": _point_schema(dim), "minItems": 1, "maxItems": horizon}})


def _point_schema(dim: int) -> dict[str, Any]:
    return {"type": "array", "items": {"type": "number"}, "minItems": dim, "maxItems": dim}


def _object_schema(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}
