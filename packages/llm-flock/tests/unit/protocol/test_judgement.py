"""Judgements: what a robot asks its model about, the options that code computes, and what it does with the choice."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

import llm_flock
from llm_flock.agent import Agent
from llm_flock.arrays import Point
from llm_flock.events import AskJudgement, Note, OrderGiven
from llm_flock.message import BLOCKED, NO_OWNER, BidTable, Choice, Incident, Vote
from llm_flock.mission import Mission
from llm_flock.obstacles import Mover, Obstacle
from llm_flock.plan import Plan
from llm_flock.planner import AIMS, JudgementAnswer, JudgementOption, NoAnswer, best_option
from llm_flock.protocol._agreement.agreement import Agreement
from llm_flock.protocol._agreement.assignment import Claim
from llm_flock.protocol._agreement.judgement import PATIENCE, STUCK, WEIGHT, Judgement
from llm_flock.protocol._agreement.options import (
    LARGEST,
    battery_options,
    blocked_options,
    closing,
    death_options,
    order_options,
    way_past,
)
from llm_flock.protocol._membership.team import TeamMembership
from llm_flock.protocol._motion.safety import ShieldedSafety
from llm_flock.protocol._parts import Gaps, Observation, Parts, Situation

FIVE = Mission(shape="line", n_robots=5, comm_range=60)
SPOTS: tuple[Point, ...] = FIVE.ideal or ((0.0, 0.0),) * 5


def table_of(*owners: int, visits: float = 0.0) -> BidTable:
    return tuple((1, visits if owner < 0 else 0.0, owner) for owner in owners)


def situation(*owners: int, mission: Mission = FIVE, visits: float = 0.0, **sensed: Any) -> Situation:
    now = Situation(mission)
    now.plan = Plan.of(mission.ideal or ())
    now.claim = Claim(slot=0, table=table_of(*owners, visits=visits), bids=(0.0,) * len(owners))
    now.position = now.plan.points[0]
    now.sensed = sensed.get("sensed", {})
    return now


def names(options: tuple[JudgementOption, ...]) -> list[str]:
    return [option.choice for option in options]


def test_a_hole_in_a_line_can_be_left_closed_or_planned_away() -> None:
    leave, close, replan = death_options(situation(0, 1, NO_OWNER, 3, 4))
    assert (leave.choice, leave.gaps, close.choice, close.gaps, replan.choice, replan.gaps) == (
        *("leave", 1),
        *("close", 0),
        *("replan", 0),
    )
    assert "robot 0 leaves its place" in close.does and close.distance >= 2 * FIVE.spacing
    assert leave.rounds == 1 + 2 + 2 * 2 and leave.distance == pytest.approx(4 * FIVE.spacing)
    assert closing(FIVE, Plan.of(SPOTS), table_of(0, 1, NO_OWNER, 3, 4)) == (0, 2)


def test_a_missing_end_of_a_line_leaves_a_whole_one() -> None:
    leave, replan = death_options(situation(0, 1, 2, 3, NO_OWNER))
    assert (leave.gaps, replan.choice) == (0, "replan") and "4 places" in replan.does


def test_what_happens_without_a_choice_comes_first() -> None:
    assert names(death_options(situation(0, 1, NO_OWNER, 3, 4), first="replan")) == ["replan", "leave", "close"]


@pytest.mark.parametrize("owners", [(0, 1, BLOCKED, 3, 4), (0, 1, BLOCKED, NO_OWNER, 4)])
def test_nobody_closes_up_where_a_body_lies(owners: tuple[int, ...]) -> None:
    options = death_options(situation(*owners))
    assert names(options) == ["leave", "replan"]
    assert (options[0].rounds > 0) is (NO_OWNER in owners)


def test_places_that_were_visited_are_not_searched_again() -> None:
    leave = death_options(situation(0, 1, NO_OWNER, 3, 4, visits=1.0))[0]
    assert (leave.rounds, leave.distance) == (0, 0.0)


def test_a_shape_that_has_no_smaller_size_is_left() -> None:
    square = Mission(shape="square", n_robots=4, comm_range=60)
    assert names(death_options(situation(0, 1, NO_OWNER, 3, mission=square))) == ["leave"]
    assert names(death_options(situation(*[NO_OWNER] * 4, mission=square))) == ["leave"]


def test_no_circle_and_no_crowd_closes_up() -> None:
    circle = Mission(shape="circle", n_robots=6, comm_range=60)
    assert names(death_options(situation(0, 1, NO_OWNER, 3, 4, 5, mission=circle))) == ["leave", "replan"]
    side, n = 900.0, LARGEST + 2
    crowd = Mission(shape="line", n_robots=n, center=(side / 2, side / 2), arena=((0, 0), (side, side)))
    assert closing(crowd, Plan.of(crowd.ideal or ()), table_of(*range(n - 1), NO_OWNER)) is None
    assert closing(FIVE, Plan.of(SPOTS), table_of(0, 1, 2, 3, 4)) is None


WEAK = Incident(kind="battery", robot=4, left=12.0, at=(SPOTS[0][0] + 9.0, SPOTS[0][1]))


def test_a_weak_robot_may_go_on_swap_or_be_replaced() -> None:
    now = situation(0, 1, 2, 3, 4, sensed={1: SPOTS[1]})
    mission = Mission(shape="line", n_robots=6, places=5, comm_range=60)
    now.mission = mission
    options = battery_options(WEAK, now, 0, frozenset(range(6)))
    assert names(options) == ["continue", "swap", "spare"]
    go_on, swap, spare = options
    assert (go_on.lost, go_on.gaps, swap.lost, spare.lost) == (1, 1, 0, 0)
    assert "robot 1" in swap.does and "robot 5" in spare.does
    assert best_option(options) in ("swap", "spare")
    empty = battery_options(replace(WEAK, left=1.0), now, 0, frozenset(range(6)))
    assert [option.lost for option in empty] == [1, 1, 1]  # it would have to get out of the way, too


def test_nobody_swaps_places_that_were_given_by_preference() -> None:
    now = situation(0, 1, 2, 3, 4, mission=FIVE.change(prefer=({"robot": 4, "way": "edge"},)), sensed={1: SPOTS[1]})
    assert names(battery_options(WEAK, now, 0, frozenset(range(5)))) == ["continue"]


def test_a_robot_that_reaches_its_place_is_not_lost() -> None:
    incident = replace(WEAK, at=(SPOTS[4][0] - 9.0, SPOTS[4][1]))
    go_on = battery_options(incident, situation(0, 1, 2, 3, 4), 0, frozenset(range(5)))[0]
    assert (go_on.lost, go_on.rounds, go_on.distance) == (0, 2, pytest.approx(9.0))


def test_a_robot_at_its_place_needs_no_spare() -> None:
    six = Mission(shape="line", n_robots=6, places=5, comm_range=60)
    now = situation(0, 1, 2, 3, 4)
    now.mission = six
    assert names(battery_options(replace(WEAK, at=SPOTS[4]), now, 0, frozenset(range(6)))) == ["continue"]
    now.mission = six.change(comm_range=1.0)
    far = replace(WEAK, at=(SPOTS[0][0], SPOTS[0][1] + 20.0))
    assert names(battery_options(far, now, 0, frozenset(range(5)))) == ["continue"]


def test_ways_round_obstacles_count() -> None:
    wall = Obstacle(polygon=((48.0, 20.0), (52.0, 20.0), (52.0, 60.0), (48.0, 60.0)))
    mission = Mission(shape="circle", n_robots=3, center=(20, 50), comm_range=60, obstacles=(wall,))
    now = situation(0, 1, 2, mission=mission)
    incident = Incident(kind="battery", robot=2, left=12.0, at=(80.0, 50.0))
    straight = 80.0 - now.plan.points[2][0] if now.plan else 0.0
    assert battery_options(incident, now, 0, frozenset(range(3)))[0].distance > straight + 1.0


def test_without_a_place_for_the_weak_robot_there_are_no_options() -> None:
    assert battery_options(replace(WEAK, robot=9), situation(0, 1, 2, 3, 4), 0, frozenset(range(5))) == ()
    now = situation(0, 1, 2, 3, 4)
    now.plan = None
    assert battery_options(WEAK, now, 0, frozenset(range(5))) == ()


def blocked(center: Point, radius: float, mission: Mission = FIVE) -> tuple[Incident, Situation]:
    """Robot 4 stands 20 units below its place, robot 0 at its own."""
    now = situation(0, 1, 2, 3, 4, mission=mission, sensed={4: (SPOTS[4][0], SPOTS[4][1] - 20.0)})
    return Incident(kind="blocked", robot=4, left=radius, at=center), now


def test_a_robot_may_wait_or_go_round_what_is_in_its_way() -> None:
    incident, now = blocked((SPOTS[4][0], SPOTS[4][1] - 10.0), 3.0)
    wait, around = blocked_options(incident, now, 0, frozenset(range(5)))
    assert (wait.choice, wait.gaps, wait.rounds, wait.distance) == ("wait", 1, 0, 0.0)
    assert (around.choice, around.gaps) == ("round", 0) and around.distance > 20.0
    assert around.rounds == math.ceil(around.distance / FIVE.max_step)


def test_a_spare_robot_that_gets_there_takes_the_place() -> None:
    six = Mission(shape="line", n_robots=6, places=5, comm_range=60)
    incident, now = blocked((SPOTS[4][0], SPOTS[4][1] - 10.0), 3.0, six)
    assert names(blocked_options(incident, now, 0, frozenset(range(6)))) == ["wait", "round"]  # nobody sees it
    now.sensed = {**now.sensed, 5: (SPOTS[4][0], SPOTS[4][1] + 6.0)}
    spare = blocked_options(incident, now, 0, frozenset(range(6)))[-1]
    assert (spare.choice, spare.rounds) == ("spare", 1) and "spare robot 5" in spare.does


def test_a_covered_place_needs_another_plan() -> None:
    incident, now = blocked(SPOTS[4], 3.0)
    options = blocked_options(incident, now, 0, frozenset(range(5)))
    assert names(options) == ["wait", "replan"] and options[1].gaps == 0 and options[1].distance > 0.0
    incident, now = blocked(SPOTS[2], 3.0)  # the middle of every line about this centre
    assert names(blocked_options(replace(incident, robot=2), now, 2, frozenset(range(5)))) == ["wait"]


def test_who_does_not_see_the_blocked_robot_has_no_options() -> None:
    incident, now = blocked(SPOTS[4], 3.0)
    now.sensed = {}
    assert blocked_options(incident, now, 0, frozenset(range(5))) == ()
    assert blocked_options(replace(incident, robot=9), now, 0, frozenset(range(5))) == ()
    now.plan = None
    assert blocked_options(incident, now, 0, frozenset(range(5))) == ()


@pytest.mark.parametrize(("aim", "best"), [*zip(AIMS, ("replan", "leave", "leave"), strict=True)])
def test_the_right_option_depends_on_what_counts(aim: str, best: str) -> None:
    options = death_options(situation(0, 1, NO_OWNER, 3, 4, visits=1.0))
    assert best_option(options, aim) == best


class Judging:
    """One robot's judgement, with a team that the test makes up."""

    def __init__(self, robot: int = 0, gaps: Gaps = "report", mission: Mission = FIVE) -> None:
        self.membership = TeamMembership(robot, mission, gaps=gaps)
        self.agreement = Agreement(robot, mission, Parts(membership=self.membership))
        self.judgement = Judgement(robot, self.agreement, self.membership)
        self.here = SPOTS[robot]
        self.number = 0
        self.holds(*range(mission.n_places), slot=robot)
        self.alive(*range(mission.n_robots))

    def holds(self, *owners: int, slot: int | None) -> None:
        self.agreement.plan = Plan.of(SPOTS)
        self.agreement.claim = Claim(slot=slot, table=table_of(*owners), bids=(0.0,) * 5)

    def alive(self, *robots: int) -> None:
        live = self.membership.liveness
        live.silent, live.strangers = frozenset(range(5)) - {*robots}, frozenset()

    def round(self, *resting: Obstacle, **sensed: Point) -> list[AskJudgement | Note]:
        self.number += 1
        self.agreement.sense(self.here, {int(robot[1:]): x for robot, x in sensed.items()})
        return self.judgement.begin_round(self.number, self.here, resting)

    def fails(self, robot: int = 2) -> list[AskJudgement | Note]:
        """Robot 2 dies, and leaves its place empty."""
        self.round()
        self.alive(*({*range(5)} - {robot}))
        self.holds(*(j if j != robot else NO_OWNER for j in range(5)), slot=self.agreement.claim.slot)
        return self.round()

    def hear(self, incident: Incident, **votes: Any) -> None:
        for voter, choice in votes.items():
            vote = Vote(incident=incident, voter=int(voter[1:]), degree=0, choice=choice)
            self.judgement.votes.take(vote)


def kinds(effects: list[AskJudgement | Note]) -> list[str]:
    return [effect.kind if isinstance(effect, Note) else "ask" for effect in effects]


DEATH = Incident(kind="death", robot=2)


def test_a_death_that_leaves_a_gap_is_asked_about_once() -> None:
    team = Judging()
    noticed, asked = team.fails()
    assert isinstance(asked, AskJudgement) and "Robot 2 has failed" in asked.question.event
    assert noticed == Note("incident", {"about": "death", "robot": 2, "options": ["leave", "close", "replan"]})
    judged = team.judgement.take(JudgementAnswer(choice="replan", reason="So."))
    assert judged == [Note("judged", {"about": "death", "robot": 2, "choice": "replan", "reason": "So."})]
    assert kinds(team.round()) == [] and kinds(team.round()) == []


def test_a_gap_that_a_spare_robot_fills_is_no_incident() -> None:
    team = Judging()
    team.round()
    team.alive(0, 1, 3, 4)
    team.holds(0, 1, 1, 3, 4, slot=0)
    assert team.round() == []


def test_a_robot_without_plan_or_table_notices_nothing() -> None:
    team = Judging()
    team.hear(DEATH, r1="leave")
    team.alive(0, 1, 3, 4)
    team.agreement.plan = None
    assert team.round() == []
    team.agreement.plan, team.agreement.claim = Plan.of(SPOTS), Claim(slot=0)
    assert team.round() == []


def test_the_choice_is_made_when_all_votes_are_in() -> None:
    team = Judging()
    team.fails()
    assert team.membership.gaps == "report"
    team.judgement.take(JudgementAnswer(choice="replan"))
    team.hear(DEATH, r1="replan", r3="leave")
    assert team.round() == []
    team.hear(DEATH, r4=None)
    (agreed,) = team.round()
    votes = {"replan": 2, "leave": 1}
    assert agreed == Note("agreed", {"about": "death", "robot": 2, "choice": "replan", "votes": votes})
    assert team.membership.gaps == "replan"


def test_missing_votes_are_waited_for_only_so_long() -> None:
    team = Judging()
    team.fails()
    team.judgement.take(NoAnswer(cause="timeout", reason="late"))
    for _ in range(PATIENCE - 1):
        assert team.round() == []
    (agreed,) = team.round()
    assert isinstance(agreed, Note) and agreed.detail["choice"] is None and team.membership.gaps == "report"


def test_later_votes_count_until_all_know_the_same() -> None:
    team = Judging()
    team.fails()
    team.judgement.take(JudgementAnswer(choice="leave"))
    for _ in range(PATIENCE):
        team.round()
    assert team.membership.gaps == "report"
    team.hear(DEATH, r1="replan", r3="replan")
    team.round()
    assert team.membership.gaps == "replan"


def test_without_usable_answers_the_team_does_as_configured() -> None:
    for gaps in ("report", "replan"):
        team = Judging(gaps=gaps)
        assert team.membership.gaps == gaps
        asked = team.fails()[-1]
        assert isinstance(asked, AskJudgement)
        assert asked.question.options[0].choice == ("replan" if gaps == "replan" else "leave")
        assert team.membership.gaps == "report"  # until the team has chosen
        fallback = team.judgement.take(NoAnswer(cause="answer", reason="none"))
        expected = {"question": "judgement", "by": "rule", "cause": "answer", "reason": "none"}
        assert fallback == [Note("fallback", expected)]
        team.hear(DEATH, r1=None, r3=None, r4=None)
        team.round()
        assert team.membership.gaps == gaps


def test_the_robot_at_the_edge_closes_up() -> None:
    for robot, moves in ((0, True), (1, False)):
        team = Judging(robot)
        team.fails()
        team.judgement.take(JudgementAnswer(choice="close"))
        for j in {0, 1, 3, 4} - {robot}:
            team.hear(DEATH, **{f"r{j}": "close"})
        effects = team.round()
        assert kinds(effects) == ["agreed", "claimed"] if moves else ["agreed"]
        assert team.agreement.claim.slot == (2 if moves else 1)
        if moves:
            table = team.agreement.claim.table
            assert table is not None
            assert table[0] == (2, 0.0, NO_OWNER) and table[2] == (2, 0.0, 0)


def test_a_robot_that_lost_its_place_meanwhile_only_takes_note() -> None:
    team = Judging()
    team.fails()
    team.holds(3, 1, NO_OWNER, 3, 4, slot=None)
    team.judgement.take(JudgementAnswer(choice="close"))
    team.hear(DEATH, r1="close", r3="close", r4="close")
    assert kinds(team.round()) == ["agreed"]


def test_a_weak_robot_waits_and_gives_its_place_up() -> None:
    team = Judging(mission=Mission(shape="line", n_robots=6, places=5, comm_range=60))
    team.here = (SPOTS[0][0], SPOTS[0][1] + 30.0)
    team.membership.liveness.silent = frozenset()
    team.judgement.weaken(15.0)
    effects = team.round()
    assert team.judgement.waits and kinds(effects) == ["incident", "ask"]
    incident = team.judgement.votes.incidents
    assert not incident  # its vote tells the others
    team.judgement.take(JudgementAnswer(choice="spare"))
    (incident,) = team.judgement.votes.incidents.values()
    assert (incident.left, incident.at) == (15.0, team.here)
    for j in range(1, 6):
        team.hear(incident, **{f"r{j}": "spare"})
    assert kinds(team.round()) == ["agreed", "claimed"]
    assert team.agreement.retired and team.agreement.claim.slot is None and not team.judgement.waits
    assert team.round() == []


def test_others_let_the_weak_robot_have_a_nearer_place() -> None:
    team = Judging()
    team.hear(WEAK, r4="swap")
    effects = team.round()
    assert kinds(effects) == ["incident", "ask"] and team.agreement.weights == {}
    team.judgement.take(JudgementAnswer(choice="continue"))
    team.hear(WEAK, r1="swap", r2="swap", r3=None)
    team.round()
    weights = team.agreement.weights
    assert weights == {4: WEIGHT}
    team.round()
    assert team.agreement.weights is weights


def test_a_robot_that_sees_no_choice_casts_an_empty_vote() -> None:
    team = Judging()
    there = replace(WEAK, at=SPOTS[4])
    team.hear(there, r4="continue")
    assert kinds(team.round()) == ["incident"]
    assert team.judgement.votes.voters(there) == {0, 4}


def test_flying_uses_the_battery_up_and_a_new_mission_asks_again() -> None:
    team = Judging()
    team.round()
    team.here = (team.here[0], team.here[1] + 4.0)
    team.judgement.weaken(10.0)  # what was flown before this does not count
    assert kinds(team.round()) == ["incident"]
    assert team.judgement.votes.incidents["battery", 0].left == 10.0
    team.judgement.begin_mission()
    team.here = (team.here[0], team.here[1] - 4.0)
    team.round()
    assert team.judgement.votes.incidents["battery", 0].left == pytest.approx(6.0)
    team.judgement.begin_mission()
    team.here = (team.here[0], team.here[1] + 40.0)
    assert kinds(team.round()) == ["incident"]
    assert team.judgement.votes.incidents["battery", 0].left == 0.0
    team.judgement.begin_mission()
    stale = team.judgement.take(JudgementAnswer(choice="continue"))
    assert stale == [Note("stale_answer", {"about": "judgement"})]


BELOW = (SPOTS[4][0], SPOTS[4][1] - 20.0)
DISC = Obstacle(center=(SPOTS[4][0], SPOTS[4][1] - 10.0), radius=3.0)


def stuck(disc: Obstacle = DISC) -> tuple[Judging, list[AskJudgement | Note]]:
    """Robot 4 flies no more towards its place, because of an obstacle."""
    team = Judging(4)
    team.here = BELOW
    for _ in range(STUCK):
        assert team.round(disc) == []
    return team, team.round(disc)


def choose(team: Judging, choice: Choice) -> Incident:
    """The whole team, robot 4 as well, votes for a choice about its way."""
    team.judgement.take(JudgementAnswer(choice=choice))
    incident = team.judgement.votes.incidents["blocked", 4]
    team.hear(incident, r0=choice, r1=choice, r2=choice, r3=choice)
    return incident


def test_a_robot_that_an_obstacle_stops_asks_once() -> None:
    team, effects = stuck()
    asked = effects[-1]
    assert isinstance(asked, AskJudgement) and "in the way of robot 4" in asked.question.event
    assert effects[0] == Note("incident", {"about": "blocked", "robot": 4, "options": ["wait", "round"]})
    incident = choose(team, "round")
    assert (incident.left, incident.at) == (DISC.radius, DISC.center)
    assert kinds(team.round(DISC)) == ["agreed"] and team.agreement.resting == (DISC,)
    kept = team.agreement.resting
    assert team.round(DISC) == [] and team.agreement.resting is kept and team.judgement.waits is None
    assert way_past((), BELOW, SPOTS[4], team.agreement) > 20.0


def test_an_obstacle_elsewhere_stops_nobody() -> None:
    for disc in (Obstacle(center=(SPOTS[0][0], 20.0), radius=3.0), None):
        team = Judging(4)
        team.here = BELOW
        for _ in range(STUCK + 2):
            assert team.round(*([] if disc is None else [disc])) == []
    team = Judging(4)  # one that flies on is not stopped
    for k in range(STUCK + 2):
        team.here = (BELOW[0], BELOW[1] + k)
        assert team.round(DISC) == []
    at_home = Judging(4)
    at_home.here = SPOTS[4]
    for _ in range(STUCK + 2):
        assert at_home.round(DISC) == []


def test_obstacles_rest_that_are_where_they_were() -> None:
    here = Mover(number=0, position=(60.0, 50.0), radius=2.0, speed=3.0)
    scene = Observation(position=(50.0, 50.0), sensed={}, moving=(here,))
    assert Parts().safety.resting(scene) == ()
    safety = ShieldedSafety(0, FIVE, noise_bound=0.1)
    assert safety.resting(scene) == (), "it has just come into sight"
    safety.stay(scene)
    (disc,) = safety.resting(scene)
    assert (disc.center, disc.radius) == ((60.0, 50.0), pytest.approx(5.2))
    assert safety.resting(replace(scene, moving=(dataclasses.replace(here, position=(60.0, 51.0)),))) == ()


def test_a_formation_that_travels_asks_about_no_way() -> None:
    team = Judging(4)
    team.here, team.agreement.mission = BELOW, FIVE.change(velocity=(0.1, 0.0))
    for _ in range(STUCK + 2):
        assert team.round(DISC) == []


def test_a_robot_that_is_to_wait_holds_while_it_is_blocked() -> None:
    team, _ = stuck()
    assert team.judgement.waits is None
    choose(team, "wait")
    team.round(DISC)
    assert team.judgement.waits == "blocked" and team.agreement.resting == ()
    team.round()  # the obstacle has flown on
    assert team.judgement.waits is None


def test_a_place_under_an_obstacle_is_planned_away() -> None:
    disc = Obstacle(center=SPOTS[4], radius=3.0)
    team, effects = stuck(disc)
    assert effects[0] == Note("incident", {"about": "blocked", "robot": 4, "options": ["wait", "replan"]})
    choose(team, "replan")
    team.round(disc)
    assert team.membership.gaps == "replan" and team.agreement.resting == (disc,)
    occupancy = team.membership.occupancy(team.agreement, hears_others=True, knows_blocked=True)
    assert (occupancy.blocked, 4 in occupancy.clear) == ({4}, False)


def test_a_blocked_robot_gives_its_place_to_a_spare_one() -> None:
    team, _ = stuck()
    choose(team, "spare")
    assert kinds(team.round(DISC)) == ["agreed", "claimed"] and team.agreement.retired
    assert team.round(DISC) == []  # without a place nothing is in its way


def test_a_team_goes_round_an_obstacle_in_a_door() -> None:
    gaps = ((0, 40), (50, 80), (90, 100))
    walls = tuple(Obstacle(polygon=((50, a), (54, a), (54, b), (50, b))) for a, b in gaps)
    mission = Mission(
        shape="line", turn=90, n_robots=5, center=(76, 45), spacing=8, comm_range=100, sense_range=100, obstacles=walls
    )
    door: Any = ({"center": (58, 45), "radius": 4, "speed": 3, "path": ((52, 45),)},)
    given: Any = {"moving_obstacles": door, "seed": 1, "decide": "on-event", "time_out": 5, "trace": False}
    usual = llm_flock.run(mission, rounds=30, **given)
    judged = llm_flock.run(mission, rounds=30, judge="models", **given)
    assert (usual.formed, judged.formed) == (False, True)
    assert (judged.summary.min_separation or 0.0) >= mission.safe_distance


def ordered(now: Situation, named: int = 4, dead: int = -1) -> dict[str, JudgementOption]:
    order = Incident(kind="order", robot=named, left=1.0, words="hurry")
    found = order_options(order, now, 0, frozenset(range(now.mission.n_robots)) - {dead})
    return {option.choice: option for option in found}


def test_a_team_on_its_way_may_go_on_or_wait() -> None:
    far = (SPOTS[4][0], SPOTS[4][1] - 20.0)
    options = ordered(situation(0, 1, 2, 3, 4, sensed={4: far}))
    go_on, wait = options.values()
    assert (go_on.choice, go_on.rounds, go_on.gaps, go_on.distance) == ("continue", 4, 0, pytest.approx(20.0))
    assert (wait.choice, wait.rounds, wait.gaps, wait.distance) == ("wait", 0, 1, 0.0)
    assert [*ordered(situation(0, 1, 2, 3, 4))] == ["continue"]
    travels = ordered(situation(0, 1, 2, 3, 4, mission=FIVE.change(velocity=(0.1, 0.0))))
    assert travels["wait"].gaps == 5, "the formation leaves those behind who wait"


def test_an_order_may_close_a_gap_or_give_a_robot_a_rest() -> None:
    gap = ordered(situation(0, 1, NO_OWNER, 3, 4), dead=2)
    assert [*gap] == ["continue", "close", "replan"] and (gap["continue"].gaps, gap["replan"].gaps) == (1, 0)
    six = Mission(shape="line", n_robots=6, places=5, comm_range=60)
    now = situation(0, 1, 2, 3, 4, sensed={5: (SPOTS[4][0], SPOTS[4][1] + 12.0)})
    now.mission = six
    spare = ordered(now)["spare"]
    assert "Robot 4 gets out" in spare.does and "spare robot 5" in spare.does
    assert spare.distance > 12.0 and (spare.gaps, spare.rounds) == (0, 2)
    assert "spare" not in ordered(now, named=5)


def test_a_place_without_a_way_counts_as_empty() -> None:
    box = [[(x, 40.0), (x + 2.0, 40.0), (x + 2.0, 60.0), (x, 60.0)] for x in (58.0, 80.0)]
    box += [[(58.0, y), (82.0, y), (82.0, y + 2.0), (58.0, y + 2.0)] for y in (38.0, 60.0)]
    mission = Mission(
        shape="line", n_robots=5, comm_range=60, obstacles=tuple(Obstacle(polygon=tuple(one)) for one in box)
    )
    now = situation(0, 1, 2, 3, 4, mission=mission, sensed={4: (20.0, 20.0)})
    assert ordered(now)["continue"].gaps == 1


def told(team: Judging, words: str, choice: Choice | None) -> list[AskJudgement | Note]:
    """The robot gets an order, which the whole team answers alike."""
    team.judgement.order(words, team.number + 1)
    effects = team.round()
    team.judgement.take(JudgementAnswer(choice=choice) if choice else NoAnswer(cause="answer", reason="none"))
    incident = [*team.judgement.votes.incidents.values()][-1]
    team.hear(incident, r1=choice, r2=choice, r3=choice, r4=choice)
    return [*effects, *team.round()]


def test_the_team_does_what_it_chose_about_the_last_order() -> None:
    team = Judging()
    team.here = (SPOTS[0][0], SPOTS[0][1] + 20.0)
    noticed, asked, agreed = told(team, "2026: let robot 3 \n rest", "wait")
    assert noticed == Note("incident", {"about": "order", "robot": 3, "options": ["continue", "wait"]})
    assert isinstance(asked, AskJudgement) and asked.question.words == "2026: let robot 3 \\n rest"
    assert agreed == Note("agreed", {"about": "order", "robot": 3, "choice": "wait", "votes": {"wait": 5}})
    assert team.judgement.waits == "order"
    told(team, "whatever", None)
    assert team.judgement.waits == "order", "nobody knew what to do about that order"
    told(team, "go", "continue")
    assert team.judgement.waits is None
    told(team, "go", "wait")
    assert team.judgement.waits == "order" and team.judgement.votes.incidents["order 7 go", 0].left == 7
    team.judgement.begin_mission()
    assert team.round() == [] and team.judgement.waits is None


def test_orders_reach_the_agents_of_a_run() -> None:
    orders: Any = ({"round": 4, "robot": 1, "words": "wait"}, {"round": 10, "robot": 2, "words": "continue"})
    flown = llm_flock.run(FIVE, judge="models", changes=orders, seed=1, rounds=40, trace=False)
    still = np.abs(np.diff(flown.positions, axis=0)).max(axis=(1, 2)) < 1e-9
    assert still[6:9].all() and not still[:3].any() and flown.formed
    alone = Agent(0, FIVE, parts=Parts()).handle(OrderGiven(words="wait", round=1))
    assert alone == [Note("order", {"words": "wait"})], "it judges nothing"


def test_an_order_to_plan_again_is_followed() -> None:
    team = Judging()
    team.round()
    team.holds(0, 1, NO_OWNER, 3, 4, slot=0)
    told(team, "close the ranks", "replan")
    assert team.membership.gaps == "replan"


def test_no_search_begins_while_the_team_chooses() -> None:
    team = Judging()
    team.fails()
    assert team.membership._connectivity.waits
    team.judgement.take(JudgementAnswer(choice="leave"))
    team.hear(DEATH, r1="leave", r3="leave", r4="leave")
    team.round()
    assert not team.membership._connectivity.waits


def test_a_team_does_what_its_models_choose() -> None:
    usual, judged = (llm_flock.run(FIVE, judge=judge, kill="2@14", seed=1, trace=False) for judge in ("rule", "models"))
    assert (usual.summary.gaps, judged.summary.gaps) == (1, 0) and (judged.summary.min_separation or 0.0) >= 3.0
    moved: Any = ({"round": 9, "robot": 0, "set": {"center": (50, 45)}},)
    asked = [
        llm_flock.run(FIVE, judge=judge, battery="1@3:200", changes=moved, seed=1, trace=False)
        for judge in ("rule", "models")
    ]
    assert asked[0].summary.model_calls < asked[1].summary.model_calls and asked[1].formed


def test_the_last_robot_with_an_empty_battery_only_stops() -> None:
    flown = llm_flock.run(
        Mission(shape="line", n_robots=2, comm_range=60), battery="0@2:0,1@2:0", rounds=9, trace=False
    )
    assert flown.summary.awake == 1 and np.allclose(flown.positions[-1], flown.positions[3])
