"""docs/how-to/own-robot.md has code that keeps the contract of robots."""

from __future__ import annotations

import asyncio
import re
import sys
import textwrap
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

from llm_flock.robots import MotionLimits
from llm_flock.testing import check_robot
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet

ROOT = Path(__file__).parents[4]


def own_robot_page(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The code of the page on robots of one's own, as the module `my_robot`."""
    page = (ROOT / "docs" / "how-to" / "own-robot.md").read_text(encoding="utf-8")
    module = ModuleType("my_robot")
    monkeypatch.setitem(sys.modules, "my_robot", module)
    for block in re.findall(r"^( *)```python\n(.*?)^ *```", page, re.MULTILINE | re.DOTALL):
        exec(textwrap.dedent(block[1]), vars(module))
    return module


@pytest.mark.parametrize("floor_m", [0.0, -0.1])
def test_own_robots_start_within_the_limits_of_the_flight(floor_m: float, monkeypatch: pytest.MonkeyPatch) -> None:
    own_robot_page(monkeypatch)
    file = tomllib.loads((ROOT / "examples" / "flight.toml").read_text(encoding="utf-8"))
    file["world"]["floor_m"] = floor_m
    config = FlightConfig.build(file, robot="my_robot:make")
    robots = build_fleet(config)

    async def beyond() -> None:
        for robot, drone in zip(robots, config.fleet.drones, strict=True):
            await robot.connect(1.0)
            assert robot.state().position == (*(drone.start or ()), floor_m)
            await robot.arm()
            await robot.take_off(1.0, 1.0)
            for target in ((0.0, 0.0, 50.0), (50.0, 0.0, 1.0)):
                sent = await robot.go_to(target, 60.0)
                assert config.driver_limits.contains(sent.target) and sent.target != target

    asyncio.run(beyond())


@pytest.mark.clock(4)
def test_a_point_mass_with_drag_keeps_the_contract_and_lags(monkeypatch: pytest.MonkeyPatch) -> None:
    page = own_robot_page(monkeypatch)
    robot = page.dragged("drag", (0.0, 0.0, 0.0), MotionLimits())
    asyncio.run(check_robot(robot))
    controller = page.Dragged((0.0, 0.0, 0.0), 0.0)
    controller.fly(5.0, lambda at: (at, 0.0, -1.0), 0.0)
    assert controller.place[0] == pytest.approx(4.8, abs=0.02) and controller.place[2] == 0.0
    controller.shift((1.0, 0.0, 2.0))
    assert controller.place[0] == pytest.approx(5.8, abs=0.02) and controller.place[2] == 2.0
