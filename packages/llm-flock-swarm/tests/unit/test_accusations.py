"""Accusations: who accuses needs the liar's own signature, and an observer believes nothing else."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from reports import CONFIG, MISSION, N, happened, told
from sample_records import make_record
from toy_keys import ToyKeys

from llm_flock.errors import InputError, MessageError
from llm_flock.message import Message, MissionStamp, Provenance, encode
from llm_flock.plan import Plan
from llm_flock.record._reader import read_record
from llm_flock.record._schema import ProtocolEvent
from llm_flock.runtime._journal import mission_info, run_info
from llm_flock_swarm._cli.accusations import MAX_SHOWN, show_accusations
from llm_flock_swarm._network.accusations import MAX_JUDGED, MAX_PROOF_BYTES, Accuser, Judge
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.observer import MAX_UNPROVEN, Observer
from llm_flock_swarm._network.wire import WIRE_VERSION, Beacon, BeaconedMessage, pack
from llm_flock_swarm._signed.certificates import Proofs, origin_statement, wrap
from llm_flock_swarm._trust.envelope import Envelope, signed_payload
from llm_flock_swarm._trust.keys import load_keyring, load_public_keys, make_keys

LIAR = 2
JUDGE = Judge(ToyKeys(0), CONFIG)
STAMP = MissionStamp(0, MISSION.digest)


def sealed(message: bytes | None, by: int = LIAR, topic: str | None = None) -> bytes:
    """What a member sends; `None` for a message between processes that is none."""
    beacon = Beacon(stamp=1.0, position=(1.0, 2.0))
    payload = bytes([WIRE_VERSION]) + b"?" if message is None else pack(BeaconedMessage(beacon=beacon, message=message))
    topic = JUDGE.topic(by) if topic is None else topic
    return Envelope(ToyKeys(by), 1, max_payload=MAX_PROOF_BYTES).seal(payload, topic)


def said(sender: int) -> bytes:
    """A message that says nothing but who sends it."""
    return wrap(encode(Message(sender=sender, sequence=0, degree=1, stamp=STAMP)), Proofs())


FORGED = sealed(said(1))
"""Robot 2 speaks as robot 1."""


def accusation(proof: object, robot: object = LIAR) -> dict[str, Any]:
    text = base64.b64encode(proof).decode() if isinstance(proof, bytes) else proof
    return {"robot": robot, "reason": "whatever", "proof": text}


@pytest.mark.parametrize(
    ("robot", "message", "expected"),
    [
        (LIAR, FORGED, "impostor"),
        (LIAR, sealed(None), "malformed"),
        (LIAR, sealed(b""), None),
        (LIAR, sealed(said(LIAR)), None),
        (1, FORGED, None),
        (LIAR, sealed(said(1), topic="report/2"), None),
        (LIAR, sealed(said(1), by=0, topic=JUDGE.topic(2)), None),
        (LIAR, FORGED[:-1] + bytes([FORGED[-1] ^ 1]), None),
        (LIAR, b"", None),
        (LIAR, b"\x07" + FORGED[1:], None),
        (LIAR, Envelope(ToyKeys(LIAR), 1, max_payload=99).seal(b"\x01old", JUDGE.topic(2)), None),
    ],
)
def test_only_what_a_robot_signed_in_its_own_topic_counts(robot: int, message: bytes, expected: str | None) -> None:
    assert JUDGE.verdict(robot, message, [MISSION]) == expected


@pytest.mark.parametrize("other", [{"swarm": "other"}, {"gaps": "replan"}, {"n_robots": 6}, {"verify": False}])
def test_messages_of_another_flight_prove_nothing(other: dict[str, Any]) -> None:
    """They were faultless there."""
    config = SwarmConfig.build({}, **{"shape": "triangle", "n_robots": N, "model": "simulated:ideal", **other})
    judge = Judge(ToyKeys(0), config)
    assert judge.topic(LIAR) != JUDGE.topic(LIAR) and judge.verdict(LIAR, FORGED, [config.mission]) is None


def test_without_verification_no_plan_is_evidence() -> None:
    bad = Plan.of([(50.0, 50.0)] * N)
    origin = Provenance(mission=0, mission_digest=MISSION.digest, epoch=0, degree=1, proposer=LIAR, sequence=0)
    message = Message(sender=LIAR, sequence=0, degree=1, plan=bad, provenance=origin)
    proofs = Proofs(origin=ToyKeys(LIAR).sign(origin_statement(origin, bad.digest)))
    for verify, expected in ((True, "unverified_plan"), (False, None)):
        config = SwarmConfig.build({}, shape="triangle", n_robots=N, model="simulated:ideal", verify=verify)
        judge = Judge(ToyKeys(0), config)
        proof = sealed(wrap(encode(message), proofs), topic=judge.topic(LIAR))
        assert judge.verdict(LIAR, proof, [config.mission]) == expected


@pytest.mark.parametrize(
    "detail",
    [
        accusation(FORGED, robot="2"),
        accusation(FORGED, robot=1),
        accusation(FORGED, robot=True),
        accusation(7),
        accusation("not base64"),
        accusation("A" * (2 * MAX_PROOF_BYTES + 4)),
        accusation(sealed(said(LIAR))),
        {},
    ],
)
def test_accusations_that_prove_nothing_are_dropped(detail: dict[str, Any]) -> None:
    assert JUDGE.confirms(detail, [MISSION]) is None
    observer = Observer(CONFIG, Sink(), judge=JUDGE)
    accused = ProtocolEvent.model_construct(round=0, robot=0, kind="accused", detail=detail)
    observer.report(0, told(0, happened=(accused,)))
    assert observer.shown_to_lie == {} and observer.reports.keys() == {0}


class Sink:
    def __init__(self) -> None:
        self.events: list[ProtocolEvent] = []

    def write(self, entry: object) -> None:
        if isinstance(entry, ProtocolEvent):
            self.events.append(entry)


def test_an_observer_records_the_first_proof() -> None:
    sink = Sink()
    observer = Observer(CONFIG, sink, judge=JUDGE)
    for robot in (0, 1):
        observer.report(robot, told(robot, happened=happened(robot, "accused", **accusation(FORGED))))
    assert observer.shown_to_lie == {LIAR: "impostor"}
    assert [event.robot for event in sink.events] == [0]


def test_without_keys_nothing_is_proven() -> None:
    observer = Observer(CONFIG, Sink())
    observer.report(0, told(0, happened=happened(0, "accused", **accusation(FORGED))))
    assert observer.shown_to_lie == {}


def test_false_accusations_are_judged_a_limited_number_of_times(monkeypatch: pytest.MonkeyPatch) -> None:
    judged: list[object] = []
    monkeypatch.setattr(JUDGE, "confirms", lambda *_: judged.append(1))
    observer = Observer(CONFIG, Sink(), judge=JUDGE)
    many = happened(0, "accused", **accusation(FORGED)) * (3 * MAX_UNPROVEN)
    observer.report(0, told(0, happened=many))
    assert len(judged) == MAX_UNPROVEN


def test_a_robot_accuses_each_liar_once_and_only_after_a_refusal() -> None:
    accuser = Accuser(JUDGE)
    accuser.hear(LIAR, FORGED)
    assert accuser.accuse(0, MISSION) is None, "nothing was refused"
    accuser.hear(1, sealed(said(1), by=1))
    accuser.hear(LIAR, FORGED)
    note = accuser.accuse(1, MISSION)
    assert note is not None and JUDGE.confirms(note.detail, [MISSION]) == (LIAR, "impostor")
    accuser.hear(LIAR, FORGED)
    assert accuser.accuse(2, MISSION) is None
    accuser.hear(0, bytes(MAX_PROOF_BYTES + 1))
    assert accuser.accuse(3, MISSION) is None


def test_a_robot_judges_a_sender_so_often_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    judged: list[object] = []
    judge = Judge(ToyKeys(0), CONFIG)
    monkeypatch.setattr(judge, "verdict", lambda *_: judged.append(1))
    accuser = Accuser(judge)
    for refused in range(1, 2 * MAX_JUDGED):
        accuser.hear(1, b"x")
        accuser.accuse(refused, MISSION)
    assert len(judged) == MAX_JUDGED


def test_an_envelope_is_judged_after_it_was_opened() -> None:
    assert signed_payload(FORGED, JUDGE.topic(2), ToyKeys(0))[0] == LIAR
    for topic, letter, cause in (
        ("say/2", FORGED, "bad_signature"),
        (JUDGE.topic(2), b"", "version"),
        (JUDGE.topic(2), b"\x02?" + bytes(64), "malformed"),
    ):
        with pytest.raises(MessageError, match=cause):
            signed_payload(letter, topic, ToyKeys(0))


def test_the_public_keys_are_enough_to_check_a_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    make_keys(tmp_path / "team", N)
    liar = load_keyring(tmp_path / "team", LIAR).for_flight(CONFIG.network.swarm)
    beacon = Beacon(stamp=1.0, position=(1.0, 2.0))
    payload = pack(BeaconedMessage(beacon=beacon, message=said(1)))
    proof = Envelope(liar, 1, max_payload=MAX_PROOF_BYTES).seal(payload, JUDGE.topic(LIAR))
    events = tuple(
        ProtocolEvent(round=0, comm_round=None, robot=1, kind="accused", detail=accusation(proof, robot))
        for robot in (LIAR, 0)
    )
    third = tmp_path / "third"
    third.mkdir()
    (third / "team.json").write_bytes((tmp_path / "team" / "team.json").read_bytes())
    record = read_record(make_record(tmp_path / "run.mcap", n=N, rounds=1))
    run = run_info(CONFIG, simulated=True)
    record = replace(record, run=run, events=events, missions=(mission_info(MISSION, 0, 0),))
    show_accusations(record, keys=third)
    show_accusations(record, keys=None)
    first, second, *unchecked = capsys.readouterr().out.splitlines()
    assert first == "robot 1 accuses robot 2 of lying: proven, it signed this message (impostor)"
    assert second == "robot 1 accuses robot 0 of lying: not proven"
    assert len(unchecked) == 2 and all("give --keys" in line for line in unchecked)
    show_accusations(replace(record, run=record.run.model_copy(update={"config": {}})), keys=third)
    assert "not proven" in capsys.readouterr().out, "a record of no swarm"
    show_accusations(replace(record, events=2 * MAX_SHOWN * events[:1]), keys=third)
    assert f"{MAX_SHOWN} more accusations" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"team\.json"):
        show_accusations(record, keys=tmp_path / "nowhere")
    assert load_public_keys(third).robots == N
