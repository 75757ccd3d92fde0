"""An agent with all parts that a robot of a run has."""

from __future__ import annotations

from llm_flock.agent import Agent
from llm_flock.bounds import TIME_OUT
from llm_flock.mission import Mission
from llm_flock.protocol._agreement.assignment import AssignmentRule
from llm_flock.protocol._agreement.consensus import ConsensusRule
from llm_flock.protocol._breaker import Fallback
from llm_flock.protocol._parts import Gaps
from llm_flock.runtime._roster import make_parts
from llm_flock_swarm._signed.certificates import LIARS, Authenticator
from llm_flock_swarm._signed.parts import signed_parts


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
    liars: int = LIARS,
) -> Agent:
    """An agent whose membership, safety and verifier are as given, with signatures if there is an authenticator."""
    parts = make_parts(
        robot,
        mission,
        (consensus, assignment),
        shield=shield_on,
        verify=verify,
        noise_bound=noise_bound,
        time_out=time_out,
        gaps=gaps,
        apart=apart,
    )
    if authenticator is not None:
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
