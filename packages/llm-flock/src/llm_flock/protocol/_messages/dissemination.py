"""Decides which parts of a message are spelled out. Others are named by a digest.

Leaving a part out costs time, never correctness. A robot that hears a digest other than its own spells out its side;
small teams also greet newcomers with everything once a round. Of a large table only the changes are sent (delta states:
Almeida, Shoker, Baquero, 2018), or all of it if digests still differ once the changes have stopped.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from itertools import compress

from msgspec.structs import replace

from llm_flock.bounds import max_payload_bytes
from llm_flock.message import BidTable, Knowledge, Message, claims_in, encode, table_digest
from llm_flock.mission import Mission, mission_text
from llm_flock.plan import Plan

SMALL = 64
"""Plans and tables of at most this many slots are spelled out once a round to all neighbours, and in every
communication round in which a digest differs."""

RESTLESS_ROUNDS = 4  # rounds after which a large table is spelled out if digests differ, even if it still changes
MAX_KNOWN_PLANS = 1024  # that are known by their digest, so that a flood of plans costs bounded memory


class Dissemination:
    """The messages that one robot has sent, and the last ones of its neighbours."""

    def __init__(self) -> None:
        self._peers: dict[int, Knowledge] = {}
        self._heard: set[int] = set()
        self._greeting = True
        self._table: BidTable | None = None
        self._digested: tuple[BidTable | None, bytes | None] = (None, None)
        self._changed: tuple[frozenset[int], ...] = ()  # slots, since each of the last two broadcasts
        self._plan_sent: str | None = None
        self._plan_said = False  # in the last broadcast
        self._table_said = RESTLESS_ROUNDS  # rounds since then
        self._sent: Message | None = None
        self._sequence = 0
        self._payload = b""
        self._plans: dict[str, Plan] = {}

    def begin_round(self) -> None:
        """Forget neighbours that were silent in the last round."""
        self._peers = {j: self._peers[j] for j in self._heard}
        self._heard = set()
        self._greeting = True
        self._table_said += 1

    def hear(self, message: Message) -> None:
        self._peers[message.sender] = message.knowledge
        self._heard.add(message.sender)

    def resolve_plan(self, message: Message, plan: Plan | None, own: Plan | None) -> Plan | None:
        """The plan that a message spells out, or names; None if it names none, or one that has not arrived in full."""
        digest = message.plan_digest
        if plan is None:
            named = own if own is not None and own.digest == digest else self._plans.get(digest or "")
            return named if named is not None and len(named) == message.places else None
        if len(self._plans) >= MAX_KNOWN_PLANS:
            self._plans.clear()
        self._plans[plan.digest] = plan
        return plan

    def forget_plans(self) -> None:
        self._plans = {}

    @property
    def greets(self) -> bool:
        """Whether the next broadcast is the first of a round."""
        return self._greeting

    def compose(self, whole: Message, table: BidTable | None, mission: Mission) -> bytes:
        """The bytes to broadcast, the same as long as nothing changes. `whole` spells out all but the table."""
        self._note_changes(table)
        plan, digest = whole.plan, whole.plan_digest
        mine = whole.knowledge
        others = [heard for heard in self._peers.values() if heard != mine]
        greeting, self._greeting = self._greeting, False
        small = plan is None or len(plan) <= SMALL
        differs = any(theirs != digest for _, theirs, _ in others)
        spell_plan = self._plan_sent != digest or (greeting or differs if small else differs and not self._plan_said)
        self._plan_sent, self._plan_said = digest, spell_plan
        spell_table = table is not None and self._spells_table(whole, len(table), others, greeting=greeting)
        claims = None if table is None else claims_in(table, None if spell_table else self._news_of(table, whole.slot))
        behind = any(theirs < whole.mission for theirs, _, _ in others)
        message = replace(
            whole,
            mission_text=mission_text(mission) if behind else None,
            plan=plan if spell_plan else None,
            claims=claims,
        )
        if message != self._sent:
            self._sent = message
            self._payload = encode(replace(message, sequence=self._sequence))
            while message.proposals and len(self._payload) > max_payload_bytes(mission.n_robots):
                message = replace(message, proposals=message.proposals[:-1])  # they come again in later messages
                self._payload = encode(replace(message, sequence=self._sequence))
            if message.votes and len(self._payload) > max_payload_bytes(mission.n_robots):
                self._payload = encode(replace(message, sequence=self._sequence, votes=None))
            self._sequence += 1
        return self._payload

    def digest(self, table: BidTable | None) -> bytes | None:
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

    def _spells_table(self, whole: Message, slots: int, others: list[Knowledge], *, greeting: bool) -> bool:
        """Whether to spell out the whole table. `others` is the knowledge of neighbours that differs."""
        differs = any(plan == self._plan_sent and table != whole.table_digest for _, plan, table in others)
        small = slots <= SMALL
        at_rest = self._table_said > 0 and not any(self._changed)
        overdue = self._table_said >= RESTLESS_ROUNDS and greeting
        if not ((small and greeting) or (differs and (small or at_rest or overdue))):
            return False
        self._table_said = 0
        return True

    def _news_of(self, table: BidTable, slot: int | None) -> Sequence[int]:
        """Slots to spell out if the table is not: the own one, and in a large table those that changed."""
        changed = frozenset[int]() if len(table) <= SMALL else frozenset[int]().union(*self._changed)
        return sorted(changed if slot is None else changed | {slot})
