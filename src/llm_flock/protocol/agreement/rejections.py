"""Messages that a robot refused: counted by reason, and noted for the record."""

from __future__ import annotations

from collections import Counter

from llm_flock.errors import MessageError
from llm_flock.protocol.events import Note
from llm_flock.protocol.plan import Plan

REMEMBERED_PLANS = 1024
"""Most refused plans that are remembered, so that a flood of plans costs bounded memory."""


class Rejections:
    """Counts refused messages by reason."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._plans: set[str] = set()

    def reject(self, error: MessageError) -> Note:
        """Count a refusal; returns the note for the record."""
        self.counts[error.reason] += 1
        return Note("rejected_message", {"reason": error.reason, "detail": error.detail})

    def reject_plan(self, plan: Plan, objection: str) -> list[Note]:
        """Count a plan that fails verification; returns a note the first time that this plan is refused."""
        note = self.reject(MessageError("unverified_plan", objection))
        if plan.digest in self._plans:
            return []
        if len(self._plans) >= REMEMBERED_PLANS:
            self._plans.clear()
        self._plans.add(plan.digest)
        return [note]
