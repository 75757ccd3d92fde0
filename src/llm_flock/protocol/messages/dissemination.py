"""What is said in full: long things are named by a digest, and spelled out where a neighbour may lack them.

Everything in a message may be merged in parts and in any order, so what to leave out is a matter of cost and never of
right. Whoever hears a digest that differs from its own spells out its side, until it hears its own digest back; so a
lost message is repeated as long as it matters, and robots that agree exchange a few dozen bytes. Neighbours come and go
between rounds, so the first exchange of a round greets those that are not known to agree. Large tables are spelled out
once a round at most, and otherwise by what changed (delta states: Almeida, Shoker, Baquero: Delta state
replicated data types, 2018).
"""

from __future__ import annotations

import json
import operator
from itertools import compress
from typing import Any, cast

from msgspec.structs import replace

from llm_flock.errors import InputError, MessageError
from llm_flock.mission import Mission
from llm_flock.protocol.membership.liveness import Liveness
from llm_flock.protocol.messages.codec import encode
from llm_flock.protocol.messages.message import UNSAID, BidTable, Message, table_digest
from llm_flock.protocol.plan import Plan

SMALL = 64
"""Plans and tables of up to so many places are spelled out once a round whoever is near, and tables in every exchange
in which a digest differs."""

REMEMBERED_PLANS = 1024
"""So many plans are known by their digest."""

MISSION_FIELDS = frozenset({"shape", "points", "center", "spacing", "places", "velocity", "since"})
"""What is said of a mission; all else is a robot's own, and no message changes it."""


def mission_text(mission: Mission) -> str:
    """A mission as it is said to others."""
    return mission.model_dump_json(include=set(MISSION_FIELDS))


def mission_fields(text: str) -> dict[str, Any]:
    """The fields of a mission that came over the radio.

    Raises:
        MessageError: it is not a JSON object of fields that may change.
    """
    try:
        said: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise MessageError("malformed", f"the mission is not JSON ({error})") from None
    fields = cast("dict[str, Any]", said) if isinstance(said, dict) else {"": said}
    if not fields.keys() <= MISSION_FIELDS:
        raise MessageError("malformed", f"a mission of other fields than {', '.join(sorted(MISSION_FIELDS))}")
    return fields


def mission_said(message: Message, own: Mission) -> Mission:
    """The mission that a message says in full, with the limits and surroundings of the own one.

    They are not said, and stay as they are: a mission with others has another digest.

    Raises:
        MessageError: with reason `malformed` or `other_mission`.
    """
    try:
        said = own.change(**mission_fields(message.mission_text or ""))
    except InputError as error:
        raise MessageError("other_mission", str(error)) from None
    if said.digest != message.mission.digest:
        raise MessageError("other_mission", f"not the mission that {message.mission.digest} stands for")
    return said


_KNOWN = operator.attrgetter("mission", "plan_digest", "table_digest")
"""What a neighbour shows to know: by this is chosen what to tell it."""


class Dissemination:
    """What one robot has said and what it knows of its neighbours' knowledge."""

    def __init__(self) -> None:
        self._peers: dict[int, Message] = {}
        self._heard: set[int] = set()
        self._around: frozenset[int] = frozenset()
        self._neighbors = 0
        self._greeting = True
        self._table: BidTable | None = None
        self._digested: tuple[BidTable | None, str | None] = (None, None)
        self._changed: tuple[frozenset[int], ...] = ()  # since each of the last two broadcasts
        self._plan_said: str | None = None
        self._said: Message | None = None
        self._sequence = 0
        self._payload = b""
        self._standing: tuple[object, ...] = ()
        self._news = True
        self._plans: dict[str, Plan] = {}

    def begin_round(self, around: frozenset[int], neighbors: int) -> None:
        """Neighbours come and go between rounds: forget who was not heard in the last one.

        Args:
            around: ids of the robots that are sensed within radio range.
            neighbors: how many robots the radio counts within range.
        """
        self._peers = {j: self._peers[j] for j in self._heard}
        self._heard = set()
        self._around, self._neighbors = around, neighbors
        self._greeting = True

    def hear(self, message: Message) -> None:
        """Remember what a neighbour has."""
        before = self._peers.get(message.sender)
        if before is None or (before is not message and _KNOWN(before) != _KNOWN(message)):
            self._news = True
        self._peers[message.sender] = message
        self._heard.add(message.sender)

    def named(self, message: Message, own: Plan | None) -> Plan | None:
        """The plan that a message names; None if it names none, or one that was never said in full here.

        Args:
            message: what was heard.
            own: the plan that is followed.
        """
        plan, digest = message.plan, message.plan_digest
        if plan is None:
            named = own if own is not None and own.digest == digest else self._plans.get(digest or "")
            return named if named is not None and len(named.points) == message.places else None
        if len(self._plans) >= REMEMBERED_PLANS:
            self._plans.clear()  # whoever floods the radio with plans may cost time, but not memory
        self._plans[plan.digest] = plan
        return plan

    def forget_plans(self) -> None:
        """Another mission has come: no plan of before is heard of any more."""
        self._plans = {}

    @property
    def greets(self) -> bool:
        """Whether the next broadcast is the first of a round."""
        return self._greeting

    def again(self, *standing: object) -> bytes | None:
        """The last bytes once more; None where something is new, or this robot stands otherwise than it did then.

        Args:
            standing: all that `whole` is made of but the roll.
        """
        same, self._standing = standing == self._standing, standing
        return self._payload if same and not (self._news or self._greeting) else None

    def say(self, whole: Message, mission: Mission, liveness: Liveness) -> bytes:
        """The bytes to send; equal ones as long as there is nothing else to say.

        Args:
            whole: the standing, everything spelled out; `sequence` is set here.
            mission: the mission in force.
            liveness: whose heartbeats are passed on, once a round.
        """
        self._note_changes(whole.table)
        plan = whole.plan
        digest = None if plan is None else plan.digest
        mine = whole.mission, digest, whole.table_digest
        others = [heard for heard in self._peers.values() if _KNOWN(heard) != mine]
        agreeing = self._peers.keys() - {heard.sender for heard in others} if others else self._peers.keys()
        greeting, self._greeting = self._greeting, False
        known = self._around <= agreeing and len(agreeing) >= self._neighbors
        meets = greeting and (not known or plan is None or len(plan) <= SMALL)
        spell_plan = meets or self._plan_said != digest or any(m.plan_digest != digest for m in others)
        before, self._plan_said = self._plan_said, digest
        part, said = self._part(whole, others, meets=meets, greeting=greeting)
        message = replace(
            whole,
            sequence=0,
            mission_text=mission_text(mission) if any(m.mission < whole.mission for m in others) else None,
            plan=plan if spell_plan else None,
            plan_digest=digest,
            places=0 if plan is None else len(plan),
            table=part,
            said=said,
            table_digest=whole.table_digest,
            beats=liveness.beats if greeting else None,
        )
        if message != self._said:
            self._said = message
            self._payload = encode(message, self._sequence)
            self._sequence += 1
        # A greeting, a roll, and what has just changed are not said again in the next communication round.
        self._news = greeting or whole.positions is not None or any(self._changed) or before != self._plan_said
        return self._payload

    def digest(self, table: BidTable | None) -> str | None:
        """Digest of the own table, worked out once for each that there is."""
        if table is not self._digested[0]:
            self._digested = (table, None if table is None else table_digest(table))
        return self._digested[1]

    def _note_changes(self, table: BidTable | None) -> None:
        """Which slots of a large table changed since the last broadcast."""
        before, changed = self._table, frozenset[int]()
        if table is not before:
            self._table = table
            if table is not None and before is not None and len(before) == len(table) > SMALL:
                changed = frozenset(compress(range(len(table)), map(operator.is_not, table, before)))
        self._changed = (*self._changed[-1:], changed)

    def _part(
        self, whole: Message, others: list[Message], *, meets: bool, greeting: bool
    ) -> tuple[BidTable | None, tuple[int, ...] | None]:
        """The table, or what of it has to be said, and which slots that are; `others` know something else."""
        table = whole.table
        if table is None:
            return None, None
        differs = any(m.plan_digest == self._plan_said and m.table_digest != whole.table_digest for m in others)
        small = len(table) <= SMALL
        if meets or (differs and (small or greeting)):
            return table, None
        said = frozenset[int]() if small else frozenset[int]().union(*self._changed)
        slots = sorted(said if whole.slot is None else said | {whole.slot})
        part = [UNSAID] * len(table)
        for a in slots:
            part[a] = table[a]
        return tuple(part), tuple(slots)
