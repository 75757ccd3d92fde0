"""How much of its knowledge a robot spells out: long parts are named by a digest unless a neighbour may lack them.

Receivers may merge parts of a message in any order, so leaving something out costs time and never correctness. A robot
that hears a digest other than its own spells out its side until it hears its own digest back. Lost messages are thus
repeated for as long as they matter, and robots that agree exchange a few dozen bytes. Neighbours come and go between
rounds, so the first message of a round greets every neighbour that is not known to agree. Large bid tables are spelled
out at most once a round, and otherwise by their changes (delta states: Almeida, Shoker, Baquero: Delta state replicated
data types, 2018).
"""

from __future__ import annotations

import operator
from itertools import compress

from msgspec.structs import replace

from llm_flock.mission import Mission
from llm_flock.protocol.messages.codec import encode
from llm_flock.protocol.messages.message import UNSAID, BidTable, Message, table_digest
from llm_flock.protocol.messages.mission_update import mission_text
from llm_flock.protocol.plan import Plan

SMALL = 64
"""Plans and tables of at most this many slots are spelled out once a round to all neighbours; such tables also in every
communication round in which a digest differs."""

REMEMBERED_PLANS = 1024
"""Most plans that are known by their digest, so that a flood of plans costs bounded memory."""

_KNOWLEDGE = operator.attrgetter("mission", "plan_digest", "table_digest")
"""The part of a message that shows what its sender knows."""


class Dissemination:
    """The messages that one robot has sent, and the knowledge that its neighbours have shown."""

    def __init__(self) -> None:
        self._peers: dict[int, Message] = {}
        self._heard: set[int] = set()
        self._around: frozenset[int] = frozenset()
        self._neighbors = 0
        self._greeting = True
        self._table: BidTable | None = None
        self._digested: tuple[BidTable | None, str | None] = (None, None)
        self._changed: tuple[frozenset[int], ...] = ()  # slots, since each of the last two broadcasts
        self._plan_sent: str | None = None
        self._sent: Message | None = None
        self._sequence = 0
        self._payload = b""
        self._plans: dict[str, Plan] = {}
        self._standing: tuple[object, ...] = ()
        self._news = True

    def begin_round(self, around: frozenset[int], neighbors: int) -> None:
        """Forget neighbours that were silent in the last round.

        Robots `around` are sensed within radio range, where the radio counts `neighbors`.
        """
        self._peers = {j: self._peers[j] for j in self._heard}
        self._heard = set()
        self._around, self._neighbors = around, neighbors
        self._greeting = True

    def hear(self, message: Message) -> None:
        """Remember what a neighbour knows."""
        before = self._peers.get(message.sender)
        if before is not message and (before is None or _KNOWLEDGE(before) != _KNOWLEDGE(message)):
            self._news = True
        self._peers[message.sender] = message
        self._heard.add(message.sender)

    def resolve_plan(self, message: Message, own: Plan | None) -> Plan | None:
        """The plan that a message names; None if it names none, or one that never arrived in full."""
        plan, digest = message.plan, message.plan_digest
        if plan is None:
            named = own if own is not None and own.digest == digest else self._plans.get(digest or "")
            return named if named is not None and len(named.points) == message.places else None
        if len(self._plans) >= REMEMBERED_PLANS:
            self._plans.clear()
        self._plans[plan.digest] = plan
        return plan

    def forget_plans(self) -> None:
        """Forget all plans. Call when another mission comes into force."""
        self._plans = {}

    @property
    def greets(self) -> bool:
        """Whether the next broadcast is the first of a round."""
        return self._greeting

    def unchanged(self, *standing: object) -> bytes | None:
        """The last payload if composing again would give the same one, else None.

        `standing` is everything that the message is made of, apart from the team's positions. A robot in agreement
        repeats itself in most communication rounds; this saves a tenth of a large team's time.
        """
        same, self._standing = standing == self._standing, standing
        return self._payload if same and not (self._news or self._greeting) else None

    def compose(self, whole: Message, mission: Mission) -> bytes:
        """The bytes to broadcast; equal ones as long as there is nothing else to say.

        `whole` has everything spelled out, heartbeats in a greeting only; its `sequence` is set here.
        """
        self._note_changes(whole.table)
        plan = whole.plan
        digest = None if plan is None else plan.digest
        mine = whole.mission, digest, whole.table_digest
        others = [heard for heard in self._peers.values() if _KNOWLEDGE(heard) != mine]
        agreeing = self._peers.keys() - {heard.sender for heard in others} if others else self._peers.keys()
        greeting, self._greeting = self._greeting, False
        all_agree = self._around <= agreeing and len(agreeing) >= self._neighbors
        meets = greeting and (not all_agree or plan is None or len(plan) <= SMALL)
        spell_plan = meets or self._plan_sent != digest or any(m.plan_digest != digest for m in others)
        before, self._plan_sent = self._plan_sent, digest
        part, slots = self._part(whole, others, meets=meets, greeting=greeting)
        message = replace(
            whole,
            sequence=0,
            mission_text=mission_text(mission) if any(m.mission < whole.mission for m in others) else None,
            plan=plan if spell_plan else None,
            plan_digest=digest,
            places=0 if plan is None else len(plan),
            table=part,
            said=slots,
            table_digest=whole.table_digest,
        )
        if message != self._sent:
            self._sent = message
            self._payload = encode(message, self._sequence)
            self._sequence += 1
        # Greetings, positions and changes are not repeated, so the next payload differs from this one.
        self._news = greeting or whole.positions is not None or any(self._changed) or before != digest
        return self._payload

    def digest(self, table: BidTable | None) -> str | None:
        """Digest of the robot's own table, computed once for each table."""
        if table is not self._digested[0]:
            self._digested = (table, None if table is None else table_digest(table))
        return self._digested[1]

    def _note_changes(self, table: BidTable | None) -> None:
        """Find the slots of a large table that changed since the last broadcast."""
        before, changed = self._table, frozenset[int]()
        if table is not before:
            self._table = table
            if table is not None and before is not None and len(before) == len(table) > SMALL:
                changed = frozenset(compress(range(len(table)), map(operator.is_not, table, before)))
        self._changed = (*self._changed[-1:], changed)

    def _part(
        self, whole: Message, others: list[Message], *, meets: bool, greeting: bool
    ) -> tuple[BidTable | None, tuple[int, ...] | None]:
        """The table, or the part of it to spell out, and the slots of that part; `others` know something else."""
        table = whole.table
        if table is None:
            return None, None
        differs = any(m.plan_digest == self._plan_sent and m.table_digest != whole.table_digest for m in others)
        small = len(table) <= SMALL
        if meets or (differs and (small or greeting)):
            return table, None
        said = frozenset[int]() if small else frozenset[int]().union(*self._changed)
        slots = sorted(said if whole.slot is None else said | {whole.slot})
        part = [UNSAID] * len(table)
        for a in slots:
            part[a] = table[a]
        return tuple(part), tuple(slots)
