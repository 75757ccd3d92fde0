"""Agreement on what to do after an event: each robot's model votes once, and all robots that know the votes agree.

The votes are a set that only grows, and the choice is a function of that set. Theorem 18 in theory.md says what follows
from this.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TypeAlias

from llm_flock.bounds import MAX_ORDERS
from llm_flock.message import MAX_VOTES, Choice, Incident, Vote

Key: TypeAlias = tuple[str, int]


def key_of(incident: Incident) -> Key:
    """What makes two incidents of a mission the same: kind and robot, and of an order its round and words."""
    order = f" {incident.left:g} {incident.words}" if incident.words else ""
    return incident.kind + order, incident.robot


class Votes:
    """The votes of a team as one robot knows them: the first of each voter about each incident."""

    def __init__(self) -> None:
        self.incidents: dict[Key, Incident] = {}  #: Those of which votes are known.
        self._known: dict[Key, dict[int, Vote]] = {}
        self._new: list[Vote] = []
        self._turn = 0

    def take(self, *votes: Vote) -> None:
        """Take note of votes, the own one or those of a message."""
        for vote in votes:
            key = key_of(vote.incident)
            orders = [one for one in self.incidents.values() if one.words]
            if vote.incident.words and key not in self.incidents and len(orders) >= MAX_ORDERS:
                continue
            self.incidents.setdefault(key, vote.incident)
            known = self._known.setdefault(key, {})
            if vote.voter not in known:
                known[vote.voter] = vote
                self._new.append(vote)

    def voters(self, incident: Incident) -> frozenset[int]:
        """Robots whose votes about an incident are known, also those without a usable answer."""
        return frozenset(self._known.get(key_of(incident), ()))

    def count(self, incident: Incident) -> Mapping[Choice, int]:
        """The number of votes for each choice."""
        return Counter(vote.choice for vote in self._cast(incident) if vote.choice is not None)

    def choice(self, incident: Incident) -> Choice | None:
        """The choice with the most votes; of equal ones, that of the voter with most neighbours, then the highest id.

        None without any usable vote.
        """
        count, usable = self.count(incident), [vote for vote in self._cast(incident) if vote.choice is not None]
        best = max(usable, key=lambda vote: (count[vote.choice or "leave"], vote.degree, vote.voter), default=None)
        return None if best is None else best.choice

    def pass_on(self) -> tuple[Vote, ...] | None:
        """The votes for the next broadcast: all that fit into a message, else in turn, beginning with new ones."""
        due, self._new = self._new[:MAX_VOTES], self._new[MAX_VOTES:]
        known = [vote for key in sorted(self._known) for _, vote in sorted(self._known[key].items())]
        if len(known) <= MAX_VOTES:
            return tuple(known) or None
        self._turn += MAX_VOTES - len(due)
        return (*due, *(known[(self._turn - k) % len(known)] for k in range(MAX_VOTES - len(due))))

    def _cast(self, incident: Incident) -> list[Vote]:
        return [*self._known.get(key_of(incident), {}).values()]
