"""Introduces a vehicle: identifies its autopilot, asks for reports, and finds its local frame."""

from __future__ import annotations

import time
from collections.abc import Iterator

from llm_flock.errors import InputError
from llm_flock.robots import RobotError
from llm_flock_flight._mavlink.conversation import Conversation
from llm_flock_flight._mavlink.frames import Geodetic, LocalFrame, between
from llm_flock_flight._mavlink.port import Port
from llm_flock_flight._mavlink.telemetry import VehicleTelemetry

PERIODS_MS = {0: 200, 1: 500, 30: 200, 32: 50, 193: 500, 230: 500, 245: 200}
"""Messages to send, by number, and their periods [ms]: HEARTBEAT, SYS_STATUS, ATTITUDE, LOCAL_POSITION_NED, the reports
of ArduPilot's and of PX4's estimator, EXTENDED_SYS_STATE."""

SET_INTERVAL, REQUEST_MESSAGE = 511, 512  # commands (MAV_CMD)


async def introduce(
    talk: Conversation, port: Port, system_id: int, frame: LocalFrame, origin: Geodetic | None, timeout_s: float
) -> LocalFrame:
    """Ask for all that a flight needs until it comes, or raise RobotError; returns the local frame in the world."""
    log = talk.telemetry
    end = time.monotonic() + timeout_s
    patient_s = time.monotonic() + min(2.0, timeout_s / 2.0)
    asked = False

    def missing_now() -> list[str]:
        found = list(_missing(log, port, system_id, origin is not None))
        late = time.monotonic() >= patient_s
        return found if late or (log.on_ground is not None and log.reported) else [*found, "no report"]

    def going_on() -> bool:
        return not missing_now() or (not asked and log.heartbeat_s > 0.0)

    while missing := missing_now():
        if log.refusal is not None:
            raise RobotError(talk.name, log.refusal)
        refuse_a_second(talk, port, system_id)
        if time.monotonic() >= end:
            raise RobotError(talk.name, f"{missing[0]} within {timeout_s:g} s at {port.uri}")
        if log.heartbeat_s and log.flavour is not None:
            asked = True
            unknown = 230 if log.flavour.takes_off_by_command else 193  # it would complain, each time
            for number, period_ms in PERIODS_MS.items():
                if number != unknown:
                    talk.tell(SET_INTERVAL, (float(number), 1000.0 * period_ms))
            if origin is not None and log.gps_origin is None:
                talk.tell(REQUEST_MESSAGE, (49.0,))  # GPS_GLOBAL_ORIGIN
        await talk.until(going_on, min(0.5, max(0.0, end - time.monotonic())))
    refuse_a_second(talk, port, system_id)
    if origin is None:
        return frame
    assert log.gps_origin is not None, "it is not missing"
    try:
        return LocalFrame(origin=between(origin, log.gps_origin))
    except InputError as error:
        raise RobotError(talk.name, str(error)) from None


def refuse_a_second(talk: Conversation, port: Port, system_id: int) -> None:
    """Raise RobotError if two vehicles use this id; the second may be heard a heartbeat later than the first."""
    if system_id in port.duplicate_ids:
        raise RobotError(talk.name, f"two vehicles with system id {system_id} answer at {port.uri}")


def _missing(log: VehicleTelemetry, port: Port, system_id: int, with_origin: bool) -> Iterator[str]:
    """Each missing report as text, the first cause first."""
    if not log.heartbeat_s or log.flavour is None:
        others = ", ".join(str(number) for number in sorted(port.heard_ids - {system_id}))
        yield f"no heartbeat of system {system_id}" + (f" (only of {others})" if others else "")
    if log.ned is None:
        yield "no position: its estimator has none, or does not send it;"
    if with_origin and log.gps_origin is None:
        yield "no GPS origin: without a fix its place is not known;"
