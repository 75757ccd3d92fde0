"""The answers of a Crazyflie to packets, sans-IO: bytes and the time go in, bytes come out.

Numbers of ports, channels and commands are the firmware's (`crtp.h`, `crtp_commander_high_level.c`,
`crtp_supervisor.c`, `log.c`, `param_logic.c`, `platformservice.c`); times and states are its supervisor's
(`supervisor.c`, `supervisor_state_machine.c`). See docs/reference/firmware.md.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from llm_flock.robots import BUSY, PointMass
from llm_flock_flight._cascade import pid
from llm_flock_flight._testing.crtp.external import ExternalPosition

PARAM, COMMANDER, MEM, LOGGING, LOCALIZATION, GENERIC = 2, 3, 4, 5, 6, 7
HIGH_LEVEL, SUPERVISOR, PLATFORM, LINK = 8, 9, 13, 15
VERSION = 12
"""Protocol version: the first that knows the supervisor's port."""

FLYING_LINGERS_S = 2.0
"""`IS_FLYING_HYSTERESIS_THRESHOLD`: time for which a drone still reports flying after its motors stopped [s]."""

SETPOINT_TIMEOUT_S = 2.0
"""`COMMANDER_WDT_TIMEOUT_SHUTDOWN`: after the first low-level set-point, a drone locks after this silence [s]."""

STOP_WATCHDOG_S = 1.0
"""`DEFAULT_EMERGENCY_STOP_WATCHDOG_TIMEOUT`: the watchdog, once started, stops a drone after this silence [s]."""

DISABLED, BY_HIGH_LEVEL, BY_PACKETS = 0, 1, 2
"""Priorities of set-points (`commander.h`): one with a lower priority than the last is dropped."""

PID, INDI = 1, 3  # controllers that lag behind a moving set-point; the stand-in follows it exactly with the others

NO_SUCH = 2
EXISTS = 17

NOISE_M = 1e-4  # noise of the estimate. It need not be random: it only keeps two estimates from being equal

LOG_TYPES: Mapping[int, str] = MappingProxyType(
    {1: "<B", 2: "<H", 3: "<L", 4: "<b", 5: "<h", 6: "<i", 7: "<f", 8: "<e"}
)
"""How a log variable of a type is packed (firmware: `src/modules/interface/log.h`)."""

PARAMETER_TYPES: Mapping[int, str] = MappingProxyType({0x08: "<B", 0x06: "<f"})
"""How a parameter of a type is packed (firmware: `src/modules/interface/param_logic.h`)."""

LOGGED: Mapping[str, int] = MappingProxyType(
    {
        "stateEstimate.x": 7,
        "stateEstimate.y": 7,
        "stateEstimate.z": 7,
        "stateEstimate.yaw": 7,
        "pm.vbat": 7,
        "kalman.varPX": 7,
        "kalman.varPY": 7,
        "kalman.varPZ": 7,
        "supervisor.info": 2,
        "lighthouse.status": 1,
        "lighthouse.bsReceive": 2,
        "lighthouse.bsActive": 2,
    }
)
"""Type of each log variable by name, in order."""


@dataclass(slots=True)
class Parameter:
    """One parameter, of one of `PARAMETER_TYPES`."""

    kind: int
    value: float

    def pack(self) -> bytes:
        code = PARAMETER_TYPES[self.kind]
        return struct.pack(code, self.value if code == "<f" else int(self.value))


def contents(names: Sequence[str], kinds: Sequence[int]) -> tuple[int, list[bytes]]:
    """Checksum of a table, and the bytes of each entry."""
    rows = [
        bytes([kind]) + group.encode() + b"\0" + name.encode() + b"\0"
        for (group, name), kind in zip((n.split(".") for n in names), kinds, strict=True)
    ]
    return zlib.crc32(b"".join(rows)), rows


def packet(port: int, channel: int, data: bytes | Sequence[int]) -> bytes:
    return bytes([port << 4 | 3 << 2 | channel]) + bytes(data)


@dataclass(slots=True)
class _Block:
    """One log block: its variables, its period, and the time of its next packet."""

    variables: list[tuple[str, str]]
    period_s: float = 0.0
    due: float | None = None


class Firmware:
    """The firmware of one drone, without the `missing` log variables.

    `controller` is its `stabilizer.controller` after a start: 1 PID, as Crazyflies are shipped, 2 Mellinger, ...
    `commands` has time [s] and number of each high-level command received, refused ones included. `lighthouse` has the
    base stations that its deck receives and uses, as bit fields. A drone that tumbled in flight has `crashed`.
    """

    def __init__(
        self, body: PointMass, *, controller: int = PID, missing: Collection[str] = (), outside: bool = False
    ) -> None:
        self.body = body
        self.outside = ExternalPosition(body) if outside else None
        self.lighthouse = (0, 0)
        self.commands: list[tuple[float, int]] = []
        self.priority = DISABLED
        self.tumbled = self.crashed = False
        self.parameters = {
            "stabilizer.estimator": Parameter(0x08, 2),
            "stabilizer.controller": Parameter(0x08, controller),
            "kalman.resetEstimation": Parameter(0x08, 0),
            "locSrv.extPosStdDev": Parameter(0x06, 0.01),
            "commander.enHighLevel": Parameter(0x08, 1),
            **{f"posCtlPid.{axis}Kp": Parameter(0x06, 2.0) for axis in "xyz"},
            **{f"posCtlPid.{axis}VelMax": Parameter(0x06, 1.0) for axis in "xyz"},
            **{f"posCtrlIndi.K_xi_{axis}": Parameter(0x06, 1.0) for axis in "xyz"},
        }
        self._names = list(self.parameters)
        self._variables = [name for name in LOGGED if name not in missing]
        self._tables = {
            PARAM: contents(self._names, [p.kind for p in self.parameters.values()]),
            LOGGING: contents(self._variables, [LOGGED[name] for name in self._variables]),
        }
        self._blocks: dict[int, _Block] = {}
        self._gain: float | None = None  # of the controller that the body has
        self._flew: float | None = None
        self._low_level: float | None = None
        self._watchdog: float | None = None
        self._tremble = 0
        self._control(0.0)

    def handle(self, raw: bytes, now: float) -> list[bytes]:
        """Answers to one packet."""
        if not raw or raw[0] == 0xFF:
            return [b"\xff"]
        port, channel, data = raw[0] >> 4, raw[0] & 3, raw[1:]
        self.advance(now)
        try:
            answer = self._answer(port, channel, data, now)
        except (IndexError, ValueError, struct.error):  # too short, or nonsense: the firmware drops it too
            return []
        return [] if answer is None else [packet(port, channel, answer)]

    def _answer(self, port: int, channel: int, data: bytes, now: float) -> bytes | None:
        if port == LINK:
            return b"Bitcraze Crazyflie".ljust(30, b"\0") if channel == 1 else data
        if port == PLATFORM:
            return bytes([0, VERSION]) if channel == 1 else None
        if port == MEM:
            return bytes([1, 0])
        if port in (PARAM, LOGGING) and channel == 0:
            return self._table(port, data)
        if port == PARAM:
            return self._parameter(channel, data, now)
        if port == LOGGING:
            return self._settings(data, now)
        if port == HIGH_LEVEL:
            return self._high_level(data, now)
        if port == SUPERVISOR:
            return self._supervisor(channel, data, now)
        if port == LOCALIZATION and self.outside is not None and self.outside.take(channel, data, now):
            return None
        if port == LOCALIZATION and channel == 1:
            self._emergency(data[0], now)
        if port in (COMMANDER, GENERIC) and channel == 0:
            self._set_point(now)
        elif port == GENERIC and channel == 1 and data[0] == 0 and self.priority == BY_PACKETS:
            self.priority, self._low_level = BY_HIGH_LEVEL, None
        return None

    def _set_point(self, now: float) -> None:
        """A low-level set-point: it stops the high-level commander, and outranks it until told otherwise."""
        self.priority = BY_PACKETS
        if self.body.flying:  # here it never has thrust
            self._low_level = now
            self.body.stop(now)

    def _table(self, port: int, data: bytes) -> bytes | None:
        checksum, rows = self._tables[port]
        if data[0] == 3:
            return struct.pack("<BHI", 3, len(rows), checksum)
        if data[0] == 2:
            (number,) = struct.unpack_from("<H", data, 1)
            return data[:3] + rows[number]
        return None

    def _parameter(self, channel: int, data: bytes, now: float) -> bytes | None:
        if channel not in (1, 2):
            return None
        (number,) = struct.unpack_from("<H", data)
        if number >= len(self._names):
            return data[:2] + bytes([NO_SUCH])
        parameter = self.parameters[self._names[number]]
        if channel == 1:
            return data[:2] + b"\0" + parameter.pack()
        parameter.value = float(struct.unpack(PARAMETER_TYPES[parameter.kind], data[2:])[0])
        self._control(now)
        return data[:2] + parameter.pack()

    def set_parameter(self, name: str, value: float, now: float) -> None:
        """Change a parameter from outside the link."""
        self.parameters[name].value = value
        self._control(now)

    def _control(self, now: float) -> None:
        """Let the body follow its set-point as its controller does."""
        number = int(self.parameters["stabilizer.controller"].value)
        gain = {PID: "posCtlPid.xKp", INDI: "posCtrlIndi.K_xi_x"}.get(number)
        value = None if gain is None else self.parameters[gain].value
        if value != self._gain:
            self._gain = value
            self.body.follow(None if value is None else pid(value), now)

    def _settings(self, data: bytes, now: float) -> bytes:
        command = data[0]
        block = data[1] if len(data) > 1 else 0
        result = 0
        if command == 5:
            self._blocks.clear()
        elif command in (6, 7):
            if command == 6 and block in self._blocks:
                return bytes([command, block, EXISTS])
            variables = self._blocks.setdefault(block, _Block([])).variables
            for kind, number in struct.iter_unpack("<BH", data[2:]):
                variables.append((self._variables[number], LOG_TYPES[kind & 0x0F]))
        elif block not in self._blocks:
            result = NO_SUCH
        elif command == 3:
            self._blocks[block].period_s = data[2] / 100.0
            self._blocks[block].due = now
        elif command == 4:
            self._blocks[block].due = None
        elif command == 2:
            del self._blocks[block]
        return bytes([command, block, result])

    def _high_level(self, data: bytes, now: float) -> bytes:
        command, body = data[0], self.body
        self.commands.append((now, command))
        result = 0
        if self.priority == BY_PACKETS:
            # It plans, and answers that it does, but its set-points are dropped: no motor turns.
            result = 0 if body.armed else BUSY
        elif command == 3:
            result = body.stop(now)
        elif command in (7, 8):
            _, height, _, _, duration = struct.unpack_from("<Bff?f", data, 1)
            result = (body.take_off if command == 7 else body.land)(height, duration, now)
        elif command == 12:
            _, relative, _, x, y, z, _, duration = struct.unpack_from("<B??fffff", data, 1)
            if relative:
                x, y, z = (a + b for a, b in zip(body.estimate(now), (x, y, z), strict=True))
            result = body.go_to((x, y, z), duration, now)
        return bytes([*data[:3].ljust(3, b"\0"), result])

    def _supervisor(self, channel: int, data: bytes, now: float) -> bytes | None:
        command = data[0]
        if channel == 0 and command == 0x0C:
            return struct.pack("<BH", 0x8C, self.info(now))
        if channel == 1 and command == 1:
            done = not (data[1] and (self.tumbled or self.crashed)) and self.body.arm(bool(data[1]))
            return bytes([0x81, done, self.body.armed])
        if channel == 1 and command == 2:
            self.crashed = self.crashed and self.tumbled
            return bytes([0x82, not self.crashed, self.crashed])
        if channel == 1:
            self._emergency(command, now)
        return None

    def _emergency(self, command: int, now: float) -> None:
        if command == 3:
            self.body.emergency_stop(now)
        elif command == 4:
            self._watchdog = now

    def tumble(self, now: float) -> None:
        """Lie on its back: the motors stop, in flight it has crashed."""
        self.crashed = self.crashed or self.body.flying
        self.body.stop(now)
        self.tumbled, self.body.armed = True, False

    def tick(self, now: float) -> list[bytes]:
        """Log packets that are due."""
        self.advance(now)
        out: list[bytes] = []
        for number, block in self._blocks.items():
            if block.due is None or now < block.due:
                continue
            block.due = max(block.due + block.period_s, now)
            values = self._log_values(now)
            data = b"".join(struct.pack(code, values[name]) for name, code in block.variables)
            stamp = struct.pack("<I", int(now * 1000) & 0xFFFFFF)[:3]
            out.append(packet(LOGGING, 2, bytes([number]) + stamp + data))
        return out

    def info(self, now: float) -> int:
        """`supervisor.info`: the supervisor's state, in bits."""
        body, flies = self.body, self._flies(now)
        armed, locked, turn = body.armed, body.locked, body.flying
        well = not (locked or self.tumbled or self.crashed)
        planned = turn, not turn
        bits = (not armed and well, armed, body.auto_arm, armed, flies, self.tumbled, locked, self.crashed, *planned)
        return sum(1 << k for k, bit in enumerate(bits) if bit)

    def _flies(self, now: float) -> bool:
        if self.body.locked or self.tumbled or self.crashed:
            return False
        return self.body.flying or (self._flew is not None and now < self._flew + FLYING_LINGERS_S)

    def advance(self, now: float) -> None:
        self.body.advance(now)
        if self.outside is not None:
            self.outside.advance(now)
        if self.body.flying:
            self._flew = now
        elif self._flew is not None and not self._flies(now):
            # After a landing the supervisor starts over, and disarms.
            self._flew = None
            self.body.armed = self.body.auto_arm and not (self.body.locked or self.tumbled or self.crashed)
        if self._watchdog is not None and now >= self._watchdog + STOP_WATCHDOG_S:
            self.body.emergency_stop(now)
        if self._low_level is not None and now >= self._low_level + SETPOINT_TIMEOUT_S:
            self._low_level = None
            self.body.emergency_stop(now)

    def _log_values(self, now: float) -> dict[str, float | int]:
        self._tremble = (self._tremble + 1) % 7
        shake = NOISE_M * (self._tremble - 3) / 3.0
        x, y, z = self.body.estimate(now)
        variance = self.body.variance(now)
        received, active = self.lighthouse
        return {
            "stateEstimate.x": x + shake,
            "stateEstimate.y": y - shake,
            "stateEstimate.z": z + shake,
            "stateEstimate.yaw": 0.0,
            "pm.vbat": self.body.battery_v,
            "kalman.varPX": variance,
            "kalman.varPY": variance,
            "kalman.varPZ": variance,
            "supervisor.info": self.info(now),
            "lighthouse.status": 2 if active else 1 if received else 0,
            "lighthouse.bsReceive": received,
            "lighthouse.bsActive": active,
        }
