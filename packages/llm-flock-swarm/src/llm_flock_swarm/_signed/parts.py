"""The parts of a robot in a team with keys: they sign its messages, and check those of others."""

from __future__ import annotations

from dataclasses import replace

from llm_flock.errors import InputError
from llm_flock.mission import Mission
from llm_flock.protocol import Parts, TeamMembership
from llm_flock_swarm._signed.assignment import SignedAssignment
from llm_flock_swarm._signed.certificates import LIARS, Authenticator
from llm_flock_swarm._signed.channel import SignedChannel
from llm_flock_swarm._signed.evidence import Evidence


def signed_parts(
    parts: Parts, robot: int, mission: Mission, authenticator: Authenticator, *, liars: int = LIARS
) -> Parts:
    """The parts of a robot, with signatures in channel and claims. Call before they are given to its agent.

    `authenticator` signs this robot's messages and checks those of others. `liars` robots with keys may lie together;
    one more must see that a place is free.

    Raises:
        InputError: the consensus rule compares proposals that others pass on, whom nobody could believe.
    """
    if getattr(parts.consensus, "ballots", False):
        allowed = (
            "a rule that compares what the neighbours follow, in a team with keys: proposals passed on are not signed"
        )
        raise InputError("consensus", parts.consensus.name, allowed)
    evidence = Evidence(robot, authenticator, liars)
    membership, replans = parts.membership, False
    if isinstance(membership, TeamMembership):
        membership, replans = membership.with_keys(liars), membership.gaps == "replan"
    return replace(
        parts,
        channel=SignedChannel(robot, mission, authenticator, evidence, membership, replans=replans),
        assignment=SignedAssignment(parts.assignment, evidence),
        membership=membership,
    )
