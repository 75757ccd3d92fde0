"""Bid tables as messages spell them out."""

from typing import TypedDict

from llm_flock.message import BidTable, Claims, claims_in, table_digest


class Told(TypedDict):
    """What a message says about a table."""

    claims: Claims | None
    table_digest: bytes | None


def told(table: BidTable | None, digest: bytes | None = None) -> Told:
    """A whole table, with its digest or another one."""
    if table is None:
        return Told(claims=None, table_digest=digest)
    return Told(claims=claims_in(table), table_digest=digest or table_digest(table))
