"""A team of real agents that a test drives over faultless links; positions and plans are given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from whole_agent import whole_agent

from llm_flock import graph
from llm_flock.arrays import Point
from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskPlan,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    MoveTo,
    Planned,
    Received,
    RoundBegan,
)
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, StepAnswer
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.runtime._rules import PRESETS, assignment_rule, consensus_rule

Links = Sequence[Sequence[int]]
"""For each robot the ids of those that hear it, symmetric."""


class DrivenTeam:
    """N agents of one preset.

    Args:
        mission: what the team is asked to do.
        preset: `paper` or `flock`, as on the command line.
        plans: what each robot's model proposes.
        swaps: whether places are exchanged (`flock` only).
        joint: whether robots in touch are assigned together (`flock` only).
    """

    def __init__(
        self, mission: Mission, preset: str, plans: Sequence[Plan], *, swaps: bool = True, joint: bool = True
    ) -> None:
        rules = PRESETS[preset]
        assignment = assignment_rule(rules["assignment"])
        if isinstance(assignment, AuctionAssignment):
            assignment = AuctionAssignment(swaps=swaps, joint=joint)
        self.mission = mission
        self.proposals = list(plans)
        self.links: Links = ()
        self.agents = [
            whole_agent(
                robot,
                mission,
                consensus_rule(rules["consensus"]),
                assignment,
                shield_on=rules["shield"],
                verify=rules["verify"],
            )
            for robot in range(mission.n_robots)
        ]

    @property
    def plans(self) -> list[Plan | None]:
        """The plan that each robot follows."""
        return [agent.plan for agent in self.agents]

    @property
    def slots(self) -> list[int | None]:
        """The place that each robot claims."""
        return [agent.claim.slot for agent in self.agents]

    def begin(self, positions: Sequence[Point], links: Links | None = None) -> None:
        """A round begins: all sense each other; who has no plan proposes its own.

        Args:
            positions: of the robots [units].
            links: who hears whom; by radio range if left out.
        """
        self.links = graph.neighbors(positions, self.mission.comm_range) if links is None else links
        for i, agent in enumerate(self.agents):
            sensed = {j: x for j, x in enumerate(positions) if j != i}
            heard_by = self.links[i]
            began = RoundBegan(
                round=1,
                position=positions[i],
                degree=len(heard_by),
                sensed=sensed,
                observed=tuple(sensed[j] for j in heard_by),
            )
            for effect in agent.handle(began):
                if isinstance(effect, AskPlan):
                    agent.handle(Planned(PlanAnswer(plan=self.proposals[i], slot=i)))

    def comm_round(self, links: Links | None = None) -> None:
        """One exchange of messages, over these links instead of the round's if they are given."""
        said = [agent.handle(CommRoundBegan()) for agent in self.agents]
        for i, effects in enumerate(said):
            for effect in effects:
                assert isinstance(effect, Broadcast)
                for j in (self.links if links is None else links)[i]:
                    self.agents[j].handle(Received(effect.payload))
        for agent in self.agents:
            agent.handle(CommRoundEnded())

    def end(self, waypoints: Mapping[int, Point] | None = None) -> dict[int, MoveTo]:
        """The round ends: what each robot flies if its model asks for this waypoint; without one it has no answer."""
        moves: dict[int, MoveTo] = {}
        for i, agent in enumerate(self.agents):
            effects = agent.handle(AgreementEnded())
            if not any(isinstance(effect, MoveTo) for effect in effects):
                wish = None if waypoints is None else waypoints.get(i)
                silent = NoAnswer(cause="answer", reason="none")
                effects = agent.handle(Decided(silent if wish is None else StepAnswer(waypoint=wish)))
            moves[i] = next(effect for effect in effects if isinstance(effect, MoveTo))
            agent.handle(Arrived())
        return moves


def turned(mission: Mission, count: int) -> list[Plan]:
    """Different faultless plans: the ideal shape, turned about its centre."""
    center = np.array(mission.center)
    ideal = np.array(mission.ideal) - center
    plans: list[Plan] = []
    for k in range(count):
        angle = 0.11 * (k + 1)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        plans.append(Plan.of((ideal @ turn.T + center).tolist()))
    return plans
