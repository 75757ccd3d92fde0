"""The medoid of all proposals: which plan is followed, how proposals spread, and a team that is asked for a picture."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

import llm_flock
from llm_flock.arrays import Points
from llm_flock.bounds import max_payload_bytes
from llm_flock.errors import MessageError
from llm_flock.formation import parse_program
from llm_flock.llm._port import Call, Reply
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.llm._simulated.prompt_reader import PLAN_MARK, read_plan
from llm_flock.message import Message, MissionStamp, Proposal, Provenance, decode, encode
from llm_flock.mission import Mission
from llm_flock.plan import Drawing, Plan
from llm_flock.protocol._agreement.agreement import Agreement
from llm_flock.protocol._agreement.ballot import Ballot
from llm_flock.protocol._agreement.consensus import Standing
from llm_flock.protocol._agreement.medoid import MedoidConsensus, unlikeness
from llm_flock.protocol._agreement.messaging import Messaging
from llm_flock.protocol._messages.dissemination import Dissemination
from llm_flock.protocol._parts import Parts
from llm_flock.protocol._verification.validator import Validator
from llm_flock.shapes import distances
from llm_flock.testing import check_consensus_rule

PICTURES = {
    "heart": lambda t: (16 * np.sin(t) ** 3, 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t)),
    "egg": lambda t: (np.cos(t), (1.6 + 0.4 * np.sin(t)) * np.sin(t)),
    "lying egg": lambda t: (2.2 * np.cos(t), np.sin(t)),
    "leaf": lambda t: ((1 + 0.35 * np.cos(4 * t)) * np.cos(t), (1 + 0.35 * np.cos(4 * t)) * np.sin(t)),
    "clover": lambda t: ((1 + 0.7 * np.cos(3 * t)) * np.cos(t), (1 + 0.7 * np.cos(3 * t)) * np.sin(t)),
    "peanut": lambda t: ((1 + 0.5 * np.cos(2 * t)) * np.cos(t), (1 + 0.5 * np.cos(2 * t)) * np.sin(t)),
    "standing peanut": lambda t: ((1 - 0.5 * np.cos(2 * t)) * np.cos(t), (1 - 0.5 * np.cos(2 * t)) * np.sin(t)),
    "moon": lambda t: (np.cos(t) + 0.9 * np.cos(t) ** 2, 1.2 * np.sin(t)),
    "wedge": lambda t: (np.cos(t) * (1.2 - np.sin(t)), 1.3 * np.sin(t)),
}


def plan_of(program: str, spacing: float = 1.0) -> Plan:
    return Plan(drawing=Drawing(program=program, places=10, spacing=spacing, center=(50.0, 50.0)))


def drawn(picture: str, n: int, rng: np.random.Generator) -> Points:
    """N points evenly along a picture of scale 1 as one reader draws it: begun anywhere, turned, stretched, skewed."""
    outline = np.column_stack(PICTURES[picture](np.linspace(0.0, math.tau, 2000)))
    angle, (wide, high), skew = math.radians(rng.uniform(-8, 8)), rng.uniform(0.92, 1.08, 2), rng.uniform(-0.06, 0.06)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    outline = outline @ np.array([[wide, 0.0], [skew, high]]) @ turn
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(outline, axis=0), axis=1))])
    at = (np.arange(n) + rng.uniform()) * along[-1] / n
    points = np.column_stack([np.interp(at % along[-1], along, axis) for axis in outline.T])
    points -= points.mean(axis=0)
    return points / math.sqrt((points**2).sum(axis=1).mean())


def origin(proposer: int, **changes: int) -> Provenance:
    fields = {"mission": 0, "epoch": 0, "degree": 2, "proposer": proposer, "sequence": 0} | changes
    return Provenance(mission_digest="0" * 16, **fields)


def says(proposer: int, plan: Plan, plan_class: int = 0, **changes: int) -> Message:
    made = origin(proposer, **changes)
    return Message(sender=proposer, sequence=0, degree=2, plan=plan, provenance=made, plan_class=plan_class)


def follows(message: Message) -> Standing:
    return Standing(robot=0, plan=message.plan, provenance=message.provenance, degree=2)


def proposals(pictures: list[str], seed: int, n: int = 30) -> list[Message]:
    rng = np.random.default_rng(seed)
    return [says(j, Plan.of(40.0 * drawn(picture, n, rng))) for j, picture in enumerate(pictures)]


NOTHING = Standing(robot=0, plan=None, provenance=None, degree=2)


def test_medoid_keeps_the_contract_of_a_rule() -> None:
    check_consensus_rule(MedoidConsensus())


@given(seed=st.integers(0, 999), size=st.floats(0.1, 50), x=st.floats(-90, 90))
@settings(max_examples=30, deadline=None)
def test_unlikeness_ignores_place_and_size_and_order(seed: int, size: float, x: float) -> None:
    rng = np.random.default_rng(seed)
    one, other = drawn("heart", 20, rng), drawn("moon", 20, rng)
    moved = Plan.of(rng.permutation(size * other + x))
    assert unlikeness(Plan.of(one), moved) == unlikeness(moved, Plan.of(one))
    assert unlikeness(Plan.of(one), moved) == pytest.approx(unlikeness(Plan.of(one), Plan.of(other)), abs=1e-3)
    assert 0.0 <= unlikeness(Plan.of(one), moved) <= 1.0


def test_drawings_of_one_picture_are_alike_and_of_two_are_not() -> None:
    rng = np.random.default_rng(3)
    plans = {name: [Plan.of(drawn(name, 40, rng)) for _ in range(6)] for name in PICTURES}
    alike = [unlikeness(a, b) for same in plans.values() for a, b in zip(same[:3], same[3:], strict=True)]
    pairs = [(a, b) for a in plans for b in plans if a < b]
    unlike = [unlikeness(plans[a][0], plans[b][1]) for a, b in pairs]
    assert max(alike) < 0.95
    assert np.mean(np.array(unlike) == 1.0) > 0.85


def test_single_places_and_heaps_can_be_compared() -> None:
    assert unlikeness(Plan.of([(3, 4)]), Plan.of([(5, 6)])) == 0.0
    assert unlikeness(Plan.of([(3, 4), (3, 4)]), Plan.of([(0, 0), (9, 0)])) == 1.0


def test_a_program_counts_by_what_it_draws() -> None:
    house = {"points": [[0, 0], [4, 0], [4, 3], [2, 5], [0, 3]], "closed": True}
    text = [parse_program({"draw": [one]}).text for one in (house, house | {"scale": 7, "turn": 4}, {"shape": "star"})]
    same, larger, star = (plan_of(program, spacing=1.0 + k) for k, program in enumerate(text))
    assert unlikeness(same, larger) < 0.3 < 0.9 < unlikeness(same, star)
    fixed = plan_of(parse_program({"groups": [{"role": "a", "count": 10, "draw": [{"shape": "circle"}]}]}).text)
    assert unlikeness(fixed, Plan.of(fixed.points)) == 0.0, "which draws no other number: its places count"
    assert fixed.digest != Plan.of(fixed.points).digest


@pytest.mark.parametrize(
    ("change", "alike"),
    [
        ({"turn": 20}, True),
        ({"scale": [1.2, 0.9]}, True),
        ({"turn": -15, "scale": [0.9, 1.1]}, True),
        ({"turn": 60}, False),
        ({"turn": 90}, False),
        ({"mirror": "x"}, False),
        ({"scale": [2.5, 1]}, False),
    ],
)
def test_drawings_are_fitted_within_limits(change: dict[str, Any], alike: bool) -> None:
    boot = {"points": [[0, 0], [5, 0], [5, 2], [2, 2], [2, 6], [0, 6]], "closed": True}
    one, other = (plan_of(parse_program({"draw": [element]}).text) for element in (boot, boot | change))
    assert unlikeness(one, other) < 0.4 if alike else unlikeness(one, other) > 0.9


def test_medoid_is_one_of_the_three_that_agree() -> None:
    said = proposals(["egg", "heart", "moon", "heart", "peanut", "wedge", "heart", "leaf"], seed=5)
    chosen = MedoidConsensus().choose(NOTHING, said)
    assert chosen is not None and chosen.sender in (1, 3, 6)
    for j in range(8):
        again = MedoidConsensus().choose(follows(said[j]), said)
        assert again is (None if j == chosen.sender else chosen)


def test_without_likeness_the_order_of_plans_decides() -> None:
    said = proposals(["egg", "heart", "peanut", "leaf"], seed=1)
    chosen = MedoidConsensus().choose(NOTHING, said)
    assert chosen is said[3], "the highest id of equal influence, as by provenance"


def test_newer_larger_and_better_checked_proposals_come_first() -> None:
    said = proposals(["heart", "heart", "heart", "egg"], seed=2)
    for better in ({"epoch": 1}, {"mission": 7}):
        late = says(3, said[3].plan or Plan.of([]), **better)
        assert MedoidConsensus().choose(NOTHING, [*said[:3], late]) is late
    checked = replace(said[3], plan_class=1)
    assert MedoidConsensus().choose(NOTHING, [*said[:3], checked]) is checked
    small = [says(j, Plan.of(40.0 * drawn("heart", 12, np.random.default_rng(j)))) for j in range(3)]
    assert MedoidConsensus().choose(NOTHING, [*small, said[3]]) is said[3]


@pytest.mark.no_cover
@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_no_larger_group_of_wrong_ones_wins_over_the_right(seed: int) -> None:
    """Theorem 17: with w < r - (r - 1) d of the cap, for r right ones at most d apart and w wrong ones alike."""
    rng = np.random.default_rng(seed)
    right, others = str(rng.choice([*PICTURES])), [*PICTURES]
    n_right = int(rng.integers(2, 5))
    wrong = [str(x) for x in rng.permutation([x for x in others if x != right])[: int(rng.integers(1, 6))]]
    names = [right] * n_right + [name for name in wrong for _ in range(int(rng.integers(1, n_right)))]
    said = proposals(names, seed)
    plans = [message.plan or Plan.of([]) for message in said]
    apart = max(unlikeness(a, b) for a in plans[:n_right] for b in plans[:n_right])
    beside = [sum(unlikeness(a, b) < 1.0 for b in plans[n_right:]) for a in plans[n_right:]]
    foreign = min(unlikeness(a, b) for a in plans[:n_right] for b in plans[n_right:])
    if foreign < 1.0 or max(beside) >= n_right - (n_right - 1) * apart:
        return  # outside the theorem's conditions
    chosen = MedoidConsensus().choose(NOTHING, [said[int(k)] for k in rng.permutation(len(said))])
    assert chosen is not None and chosen.sender < n_right


def test_ballot_keeps_the_last_proposal_of_each_robot() -> None:
    ballot, (old, new, other) = Ballot(), [message.plan or Plan.of([]) for message in proposals(["egg"] * 3, seed=8)]
    assert ballot.pass_on() == ()
    ballot.take(origin(4), old, 0)
    ballot.take(origin(4, epoch=1), new, 2)
    ballot.take(origin(4), old, 0)
    known = ballot.known
    assert known[4].plan == new and known[4].plan_class == 2 and known[4].sender == 4
    ballot.take(origin(4, epoch=1), new, 2)
    assert ballot.known is known, "nothing new"
    ballot.take(origin(1), other, 0)
    mine = Proposal(provenance=origin(4, epoch=1), plan=new)
    hers = Proposal(provenance=origin(1), plan=other)
    assert [ballot.pass_on() for _ in range(4)] == [(mine, hers), (mine,), (hers,), (mine,)]
    for j in range(10):
        ballot.take(origin(j, epoch=2), new, 0)
    assert [len(ballot.pass_on()) for _ in range(4)] == [4, 4, 2, 1]


def test_two_plans_of_one_proposal_end_as_one_everywhere() -> None:
    plans = [message.plan or Plan.of([]) for message in proposals(["egg", "moon"], seed=4)]
    kept = set[str]()
    for order in (plans, plans[::-1]):
        ballot = Ballot()
        for plan in order:
            ballot.take(origin(2), plan, 0)
        kept.add(ballot.known[2].plan_digest or "")
    assert len(kept) == 1


def test_proposals_travel_and_are_checked() -> None:
    plan = Plan.of([(1, 2), (3, 4)])
    message = Message(sender=0, sequence=3, degree=1, proposals=(Proposal(provenance=origin(1), plan=plan),))
    assert decode(encode(message), 4, 2) == message
    for wrong, reason in (
        (Proposal(provenance=origin(4), plan=plan), "unknown_id"),
        (Proposal(provenance=origin(1, degree=4), plan=plan), "unknown_id"),
        (Proposal(provenance=origin(1), plan=Plan.of([(1, 2, 3)])), "wrong_length"),
    ):
        with pytest.raises(MessageError) as caught:
            decode(encode(replace(message, proposals=(wrong,))), 4, 2)
        assert caught.value.reason == reason


class Reader:
    """A *simulated* model that reads a picture's name rightly or not, and draws it in its own way."""

    __module__ = "readers"  # as a record names it; the path of this file is no module's
    simulated = True

    def __init__(self, picture: str, seed: int, n: int) -> None:
        self._rng = np.random.default_rng([9, seed])
        self._good = SimulatedModel(parse_profile("ideal"), self._rng)
        self._picture, self._n = picture, n

    async def ask(self, call: Call) -> str | Reply:
        text = next(m.text for m in reversed(call.messages) if m.role == "user")
        if PLAN_MARK not in text:
            return await self._good.ask(call)
        robot, _ = read_plan(text)
        rows = next(x for x in (spaced(drawn(self._picture, self._n, self._rng)) for _ in range(999)) if x is not None)
        return f"Plan: {(50.0 + rows).round(2).tolist()}\nmy plan: {robot}"


def spaced(points: Points) -> Points | None:
    """The points at a scale at which each one's nearest is 5 units away, within 9 %; None if there is none."""
    away = distances(points) + np.diag([math.inf] * len(points))
    nearest = away.min(axis=0)
    scale = 5.0 * 2.0 / (nearest.min() + nearest.max())
    return points * scale if nearest.min() * scale > 4.55 else None


def fly_pictures(names: list[str], seed: int, **options: object) -> llm_flock.RunResult:
    mission = Mission(shape="text:a heart", n_robots=len(names), spacing=5.0, safe_distance=1.0, comm_range=20.0)
    models = [Reader(name, 100 * seed + j, len(names)) for j, name in enumerate(names)]
    given = {"consensus": "medoid", "start": "separated", "rounds": 40, "trace": False} | options
    return llm_flock.run(mission, model=models, seed=seed, **given)  # pyright: ignore[reportArgumentType]


def nearest_picture(points: Points) -> str:
    """The picture whose own drawings are nearest to these points, both ways; shares nothing with the rule."""

    def away(name: str) -> float:
        drawings = [drawn(name, 200, np.random.default_rng(k)) for k in range(4)]
        scaled = points - points.mean(axis=0)
        scaled /= math.sqrt((scaled**2).sum(axis=1).mean())
        gaps = [np.linalg.norm(scaled[:, None] - drawing, axis=2) for drawing in drawings]
        return float(np.mean([gap.min(axis=0).mean() + gap.min(axis=1).mean() for gap in gaps]))

    return min(PICTURES, key=away)


@pytest.mark.no_cover
def test_team_flies_what_most_alike_models_drew() -> None:
    wrong = [name for name in PICTURES if name != "heart"]
    names = [*["heart"] * 10, *(wrong[k % 8] for k in range(14))]
    names = [names[int(k)] for k in np.random.default_rng(1).permutation(24)]
    flown = fly_pictures(names, 1, loss=0.3, join="3@6")
    assert flown.summary.formed and (flown.summary.min_separation or 0.0) >= 1.0 - 1e-9
    assert nearest_picture(flown.positions[-1]) == "heart"


def test_robots_that_come_late_have_their_say() -> None:
    """Without the four late proposals, the three that are alike win."""
    names = ["heart"] * 5 + ["moon"] * 3
    early = fly_pictures([names[0], *names[5:]], 1)
    late = fly_pictures(names, 1, join=",".join(f"{j}@4" for j in range(1, 5)))
    assert early.formed and late.formed
    assert [nearest_picture(flown.positions[-1]) for flown in (early, late)] == ["moon", "heart"]


def test_robot_keeps_proposals_that_pass_its_checks() -> None:
    mission = Mission(shape="text:a row", n_robots=3, spacing=10.0)
    parts = Parts(consensus=MedoidConsensus(), verifier=Validator(shield_on=True))
    agreement = Agreement(0, mission, parts)
    messaging = Messaging(0, agreement, parts)

    def hears(proposer: int, x: float, digest: str = mission.digest, apart: float = 10.0) -> list[str]:
        plan = Plan.of([(x, 50.0), (x + apart, 50.0), (x + 2 * apart, 50.0)])
        made = replace(origin(proposer), mission_digest=digest)
        said = (Proposal(provenance=made, plan=plan),)
        message = Message(sender=1, sequence=0, degree=1, stamp=MissionStamp(0, mission.digest), proposals=said)
        return [note.kind for note in messaging.receive(encode(message))]

    assert agreement.ballot is not None
    assert hears(1, 40.0) == [] and agreement.ballot.known.keys() == {1}
    assert hears(2, 40.0, digest="f" * 16) == [], "of another mission"
    assert hears(2, 40.0, apart=1.0) == ["rejected_message"]
    assert [hears(2, 40.0, apart=1.0 + k / 100) for k in range(1, 8)] == [["rejected_message"]] * 7
    assert hears(2, 40.0) == [] and agreement.ballot.known.keys() == {1}, (
        "its sender passes on one bad plan after another"
    )
    messaging.begin_round()
    assert hears(2, 39.9) == [] and agreement.ballot.known.keys() == {1, 2}
    agreement.begin_mission(mission.change(center=(40.0, 50.0)), MissionStamp(1, "a" * 16))
    assert agreement.ballot.known == {}
    assert hears(1, 40.0) == [], "of the mission before"


def test_message_without_room_leaves_proposals_for_later() -> None:
    mission = Mission(shape="text:a net", n_robots=12, spacing=10.0)
    long = Plan.of((x * 1.1, y * 1.1) for x in range(13) for y in range(10))
    spoken = tuple(Proposal(provenance=origin(j), plan=long) for j in range(4))
    whole = Message(sender=0, sequence=0, degree=2, stamp=MissionStamp(0, mission.digest), proposals=spoken)
    payload = Dissemination().compose(whole, None, mission)
    assert len(payload) <= max_payload_bytes(12)
    assert len(decode(payload, 12, 2).proposals or ()) == 2
