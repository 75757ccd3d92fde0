"""What a stand-in autopilot does by itself, without sockets or a clock: the traits of ArduCopter that tests rely on."""

from __future__ import annotations

import math
from typing import Any

import pytest

pytest.importorskip("pymavlink")

from llm_flock_flight._mavlink.codec import Codec, text_of
from llm_flock_flight._testing.mavlink.autopilot import Autopilot

GUIDED, LOITER, RTL, LAND = 4, 5, 6, 9
STEP_S = 0.05


class Pilotless:
    """A lifelike ArduPilot in the air, its time, and the texts that it sent."""

    def __init__(self, mode: int = GUIDED, place: tuple[float, float, float] = (4.0, 3.0, -2.5)) -> None:
        self.mind = Autopilot("ardupilot", 1, lifelike=True)
        self.now, self.texts = 0.0, list[str]()
        self._own, self._other = Codec(), Codec()
        self.mind.mode, body = mode, self.mind.body
        body.ned, body.target, body.motors, body.lifted = place, place, True, True
        self.send("heartbeat", 6, 8, 0, 0, 4)

    def send(self, kind: str, *fields: Any) -> list[str]:
        """Let it take a message; the types of its answers."""
        answers: list[str] = []
        for message in self._other.datagram(self._own.encode(kind, *fields)):
            answers += self._hear(self.mind.handle(message, self.now))
        return answers

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now += STEP_S
            self._hear(self.mind.tick(self.now))

    def _hear(self, packets: list[bytes]) -> list[str]:
        found = [message for packet in packets for message in self._own.datagram(packet)]
        self.texts += [text_of(message.text) for message in found if message.get_type() == "STATUSTEXT"]
        return [message.get_type() for message in found]


def set_point(north: float, east: float, down: float) -> tuple[Any, ...]:
    return (0, 1, 1, 1, 0x0DC0, north, east, down, *(0.0,) * 8)


@pytest.mark.parametrize(("mode", "after"), [(GUIDED, LAND), (RTL, LAND), (LOITER, LOITER)])
def test_silence_of_3_s_lands_all_but_a_pilots_vehicle(mode: int, after: int) -> None:
    vehicle = Pilotless(mode)
    vehicle.wait(2.9)
    assert vehicle.mind.mode == mode and not vehicle.texts
    vehicle.wait(0.2)
    assert vehicle.mind.mode == after and vehicle.texts[0].startswith("GCS Failsafe")
    vehicle.send("heartbeat", 6, 8, 0, 0, 4)
    vehicle.wait(0.1)
    assert vehicle.texts[-1] == "GCS Failsafe Cleared" and vehicle.mind.mode == after, "the mode stays"


def test_set_points_outside_its_fence_are_dropped_unanswered() -> None:
    vehicle = Pilotless()
    vehicle.mind.parameters |= {"FENCE_ENABLE": 1.0, "FENCE_RADIUS": 6.0, "FENCE_ALT_MAX": 3.0}
    assert vehicle.send("set_position_target_local_ned", *set_point(4.0, 3.5, -2.5)) == []
    assert vehicle.mind.body.target == (4.0, 3.5, -2.5)
    for outside in ((6.0, 3.5, -2.5), (4.0, 3.5, -3.5)):
        assert vehicle.send("set_position_target_local_ned", *set_point(*outside)) == []
        assert vehicle.mind.body.target == (4.0, 3.5, -2.5)


def test_land_sinks_fast_and_return_passes_high_above_the_others() -> None:
    landing, returning = Pilotless(LAND), Pilotless(RTL)
    landing.wait(1.9)
    assert landing.mind.body.velocity[2] == pytest.approx(1.5, abs=0.15)
    heights: list[float] = []
    for _ in range(100):
        returning.send("heartbeat", 6, 8, 0, 0, 4)
        returning.wait(0.5)
        heights.append(returning.mind.body.height_m)
    assert max(heights) == pytest.approx(15.0, abs=1.5) and not returning.mind.armed
    assert math.hypot(*returning.mind.body.ned[:2]) < 0.4


def test_wind_moves_a_hovering_vehicle_by_centimetres() -> None:
    vehicle = Pilotless()
    vehicle.mind.body.wind = (5.0, 0.0, 0.0)
    for _ in range(5):
        vehicle.send("heartbeat", 6, 8, 0, 0, 4)
        vehicle.wait(1.0)
    assert 0.01 < vehicle.mind.body.ned[0] - 4.0 < 0.1


@pytest.mark.parametrize(("action", "mode"), [(3.0, LAND), (1.0, RTL), (0.0, GUIDED)])
def test_lost_radio_control_does_what_its_parameter_says(action: float, mode: int) -> None:
    vehicle = Pilotless()
    vehicle.mind.parameters["FS_THR_ENABLE"] = action
    vehicle.mind.lose_radio()
    assert vehicle.mind.mode == mode


def test_unknown_message_numbers_are_answered_by_text() -> None:
    vehicle = Pilotless()
    assert "COMMAND_ACK" in vehicle.send("command_long", 1, 1, 511, 0, 230.0, 5e5, *(0.0,) * 5)
    assert vehicle.texts == ["No ap_message for mavlink id (230)"]
