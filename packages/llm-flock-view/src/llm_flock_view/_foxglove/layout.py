"""The layout of a run in Foxglove and Lichtblick: the team from above, measurements, events and conversations.

Both programs import the file (Layouts, Import from file). Names of panels and fields are those that they export.
"""

from __future__ import annotations

import json
from typing import Any

from llm_flock.record import FRAME, PALETTE, SCENE_TOPIC
from llm_flock_view._foxglove.channels import ARENA, LOG, TRAILS

SCENE, ERROR, AGREEMENT, CLOSEST = "3D!team", "Plot!error", "Plot!agreement", "Plot!closest"
EVENTS, MIND = "RosOut!events", "RawMessages!mind"


def layout(arena: tuple[tuple[float, ...], tuple[float, ...]] = ((0.0, 0.0), (100.0, 100.0))) -> dict[str, Any]:
    """The layout as plain values; the camera looks from above at the whole arena, given by two corners [units]."""
    low, high = arena
    middle = [(a + b) / 2 for a, b in zip(low[:2], high[:2], strict=True)]
    width = max(b - a for a, b in zip(low[:2], high[:2], strict=True))
    return {
        "configById": {
            SCENE: _scene(middle, width),
            ERROR: _plot("Distance to the shape [units]", ("/metrics.procrustes_mean", "mean")),
            AGREEMENT: _plot(
                "Agreement",
                ("/metrics.plans_in_use", "plans"),
                ("/metrics.distinct_goals", "goals"),
                ("/metrics.robots_at_goal", "at goal"),
            ),
            CLOSEST: _plot("Smallest distance of two robots [units]", ("/metrics.segment_separation", "closest")),
            EVENTS: {"topicToRender": LOG, "minLogLevel": 1, "searchTerms": []},
            MIND: {"topicPath": "/llm", "diffEnabled": False, "diffMethod": "custom", "diffTopicPath": ""},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 2},
        "layout": {
            "direction": "row",
            "splitPercentage": 58,
            "first": {"direction": "column", "splitPercentage": 76, "first": SCENE, "second": EVENTS},
            "second": {
                "direction": "column",
                "splitPercentage": 25,
                "first": ERROR,
                "second": {
                    "direction": "column",
                    "splitPercentage": 34,
                    "first": AGREEMENT,
                    "second": {"direction": "column", "splitPercentage": 45, "first": CLOSEST, "second": MIND},
                },
            },
        },
    }


def layout_text(arena: tuple[tuple[float, ...], tuple[float, ...]] | None = None) -> str:
    return json.dumps(layout() if arena is None else layout(arena), indent=2) + "\n"


def _scene(middle: list[float], width: float) -> dict[str, Any]:
    return {
        "cameraState": {
            "distance": 1.3 * width,
            "perspective": False,
            "phi": 0,
            "target": [0, 0, 0],
            "targetOffset": [*middle, 0],
            "targetOrientation": [0, 0, 0, 1],
            "thetaOffset": 0,
            "fovy": 45,
            "near": 0.01,
            "far": max(5000, 10 * width),
        },
        "followMode": "follow-none",
        "followTf": FRAME,
        "fixedFrame": FRAME,
        "scene": {"backgroundColor": "#FFFFFF"},
        "transforms": {},
        "topics": {topic: {"visible": True} for topic in (SCENE_TOPIC, ARENA, TRAILS)},
        "layers": {},
    }


def _plot(title: str, *series: tuple[str, str]) -> dict[str, Any]:
    paths = [
        {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime", "color": colour}
        for (value, label), colour in zip(series, PALETTE, strict=False)
    ]
    return {
        "title": title,
        "paths": paths,
        "showLegend": len(paths) > 1,
        "legendDisplay": "floating",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }
