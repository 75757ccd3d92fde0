"""Orders by Foxglove: services and parameters that give a mission or kill a robot, for those with the token."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from llm_flock.errors import FlockError, InputError

if TYPE_CHECKING:
    from foxglove import Parameter, Service, ServiceRequest
    from foxglove.websocket import Client

MISSION, KILL = "/give_mission", "/kill_robot"
"""Names of the services."""

FIELDS = ("shape", "center", "spacing")
"""Fields of a mission that an order may change."""

KILLED = "kill_robot"
NOBODY = -1
"""Value of the parameter for a kill as long as nobody was killed by it."""

LONGEST_REQUEST = 65536
"""Longest request [bytes]."""

SHOWN_S = 1.0
"""Longest wait for the token of a client that calls at once [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Orders:
    """What a run can be told; None where it cannot. Both raise `InputError` where the order is not possible.

    Attributes:
        mission: changes fields of the mission, and returns the robot that took it.
        kill: kills a robot.
    """

    mission: Callable[[dict[str, Any]], int] | None = None
    kill: Callable[[int], None] | None = None

    def __bool__(self) -> bool:
        return self.mission is not None or self.kill is not None


class OrderDesk:
    """Checks who orders what, and passes it on. A listener of Foxglove's server; its threads call it.

    A client may order once it has set the parameter `pass_name` to `password`, which the gate does for those that
    showed the token.
    """

    def __init__(self, orders: Orders, pass_name: str, password: str, report: Callable[[str], None]) -> None:
        self._orders = orders
        self._pass = (pass_name, password)
        self._report = report
        self._mission: Mapping[str, Any] = {}
        self._killed = NOBODY
        self._admitted: set[int] = set()
        self._news = threading.Condition()

    def mission_given(self, fields: Mapping[str, Any]) -> None:
        """Show the mission in force."""
        self._mission = dict(fields)

    def services(self) -> list[Service]:
        """The services of the orders that are possible."""
        from foxglove import Service

        found: list[Service] = []
        if self._orders.mission is not None:
            found.append(Service(MISSION, schema=_schema("GiveMission", _MISSION_SCHEMA), handler=self._give))
        if self._orders.kill is not None:
            found.append(Service(KILL, schema=_schema("KillRobot", _ROBOT_SCHEMA), handler=self._kill))
        return found

    def parameters(self, names: Sequence[str] = ()) -> list[Parameter]:
        """The parameters with their values; those of some names only, where there are any."""
        from foxglove import Parameter

        values: dict[str, Any] = {}
        if self._orders.mission is not None:
            values |= {f"mission/{name}": self._mission[name] for name in FIELDS if name in self._mission}
        if self._orders.kill is not None:
            values[KILLED] = self._killed
        return [Parameter(name, value=value) for name, value in values.items() if not names or name in names]

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        """Answer with values."""
        return self.parameters(param_names)

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Take the pass of a client, or its orders; what was refused is reported, and keeps its value."""
        fields: dict[str, Any] = {}
        try:
            for one in parameters:
                value = one.get_value()
                if (one.name, value) == self._pass:
                    with self._news:
                        self._admitted.add(client.id)
                        self._news.notify_all()
                elif one.name == KILLED:
                    self._kill_robot(client.id, value)
                else:
                    fields[one.name.removeprefix("mission/")] = value
            if fields:
                self._change(client.id, fields)
        except FlockError as error:
            self._report(str(error))
        return self.parameters([one.name for one in parameters]) if parameters else []

    def _give(self, request: ServiceRequest) -> bytes:
        return json.dumps({"robot": self._change(request.client_id, _decoded(request))}).encode()

    def _kill(self, request: ServiceRequest) -> bytes:
        fields = _decoded(request)
        if set(fields) != {"robot"}:
            raise InputError("request", fields, 'an object such as {"robot": 3}')
        self._kill_robot(request.client_id, fields["robot"])
        return json.dumps({"robot": fields["robot"]}).encode()

    def _change(self, client: int, fields: dict[str, Any]) -> int:
        self._check(client)
        if self._orders.mission is None:
            raise InputError("mission", fields, "no order to this run")
        for name, value in fields.items():
            if name not in FIELDS:
                raise InputError(name, value, f"one of the fields {', '.join(FIELDS)}")
        if not fields:
            raise InputError("mission", fields, f"at least one of the fields {', '.join(FIELDS)}")
        taker = self._orders.mission(fields)
        self._mission = {**self._mission, **fields}
        return taker

    def _kill_robot(self, client: int, robot: object) -> None:
        self._check(client)
        if self._orders.kill is None:
            raise InputError("kill_robot", robot, "no order to this run")
        if isinstance(robot, float) and robot.is_integer():
            robot = int(robot)
        if not isinstance(robot, int) or isinstance(robot, bool) or robot < 0:
            raise InputError("robot", robot, "the id of a robot, a whole number from 0")
        self._orders.kill(robot)
        self._killed = robot

    def _check(self, client: int) -> None:
        """Refuse a client that has not come through the gate with the token."""
        with self._news:
            if not self._news.wait_for(lambda: client in self._admitted, SHOWN_S):
                raise InputError("client", client, "one that connected with the token")


def _decoded(request: ServiceRequest) -> dict[str, Any]:
    payload = request.payload
    try:
        found: object = json.loads(payload) if len(payload) <= LONGEST_REQUEST else None
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError("request", payload[:100], f"a JSON object of at most {LONGEST_REQUEST} bytes")
    return cast("dict[str, Any]", found)


_MISSION_SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {
        "shape": {"type": "string"},
        "center": {"type": "array", "items": {"type": "number"}},
        "spacing": {"type": "number"},
    },
}
_ROBOT_SCHEMA: dict[str, Any] = {"type": "object", "properties": {"robot": {"type": "integer"}}}


def _schema(name: str, request: dict[str, Any]) -> Any:
    from foxglove import MessageSchema, Schema, ServiceSchema

    def message(kind: str, fields: dict[str, Any]) -> Any:
        data = json.dumps({"title": kind, **fields}).encode()
        return MessageSchema(encoding="json", schema=Schema(name=kind, encoding="jsonschema", data=data))

    return ServiceSchema(
        f"llm_flock.{name}",
        request=message(f"llm_flock.{name}Request", request),
        response=message(f"llm_flock.{name}Response", _ROBOT_SCHEMA),
    )
