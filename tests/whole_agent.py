"""An agent with all parts that a robot of a run has."""

from __future__ import annotations

from typing import TYPE_CHECKING

from llm_flock.agent import Agent
from llm_flock.bounds import TIME_OUT
from llm_flock.mission import Mission
from llm_flock.protocol._agreement.assignment import AssignmentRule
from llm_flock.protocol._agreement.consensus import ConsensusRule
from llm_flock.protocol._breaker import Fallback
from llm_flock.protocol._membership.team import TeamMembership
from llm_flock.protocol._motion.safety import ShieldedSafety
from llm_flock.protocol._parts import Checker, Gaps, Parts, Safety
from llm_flock.protocol._verification.validator import Validator

if TYPE_CHECKING:
    from llm_flock_swarm._signed.certificates import Authenticator


def whole_agent(
    robot: int,
    mission: Mission,
    consensus: ConsensusRule,
    assignment: AssignmentRule,
    *,
    shield_on: bool,
    noise_bound: float = 0.0,
    verify: bool = False,
    time_out: int = TIME_OUT,
    gaps: Gaps = "report",
    on_event: bool = False,
    fallback: Fallback = "hold",
    own_clock: bool = False,
    apart: float | None = None,
    authenticator: Authenticator | None = None,
    liars: int = 1,
) -> Agent:
    """An agent whose membership, safety and verifier are as given, with signatures if there is an authenticator."""
    any_size = gaps == "replan"
    parts = Parts(
        consensus=consensus,
        assignment=assignment,
        membership=TeamMembership(robot, mission, time_out=time_out, gaps=gaps),
        safety=ShieldedSafety(robot, mission, noise_bound, apart) if shield_on else Safety(),
        verifier=Validator(shield_on=shield_on, any_size=any_size) if verify else Checker(any_size=any_size),
    )
    if authenticator is not None:
        from llm_flock_swarm._signed.parts import signed_parts  # tests of the core run without the swarm

        parts = signed_parts(parts, robot, mission, authenticator, liars=liars)
    return Agent(
        robot,
        mission,
        parts=parts,
        noise_bound=noise_bound,
        on_event=on_event,
        fallback=fallback,
        own_clock=own_clock,
    )
