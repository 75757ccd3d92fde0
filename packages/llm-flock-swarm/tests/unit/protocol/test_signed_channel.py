"""A lying robot with keys cannot propose plans, send messages, heartbeats or missions in the name of others."""

from __future__ import annotations

from collections import Counter

import msgspec
import numpy as np
import pytest
from opened_payloads import Opened
from signed_team import Liar, SignedTeam, channel_of, evidence_of, good_plan, line_up
from toy_keys import ToyKeys

from llm_flock.errors import MessageError
from llm_flock.events import Broadcast, CommRoundBegan, CommRoundEnded, MissionGiven, Planned, RoundBegan
from llm_flock.message import BLOCKED, MAX_EPOCHS, MAX_LOOKS, NO_OWNER, Message, MissionStamp, Offer, encode
from llm_flock.mission import Mission, mission_text
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer
from llm_flock.protocol._agreement.auction import AuctionAssignment
from llm_flock.protocol._agreement.messaging import MAX_BAD_PLANS
from llm_flock.protocol._membership.team import with_visits
from llm_flock.protocol._messages.channel import Authorization, _decode
from llm_flock.protocol._verification.plans import _verdict, check_plan
from llm_flock_swarm._signed.assignment import SignedAssignment
from llm_flock_swarm._signed.certificates import (
    OPERATOR,
    WIRE_SIGNED,
    Equivocation,
    Proofs,
    SignedPlan,
    WitnessStatement,
    beat_statement,
    mission_statement,
    offer_statement,
    unwrap,
    word_statement,
    wrap,
)
from llm_flock_swarm._signed.channel import MAX_PENDING
from llm_flock_swarm._signed.evidence import Evidence

MISSION = Mission(shape="circle", n_robots=5)


def test_a_hallucinated_plan_dies_with_its_author(team: SignedTeam, liar: Liar) -> None:
    plan = team.agents[0].plan
    heap = Plan.of([(50.0, 50.0 + 0.1 * k) for k in range(5)])
    lie = liar.says(plan=heap, provenance=liar.provenance(), table=None, slot=None)
    team.fly(2, lambda: [lie])
    assert team.agents[0].plan == plan
    assert team.counts("unverified_plan") > 0


def test_a_plan_in_the_name_of_another_is_refused(team: SignedTeam, liar: Liar) -> None:
    plan = team.agents[0].plan
    lie = liar.says(plan=good_plan(MISSION, 3), provenance=liar.provenance(proposer=0), table=None)
    assert team.tell(1, lie, team.liar) == ["forged_origin"]
    assert team.agents[1].plan == plan


def test_a_true_plan_of_a_liar_is_a_plan(team: SignedTeam, liar: Liar) -> None:
    plan = good_plan(MISSION, 3)
    lie = liar.says(plan=plan, provenance=liar.provenance(), table=None)
    team.fly(6, lambda: [lie])
    assert team.agents[0].plan == plan
    assert team.settled()


@pytest.mark.parametrize(("epoch", "sequence"), [(MAX_EPOCHS + 1, 0), (1, 2), (2**40 - 1, 0)])
def test_a_team_replans_a_bounded_number_of_times(epoch: int, sequence: int) -> None:
    team = SignedTeam(MISSION, line_up(5), gaps="replan")
    team.fly(1)
    liar = Liar(team)
    lie = liar.says(plan=good_plan(MISSION, 3), provenance=liar.provenance(epoch=epoch, sequence=sequence), table=None)
    assert team.tell(1, lie, team.liar) == ["many_plans"]


def test_origins_are_remembered_in_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("llm_flock_swarm._signed.channel.REMEMBERED_ORIGINS", 2)
    monkeypatch.setattr("llm_flock_swarm._signed.checks.REMEMBERED", 2)
    team = SignedTeam(MISSION, line_up(5), gaps="replan")
    team.fly(1)
    liar = Liar(team)
    channel, evidence = channel_of(team.agents[0]), evidence_of(team.agents[0])
    for k in range(5):
        plan = good_plan(MISSION, k)
        assert team.tell(0, liar.says(plan=plan, provenance=liar.provenance(epoch=k), table=None), team.liar) == []
        assert evidence.signed_by(1, b"%d" % k, ToyKeys(1).sign(b"%d" % k))
    assert len(channel._origins) <= 2
    assert len(evidence._checks._good) <= 2


# ---------------------------------------------------------------- who speaks


@pytest.mark.parametrize("adopted", [False, True])
def test_no_message_changes_the_origin_of_the_current_plan(adopted: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its proposer floods the team with earlier plans, and falls silent: the others go on to hear each other."""
    monkeypatch.setattr("llm_flock_swarm._signed.channel.REMEMBERED_ORIGINS", 4)
    team = SignedTeam(MISSION, line_up(5), gaps="replan")
    team.fly(2)
    liar = Liar(team)
    flood = [
        liar.says(plan=good_plan(MISSION, 40 + k), provenance=liar.provenance(epoch=k), table=None) for k in range(12)
    ]
    best = liar.says(plan=good_plan(MISSION, 3), provenance=liar.provenance(epoch=20), table=None)
    if adopted:
        team.fly(3, lambda: [best])
    team.fly(1, lambda: [best, *flood])
    before = team.counts("forged_origin")
    team.fly(3)
    assert team.agents[0].plan == good_plan(MISSION, 3) and team.settled()
    assert team.counts("forged_origin") == before == 0


@pytest.mark.parametrize("places", [3, *(pytest.param(n, marks=pytest.mark.no_cover) for n in (4, 5))])
def test_last_epoch_plan_yields_only_to_one_for_more_robots(places: int) -> None:
    """A liar proposes the last plan that counts, for fewer robots than are there: none is left without a place."""
    team = SignedTeam(MISSION, line_up(5), gaps="replan")
    liar = Liar(team)
    team.fly(2)
    last = good_plan(MISSION.resized(places), 3)
    lie = liar.says(plan=last, provenance=liar.provenance(epoch=MAX_EPOCHS), table=None)
    team.fly(25, lambda: [lie])
    ((plan, origin),) = {(agent.plan, agent.provenance) for agent in team.agents}
    assert plan is not None and origin is not None and origin.epoch == MAX_EPOCHS
    assert len(plan) == max(places, 4) and (plan == last) == (places >= 4)
    assert team.settled() and team.counts("many_plans") == 0
    again = [agent.robot for agent in team.agents if agent._agreement.may_propose(6)]
    assert again and origin.proposer not in again, "once in an epoch"
    agreement = team.agents[0]._agreement
    assert agreement.propose(PlanAnswer(plan=good_plan(MISSION.resized(3), 5), slot=0), "model") == []
    assert agreement.plan == plan


def test_a_plan_of_unknown_origin_is_passed_on_without_signature(team: SignedTeam, liar: Liar) -> None:
    """Receivers refuse it; it never happens as long as origins are kept."""
    plan, origin = good_plan(MISSION, 9), liar.provenance(epoch=2)
    content = encode(Message(sender=0, sequence=1, degree=1, plan=plan, provenance=origin))
    sealed = channel_of(team.agents[0]).seal(content)
    assert unwrap(sealed, 5)[1].origin is None


def test_visits_are_counted_up_to_what_others_accept(team: SignedTeam) -> None:
    agreement = team.agents[0]._agreement
    slot = agreement.claim.slot
    assert slot is not None and agreement.claim.table is not None
    table = list(agreement.claim.table)
    table[slot] = (0, float(MAX_LOOKS), NO_OWNER)
    agreement.claim = msgspec.structs.replace(agreement.claim, table=tuple(table))
    agreement.claim = with_visits(agreement.claim, [slot])
    assert (agreement.claim.table or ())[slot] == (0, float(MAX_LOOKS), NO_OWNER)


def test_bad_plans_are_verified_a_few_times_a_round(team: SignedTeam, liar: Liar) -> None:
    team.begin()
    lies = [
        liar.says(plan=Plan.of([(50.0, 50.0 + 0.01 * k)] * 5), provenance=liar.provenance(), table=None)
        for k in range(3 * MAX_BAD_PLANS)
    ]
    reasons = [reason for lie in lies for reason in team.tell(0, lie, team.liar)]
    assert reasons == MAX_BAD_PLANS * ["unverified_plan"] + 2 * MAX_BAD_PLANS * ["many_plans"]


def test_signed_messages_fill_no_cache(team: SignedTeam, liar: Liar) -> None:
    """That of decoded messages is for simulations; a flood of large plans would fill it."""
    _decode.cache_clear()
    team.fly(1, lambda: [liar.says()])
    assert _decode.cache_info().currsize == 0
    before = _verdict.cache_info().misses
    assert check_plan(MISSION, Plan.of([(50.0, 50.0)] * 900)) is not None
    assert _verdict.cache_info().misses == before


def test_message_in_anothers_name_is_rejected(team: SignedTeam, liar: Liar) -> None:
    said = liar.says(sender=2)
    assert team.tell(1, said, team.liar) == ["impostor"]
    assert team.tell(1, liar.says(), 3) == ["impostor"]
    assert team.tell(1, liar.says(sender=1), team.liar) == ["own_id"]


def test_unsigned_and_broken_messages_are_refused(team: SignedTeam, liar: Liar) -> None:
    message, proofs = unwrap(liar.says(), 5)
    assert team.tell(1, message, team.liar) == ["version"]
    assert team.tell(1, bytes([WIRE_SIGNED]) + b"\xff", team.liar) == ["malformed"]
    assert team.tell(1, bytes(10**5), team.liar) == ["oversized"]
    proof = Equivocation(2, (SignedPlan("abcd", 0, 1, 0, b""), SignedPlan("efgh", 0, 1, 0, b"")))
    no_text = wrap(message, msgspec.structs.replace(proofs, equivocations=(proof,))).replace(b"efgh", b"\xbe" * 4)
    assert team.tell(1, no_text, team.liar) == ["malformed"]
    with pytest.raises(MessageError, match="version"):
        unwrap(b"", 5)


def test_a_robot_without_a_plan_sends_no_signature_of_one() -> None:
    team = SignedTeam(MISSION, line_up(5))
    agent = team.agents[0]
    agent.handle(RoundBegan(round=1, position=team.positions[0], degree=0, sensed={}, observed=()))
    agent.handle(Planned(NoAnswer(cause="answer", reason="none")))
    (sent,) = agent.handle(CommRoundBegan())
    assert isinstance(sent, Broadcast) and unwrap(sent.payload, 5)[1].origin is None
    assert team.tell(1, sent.payload, 0) == []


def test_signed_rule_has_the_name_of_the_rule_it_decorates() -> None:
    assert SignedAssignment(AuctionAssignment(), Evidence(0, ToyKeys(0))).name == "auction"


# ---------------------------------------------------------------- heartbeats


def test_refused_heartbeats_are_not_kept_and_few_of_others(team: SignedTeam, liar: Liar) -> None:
    channel = channel_of(team.agents[0])

    def tell(count: int, forged: bytes) -> list[str]:
        beats = (0, count, 0, 0, 2**39)
        lie, proofs = unwrap(liar.says(beats=beats), 5)
        signatures = (b"", ToyKeys(1).sign(beat_statement(1, count)), b"", b"", forged)
        return team.tell(0, wrap(lie, msgspec.structs.replace(proofs, beats=signatures)), team.liar)

    kept = dict(channel._beats[1])
    for count in range(10**6, 10**6 + 50):
        assert tell(count, b"forged") == ["uncertified"]
    assert channel._beats[1] == kept
    for count in range(10**6, 10**6 + 50):
        assert tell(count, b"") == []
    assert list(channel._beats[1]) == [10**6 + 50 - k for k in range(MAX_PENDING, 0, -1)]


def test_robot_can_neither_stop_nor_fake_heartbeats_of_others(team: SignedTeam, liar: Liar) -> None:
    before = team.agents[0]._membership.beats
    high = tuple(2**40 - 1 for _ in range(5))
    team.tell(0, liar.says(beats=high), team.liar)
    lie, proofs = unwrap(liar.says(beats=high), 5)
    forged = tuple(liar.keys.sign(beat_statement(j, high[j])) for j in range(5))
    assert team.tell(0, wrap(lie, msgspec.structs.replace(proofs, beats=forged)), team.liar) == ["uncertified"]
    team.begin()
    team.comm_round()
    after = team.agents[0]._membership.beats
    assert after[4] == before[4]
    assert max(after) < 100
    team.fly(2)
    assert team.settled()


def test_no_signature_is_checked_after_first_forged_heartbeat(
    team: SignedTeam, liar: Liar, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A check takes a tenth of a millisecond, and a message may come every hundredth of a second."""
    lie, proofs = unwrap(liar.says(beats=(2**39,) * 5), 5)
    payload = wrap(lie, msgspec.structs.replace(proofs, beats=(liar.keys.sign(b"another"),) * 5))
    checks = count_checks(monkeypatch)
    assert team.tell(1, payload, team.liar) == ["uncertified"]
    assert checks.total() <= 2, "the origin of the plan, and one heartbeat"


def test_a_message_with_many_forged_words_costs_one_check(
    team: SignedTeam, liar: Liar, monkeypatch: pytest.MonkeyPatch
) -> None:
    forged = liar.keys.sign(b"another")
    table = team.agents[0].claim.table
    assert table is not None
    words = [
        WitnessStatement(witness, slot, table[slot][0] + 1, owner, forged)
        for slot in range(5)
        for witness in range(4)
        for owner in (NO_OWNER, BLOCKED)
    ]
    team.tell(0, liar.says(words=words), team.liar)
    checks = count_checks(monkeypatch)
    team.agents[0].handle(CommRoundEnded())
    assert checks[forged] == 1
    assert team.agents[0].rejected["uncertified"] == 1


def count_checks(monkeypatch: pytest.MonkeyPatch) -> Counter[bytes]:
    """How often each signature is checked from now on."""
    checks, check = Counter[bytes](), ToyKeys.check

    def counted(self: ToyKeys, member: int, statement: bytes, signature: bytes) -> bool:
        checks[signature] += 1
        return check(self, member, statement, signature)

    monkeypatch.setattr(ToyKeys, "check", counted)
    return checks


def test_a_signed_heartbeat_is_passed_on_by_others(team: SignedTeam, liar: Liar) -> None:
    message, proofs = unwrap(liar.says(beats=(0, 0, 0, 0, 9)), 5)
    signed = msgspec.structs.replace(proofs, beats=(b"", b"", b"", b"", liar.keys.sign(beat_statement(4, 9))))
    team.begin()
    team.tell(0, wrap(message, signed), team.liar)
    for _ in range(5):
        team.comm_round()
    team.end()
    team.fly(2)
    assert [agent._membership.beats[4] for agent in team.agents] == [9] * 4


# ---------------------------------------------------------------- missions


def test_only_the_operator_gives_missions(team: SignedTeam, liar: Liar) -> None:
    square = MISSION.change(center=(52.0, 50.0))
    stamp = MissionStamp(10**9, square.digest)
    forged = Authorization(counter=stamp.counter, signature=liar.keys.sign(mission_statement(stamp)))
    for authorization in (None, forged):
        order = MissionGiven(mission=square, ordered_at=stamp.counter, authorization=authorization)
        (note,) = team.agents[0].handle(order)
        assert (note.kind, note.detail["reason"]) == ("rejected_message", "no_order")  # type: ignore[union-attr]
    text = mission_text(square)
    lie = encode(Message(sender=4, sequence=0, degree=0, stamp=stamp, mission_text=text))
    for proofs in (Proofs(), Proofs(mission=forged.signature)):
        assert team.tell(0, wrap(lie, proofs), team.liar) == ["no_order"]
    assert team.agents[0].mission == MISSION
    team.end()

    authorization = Authorization(counter=stamp.counter, signature=ToyKeys(OPERATOR).sign(mission_statement(stamp)))
    assert team.agents[0].authorization == b""
    (note,) = team.agents[0].handle(MissionGiven(mission=square, ordered_at=stamp.counter, authorization=authorization))
    assert team.agents[0].authorization == authorization.signature
    assert note.kind == "mission"  # type: ignore[union-attr]
    (note,) = team.agents[0].handle(MissionGiven(mission=square, ordered_at=stamp.counter, authorization=authorization))
    assert note.detail["reason"] == "old_mission"  # type: ignore[union-attr]
    team.fly(8)
    assert {agent.mission.center for agent in team.agents} == {(52.0, 50.0)}
    assert team.settled()


def test_a_mission_is_not_read_before_its_signature_is_checked(team: SignedTeam, liar: Liar) -> None:
    """To read one takes up to a hundred times as long."""
    stamp = MissionStamp(10**9, "0" * 16)
    lie = encode(Message(sender=4, sequence=0, degree=0, stamp=stamp, mission_text="no mission"))
    assert team.tell(0, wrap(lie, Proofs(mission=liar.keys.sign(mission_statement(stamp)))), team.liar) == ["no_order"]


def test_an_order_whose_mission_is_refused_is_not_passed_on(team: SignedTeam, liar: Liar) -> None:
    """The operator's signature is good, but the text is not that mission's."""
    stamp = MissionStamp(10**9, MISSION.change(center=(52.0, 50.0)).digest)
    proofs = Proofs(mission=ToyKeys(OPERATOR).sign(mission_statement(stamp)))
    for text, reason in (("{}", "other_mission"), ("[", "malformed")):
        lie = encode(Message(sender=4, sequence=0, degree=0, stamp=stamp, mission_text=text))
        assert team.tell(0, wrap(lie, proofs), team.liar) == [reason]
    assert team.agents[0].authorization == b"" and team.agents[0].mission == MISSION


def signed(mission: Mission, time: int) -> MissionGiven:
    signature = ToyKeys(OPERATOR).sign(mission_statement(MissionStamp(time, mission.digest)))
    authorization = Authorization(counter=time, signature=signature)
    return MissionGiven(mission=mission, ordered_at=time, authorization=authorization)


def test_older_order_does_not_replace_the_signature_passed_on(team: SignedTeam) -> None:
    """Otherwise a robot would show the signature of another mission with its own, and no other would take it over."""
    last, older = MISSION.change(center=(52.0, 50.0)), MISSION.change(center=(47.0, 50.0))
    team.agents[0].handle(signed(last, 7))
    (note,) = team.agents[0].handle(signed(older, 6))
    assert note.detail["reason"] == "old_mission"  # type: ignore[union-attr]
    team.fly(3)
    assert {agent.mission.center for agent in team.agents} == {(52.0, 50.0)} and team.counts("no_order") == 0


@pytest.mark.parametrize("seed", range(3))
def test_last_of_signed_orders_to_several_robots_is_flown(seed: int) -> None:
    """They arrive in any order, the last one at another robot than the others, and messages are lost."""
    team = SignedTeam(MISSION, line_up(5), seed=seed, loss=0.3)
    team.fly(2)
    orders = [signed(MISSION.change(center=(46.0 + k, 50.0)), 10 + k) for k in range(4)]
    for k in np.random.default_rng(seed).permutation(4).tolist():
        team.agents[3 if k == 3 else 0].handle(orders[k])
    team.fly(10)
    assert {agent.mission.center for agent in team.agents} == {(49.0, 50.0)} and team.settled()


def test_signatures_of_one_kind_are_not_those_of_another() -> None:
    team = SignedTeam(MISSION, line_up(5))
    team.fly(1)
    kinds = [
        word_statement(team.context, 1, 1, -1),
        beat_statement(1, 1),
        mission_statement(team.context.mission),
        offer_statement(team.context, 1, Offer(to=1, give=1, take=1, give_version=1, take_version=1, bid=1.0), 1),
    ]
    assert len(set(kinds)) == len(kinds)


def test_with_keys_every_payload_is_verified(team: SignedTeam, liar: Liar) -> None:
    team.begin()
    opened = Opened(team.agents[0])
    same = liar.says()
    assert [opened.during(lambda: team.tell(0, same, team.liar)) for _ in range(3)] == [1, 1, 1]
    assert team.tell(0, same, 2) == ["impostor"], "another sender"
