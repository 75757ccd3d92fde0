"""When rules changed nothing, and why: asked the same again right after that, they have the same to say."""

from __future__ import annotations

from operator import attrgetter

from llm_flock.protocol.messages.message import Message

_TOLD = attrgetter("sender", "neighbors", "plan", "provenance", "plan_class", "slot", "table_digest", "offer")
"""What rules look at in a message, but for the table."""


class Precedent:
    """The last communication round on which consensus and assignment were asked, if they changed nothing."""

    def __init__(self) -> None:
        self.repeated = False
        """Whether what it decided last was, message by message, the same as the time before."""
        self._grounds: tuple[object, ...] = ()
        self._heard: list[Message] = []

    def set(self, grounds: tuple[object, ...], heard: list[Message]) -> None:
        """Rules changed nothing on these grounds (the own standing and what is seen) and this."""
        self._grounds, self._heard = grounds, heard

    def void(self) -> None:
        """Rules are asked anew."""
        self._grounds = ()

    def decides(self, grounds: tuple[object, ...], heard: list[Message], table_digest: str | None) -> bool:
        """Whether rules need not be asked, for they would learn nothing that they were not told then.

        Of a table they learn nothing either if it is the own one, however much of it is spelled out.

        Args:
            grounds: the own standing and what is seen.
            heard: this communication round's messages.
            table_digest: digest of the own table.
        """
        if grounds != self._grounds:
            return False
        self.repeated = heard == self._heard
        if not self.repeated and not self._stand_as_before(heard, table_digest):
            return False
        self._heard = heard
        return True

    def _stand_as_before(self, heard: list[Message], table_digest: str | None) -> bool:
        return list(map(_TOLD, heard)) == list(map(_TOLD, self._heard)) and all(
            message.table_digest == table_digest or message.table == before.table
            for message, before in zip(heard, self._heard, strict=True)
        )
