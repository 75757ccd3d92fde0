"""The orders that a flight needs, each confirmed by the autopilot, or RobotError with its reason."""

from __future__ import annotations

import logging
import time

from llm_flock.robots import RobotError, TakenOver
from llm_flock_flight._mavlink.codec import HEARTBEAT
from llm_flock_flight._mavlink.conversation import Conversation
from llm_flock_flight._mavlink.modes import Flavour

ARM_DISARM, TAKEOFF, SET_MODE, TERMINATE, REQUEST_MESSAGE = 400, 22, 176, 185, 512  # commands (MAV_CMD)
FORCE = 21196.0  # second parameter of ARM_DISARM that disarms in the air
ORDER_S = 0.8  # longest time to try one order [s]; callers wait one second for a command, three for arming
STOP_S = 0.6  # longest time to try each of the two commands of an emergency stop [s]
AGAIN_S, NEWS_S = 0.2, 1.2  # a heartbeat is asked for this often, and awaited for this long [s]

logger = logging.getLogger(__name__)


async def set_mode(talk: Conversation, flavour: Flavour, mode: int) -> None:
    what, log = f"mode {flavour.name_of(mode)}", talk.telemetry
    await talk.command(SET_MODE, flavour.set_mode(mode), what, ORDER_S, lambda: log.mode == mode)
    log.confirm(time.monotonic(), mode=mode)


async def arm(talk: Conversation) -> None:
    """Allow the motors to turn, if the autopilot's own checks do."""
    log = talk.telemetry
    await talk.command(ARM_DISARM, (1.0, 0.0), "to arm", ORDER_S, lambda: log.armed)
    log.confirm(time.monotonic(), armed=True)


async def disarm(talk: Conversation) -> None:
    """Stop the motors on the ground; in the air the autopilot refuses."""
    log = talk.telemetry
    await talk.command(ARM_DISARM, (0.0, 0.0), "to disarm", ORDER_S, lambda: not log.armed)
    log.confirm(time.monotonic(), armed=False)


def refuse_armed(talk: Conversation, flavour: Flavour) -> None:
    """Raise TakenOver for a vehicle whose motors another pilot has started."""
    if talk.telemetry.armed:
        mode = flavour.name_of(talk.telemetry.mode)
        raise TakenOver(talk.name, f"is armed already, in mode {mode}, and not by this program")


async def refuse_armed_lately(talk: Conversation, flavour: Flavour) -> None:
    """As `refuse_armed`, by a heartbeat that comes from now on: the last one may be a second old.

    ArduPilot accepts to be armed also when it is already, so its answer does not tell whose arming it was.
    """
    log, asked_s = talk.telemetry, time.monotonic()
    end = asked_s + NEWS_S

    def has_news() -> bool:
        return log.heartbeat_s >= max(asked_s, log.certain_s)

    while not has_news():
        if time.monotonic() >= end:
            raise RobotError(talk.name, f"sent no heartbeat in {NEWS_S:g} s: whether it is armed already is not known")
        talk.tell(REQUEST_MESSAGE, (float(HEARTBEAT),))
        await talk.until(has_news, AGAIN_S)
    refuse_armed(talk, flavour)


def withdraw_arming(talk: Conversation) -> None:
    """Undo an arming that may have been done and not confirmed; in the air the autopilot refuses. Waits for nothing."""
    for again in range(3):  # some may be lost
        talk.tell(ARM_DISARM, (0.0, 0.0), again)


async def lift_off(talk: Conversation, height_m: float) -> None:
    """Let the autopilot rise to a height above its home by itself."""
    log = talk.telemetry
    parameters = (*(0.0,) * 6, height_m)
    await talk.command(TAKEOFF, parameters, "take-off", ORDER_S, lambda: log.on_ground is False)


async def cut(talk: Conversation) -> bool:
    """Stop the motors in the air: disarm by force, and if that is refused terminate the flight."""
    log, began = talk.telemetry, time.monotonic()

    def has_stopped() -> bool:
        return not log.armed and log.heartbeat_s > began

    for command, parameters in ((ARM_DISARM, (0.0, FORCE)), (TERMINATE, (1.0,))):
        try:
            await talk.command(command, parameters, "an emergency stop", STOP_S, has_stopped, anyway=True)
        except RobotError as error:
            logger.warning("%s", error)
        else:
            log.confirm(time.monotonic(), armed=False)
            return True
    return False
