"""Signatures around messages and agreement, for teams whose members hold keys."""

from __future__ import annotations

from llm_flock.mission import Mission
from llm_flock.protocol.agreement.assignment import AssignmentRule
from llm_flock.protocol.membership.liveness import Liveness
from llm_flock.protocol.signed.assignment import SignedAssignment
from llm_flock.protocol.signed.certificates import Authenticator
from llm_flock.protocol.signed.channel import SignedChannel
from llm_flock.protocol.signed.evidence import Evidence


def signed(
    robot: int, mission: Mission, authenticator: Authenticator, liveness: Liveness, assignment: AssignmentRule
) -> tuple[SignedChannel, SignedAssignment]:
    """The channel and the assignment rule of a robot with keys, which share its evidence."""
    evidence = Evidence(robot, authenticator)
    channel = SignedChannel(
        robot, mission.n_robots, mission.dim, authenticator=authenticator, evidence=evidence, liveness=liveness
    )
    return channel, SignedAssignment(assignment, evidence)
