"""Any input from a network, a file or a provider is used or rejected by name: no traceback, no hang, no flood.

A plain run tries a few cases of each; `make fuzz` tries ten thousand.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from answer_readers import parse_path, parse_path_json, parse_plan, parse_plan_json, parse_step, parse_step_json
from effort import cases
from flights import flight_config
from gguf_files import MODEL, TENSORS, gguf
from hypothesis import given
from hypothesis import strategies as st
from mangled import changed_bytes, changed_value, mangled, mangled_json, tried
from mcap.writer import Writer
from reports import CONFIG, MISSION, N, told
from rounds import round_began
from sample_records import make_record
from signed_team import Liar, SignedTeam, good_plan
from toy_keys import ToyKeys
from whole_agent import whole_agent

from llm_flock.agent import Agent
from llm_flock.cli._display import show_conversation, show_overview
from llm_flock.errors import AnswerError, FlockError, InputError, MessageError, RecordError
from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskStep,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    Planned,
    Received,
)
from llm_flock.message import decode
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer
from llm_flock.protocol._verification.validator import Validator
from llm_flock.record._reader import iter_messages, read_record
from llm_flock.record._schema import NullWriter
from llm_flock.runtime._rules import PRESETS, assignment_rule, consensus_rule
from llm_flock.shapes import load_points
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_onboard._local.gguf import read_header
from llm_flock_swarm._cli.accusations import show_accusations
from llm_flock_swarm._network.observer import Observer
from llm_flock_swarm._network.wire import (
    Beacon,
    BeaconedMessage,
    Body,
    Command,
    MissionOrder,
    RobotReport,
    WorldState,
    pack,
    unpack,
)
from llm_flock_swarm._network.world import WorldBodies
from llm_flock_swarm._signed.guilt import guilt
from llm_flock_swarm._trust.envelope import Envelope
from llm_flock_view._foxglove.file import write_file
from llm_flock_view._viewer import data, events
from llm_flock_view._viewer.library import Library, load
from llm_flock_view._viewer.mind import mind
from llm_flock_view._viewer.replay_page import write_page

CASES = 25
VALIDATOR = Validator(shield_on=True)

seeds = st.integers(0, 2**63)


# --- messages ---------------------------------------------------------------------------------------------------------


def team(n: int = 4) -> list[Agent]:
    """Agents without keys that have agreed on nothing yet."""
    rules = PRESETS["flock"]
    mission = Mission(shape="circle", n_robots=n)
    return [
        whole_agent(
            j, mission, consensus_rule(rules["consensus"]), assignment_rule(rules["assignment"]), shield_on=True
        )
        for j in range(n)
    ]


def fly(agents: list[Agent], rng: random.Random, hostile: Callable[[bytes], list[bytes]]) -> None:
    """Rounds in which all robots hear each other, and what `hostile` makes of each message."""
    spots = [(45.0 + 10.0 * (j % 2), 45.0 + 10.0 * (j // 2)) for j in range(len(agents))]
    ideal = agents[0].mission.ideal or ()
    for number in range(1, 4):
        for j, agent in enumerate(agents):
            sensed = {k: x for k, x in enumerate(spots) if k != j}
            for _ in agent.handle(round_began(number, spots[j], sensed)):
                agent.handle(Planned(PlanAnswer(plan=Plan.of(ideal), slot=j)))
        for _ in range(3):
            said = [e.payload for a in agents for e in a.handle(CommRoundBegan()) if isinstance(e, Broadcast)]
            for j, payload in enumerate(said):
                for k, agent in enumerate(agents):
                    if k != j:
                        agent.handle(Received(payload, j))
                        for lie in hostile(payload):
                            agent.handle(Received(lie, rng.choice((j, None))))
            for agent in agents:
                agent.handle(CommRoundEnded())
        for agent in agents:
            if isinstance(agent.handle(AgreementEnded())[-1], AskStep):
                agent.handle(Decided(NoAnswer(cause="timeout", reason="none")))
            agent.handle(Arrived())


@cases(CASES)
@given(seed=seeds)
def test_no_message_ends_an_agent(seed: int) -> None:
    rng = random.Random(seed)
    agents = team()
    tried(lambda: fly(agents, rng, lambda payload: [mangled(payload, rng, 1) for _ in range(2)]))


@cases(CASES)
@given(seed=seeds)
def test_no_signed_message_ends_an_agent(seed: int) -> None:
    """The certificates too: of honest robots, changed on the way, and of a member that signs anything."""
    rng = random.Random(seed)
    honest = SignedTeam(Mission(shape="line", n_robots=4), [(20.0 + 10 * j, 50.0 + 3 * j) for j in range(4)])
    liar = Liar(honest)
    honest.begin()
    for _ in range(3):
        heard = [e.payload for a in honest.agents for e in a.handle(CommRoundBegan()) if isinstance(e, Broadcast)]
        heard.append(liar.says(slot=rng.randrange(4)))
        plan = good_plan(honest.mission, rng.randrange(3))
        heard.append(liar.says(plan=plan, provenance=liar.provenance(), table=None))
        hostile = [mangled(rng.choice(heard), rng, 1) for _ in range(6)]
        tried(lambda hostile=[*hostile, heard[-1]]: honest.comm_round(hostile))
        for payload in hostile:
            tried(lambda payload=payload: guilt(payload, 3, [honest.mission], VALIDATOR, ToyKeys(0)))
    honest.end()


@cases(CASES)
@given(seed=seeds)
def test_the_codec_takes_or_refuses(seed: int) -> None:
    rng = random.Random(seed)
    (payload,) = (e.payload for e in begun().handle(CommRoundBegan()) if isinstance(e, Broadcast))
    for _ in range(20):
        tried(lambda: decode(mangled(payload, rng, 1), 4, 2), MessageError)


def begun() -> Agent:
    """An agent with a plan."""
    agent = team()[0]
    for _ in agent.handle(round_began(1, (45.0, 45.0), {1: (55.0, 45.0)})):
        agent.handle(Planned(PlanAnswer(plan=Plan.of(agent.mission.ideal or ()), slot=0)))
    return agent


@cases(CASES)
@given(seed=seeds)
def test_envelopes_are_opened_or_refused(seed: int) -> None:
    rng = random.Random(seed)
    sealed = Envelope(ToyKeys(1), 7, max_payload=1000).seal(b"hello", "say/1")
    reader = Envelope(ToyKeys(2), 7, max_payload=1000)
    for _ in range(20):
        hostile = mangled(sealed, rng, 1) if rng.random() < 0.5 else sealed[:1] + mangled(sealed[1:-64], rng)
        tried(lambda hostile=hostile: reader.open(hostile, "say/1"), MessageError)


NEAR = (50.0, 50.0)
BEACON = Beacon(stamp=100.0, position=NEAR)
SENT = [
    BEACON,
    BeaconedMessage(beacon=BEACON, message=b"said"),
    Command(number=3, stamp=100.0, origin=NEAR, target=NEAR),
    WorldState(stamp=100.0, closest=5.0, bodies=(Body(position=NEAR, end=NEAR, command=1),) * N, late=0),
    MissionOrder(fields={"shape": "line", "center": [50.0, 50.0]}, counter=77, signature=b"s" * 64),
]


@cases(CASES)
@given(seed=seeds)
def test_everything_on_the_wire_is_taken_or_refused(seed: int) -> None:
    rng = random.Random(seed)
    world = WorldBodies(np.array([NEAR, (60.0, 50.0)]), speed=5.0, period_s=0.1, lag_s=0.05, now=100.0)
    for message in SENT:
        payload = mangled(pack(message), rng, 1)

        def take(message: Any = message, payload: bytes = payload) -> None:
            found = unpack(type(message), payload)
            if isinstance(found, Command):
                world.command(0, found, 100.0)
                world.advance(100.5)
                assert np.isfinite(world.positions).all()
            if isinstance(found, MissionOrder):
                MISSION.change(**found.fields)

        tried(take, MessageError, InputError)


@cases(CASES)
@given(seed=seeds)
def test_no_report_ends_an_observer(seed: int) -> None:
    rng = random.Random(seed)
    seen = Observer(CONFIG, NullWriter(), clock=lambda: 50.0)
    bodies = tuple(Body(position=NEAR, end=NEAR, command=0) for _ in range(N))
    seen.world(WorldState(stamp=1.0, closest=5.0, bodies=bodies, late=0))
    changes = {"shape": MISSION.model_dump(mode="json"), "mission": (7, MISSION.digest)}
    for robot in range(N):
        seen.comes_or_goes(robot, True)
        for report in (told(robot), told(robot, **changes)):
            payload = mangled(pack(report), rng, 1)
            tried(lambda robot=robot, payload=payload: seen.report(robot, unpack(RobotReport, payload)), MessageError)
    seen.check()
    assert seen.supplier is None or seen.supplier[0] >= 0
    assert (seen.rejected is not None and seen.hopeless is None) or seen.hopeless


# --- files ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_record(tmp_path_factory.mktemp("record") / "run.mcap", n=3, rounds=2)


def rewritten(source: Path, target: Path, rng: random.Random) -> None:
    """A record whose file is whole, but some of whose messages are not."""
    with target.open("wb") as file:
        writer = Writer(file, use_chunking=rng.random() < 0.3)
        writer.start()
        schema, channels = writer.register_schema("any", "jsonschema", b"{}"), dict[str, int]()
        messages = list(iter_messages(source))
        for number, message in enumerate(messages):
            if message.topic not in channels:
                channels[message.topic] = writer.register_channel(message.topic, "json", schema)
            body = message.data
            if rng.random() < 2.0 / len(messages):
                body = mangled_json(body, rng)
            if rng.random() < 0.3 / len(messages):
                body = b'{"round":' + b"[" * 100_000
            if rng.random() < 0.3 / len(messages):
                continue
            writer.add_message(channels[message.topic], number * 10**6, body, 0)
        writer.finish()


def inspected(path: Path) -> None:
    found = read_record(path)
    show_overview(found)
    show_accusations(found, keys=None)
    for robot in range(3):
        try:
            show_conversation(found, robot, None)
        except InputError:
            continue  # it made no calls


def watched(path: Path) -> None:
    library = Library()
    run = library.add("run", path, live=False)
    load(run)
    for name in ("about", "news", "frames"):
        assert data.answer(library, f"/data/{run.key}/{name}", {"count": "9"})
    if not run.ready:
        assert run.failure
        return
    assert run.description
    history = run.history
    for number in range(history.last_round + 1):
        assert all(events.in_words(event, history.plan_name) for event in history.events[number])
        data.event_lines(history, number)
        for robot in range(history.n_robots):
            history.provenance(robot, number)
            mind(history, robot, number)


@cases(CASES)
@given(seed=seeds)
def test_a_record_is_shown_or_refused_in_one_line(
    seed: int, record: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    rng = random.Random(seed)
    path = tmp_path_factory.getbasetemp() / "hostile.mcap"
    if rng.random() < 0.5:
        path.write_bytes(changed_bytes(record.read_bytes(), rng))
    else:
        rewritten(record, path, rng)
    tried(lambda: inspected(path), RecordError)
    tried(lambda: watched(path))
    tried(lambda: write_file(path, path.with_suffix(".foxglove")), RecordError)
    tried(lambda: write_page(path, path.with_suffix(".html")), RecordError)


@cases(CASES)
@given(seed=seeds)
def test_the_head_of_a_model_is_read_or_refused(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    rng = random.Random(seed)
    path = tmp_path_factory.getbasetemp() / f"{rng.randrange(8)}.gguf"
    path.write_bytes(changed_bytes(gguf(MODEL, TENSORS), rng))

    def read() -> None:
        head = read_header(path)
        assert head.alignment > 0 and head.cache_bytes >= 0 and isinstance(head.is_adapter, bool)

    tried(read, InputError)


FLIGHT_FILE = next((Path(__file__).parents[2] / "examples").glob("*fl*.toml"))


@cases(CASES)
@given(seed=seeds)
def test_a_flight_file_is_taken_or_refused(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    rng = random.Random(seed)
    whole = flight_config().model_dump(mode="json", exclude_none=True)
    path = tmp_path_factory.getbasetemp() / "flight.toml"
    if rng.random() < 0.5:
        path.write_bytes(changed_bytes(FLIGHT_FILE.read_bytes(), rng))
        tried(lambda: FlightConfig.load(path), InputError)
    else:
        section = rng.choice(list(whole))
        tried(lambda: FlightConfig.build({**whole, section: changed_value(whole[section], rng)}), InputError)


@cases(CASES)
@given(seed=seeds)
def test_a_file_of_points_is_taken_or_refused(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    rng = random.Random(seed)
    for name, good in (("a.csv", b"x,y\n1,2\n3.5,-40\n7,8\n"), ("a.json", b"[[1, 2], [3.5, -40], [7, 8]]")):
        path = tmp_path_factory.getbasetemp() / name
        path.write_bytes(mangled_json(good, rng) if name.endswith("json") else changed_bytes(good, rng))
        tried(lambda path=path: load_points(path), InputError)


# --- answers ----------------------------------------------------------------------------------------------------------

ANSWERS = [
    "Plan: [[50, 60], [41.3, 45], [58.7, 45]]\nMy Position: [50, 60]",
    "<think>Let me see: Position: [5, 0]</think>\nPosition: [51.5, 48.25]",
    '{"reasoning": "far", "plan": [[50, 60], [41.3, 45], [58.7, 45]], "my_position": [50, 60]}',
    '```json\n{"reasoning": "near", "position": [51.5, 48.25]}\n```',
    "Path: [[51, 50], [52, 50], [53, 50]]",
]


@cases(CASES)
@given(seed=seeds)
def test_an_answer_is_read_or_refused_in_time(seed: int) -> None:
    """Also one of a megabyte that repeats itself: no pattern takes more than linear time for it."""
    rng = random.Random(seed)
    raw = changed_bytes(rng.choice(ANSWERS).encode(), rng).decode("utf-8", "surrogateescape")
    if rng.random() < 0.1:
        at = rng.randrange(len(raw) + 1)
        raw = raw[:at] + raw[at : at + rng.choice((1, 2, 9, 60))] * rng.choice((1_000, 20_000)) + raw[at:]
    for parse in (parse_plan, parse_plan_json):
        tried(lambda parse=parse: parse(raw, 3, 2), AnswerError)
    for parse in (parse_path, parse_path_json):
        tried(lambda parse=parse: parse(raw, 3, 2), AnswerError)
    for parse in (parse_step, parse_step_json):
        tried(lambda parse=parse: parse(raw, 2), AnswerError)


def test_the_fuzz_is_hostile_enough() -> None:
    """Most of what is tried is refused, and some is taken: both sides of every check are seen."""
    rng = random.Random(3)
    good = pack(told(0))
    refused = 0
    for _ in range(300):
        try:
            Observer(CONFIG, NullWriter()).report(0, unpack(RobotReport, mangled(good, rng, 1)))
        except FlockError:
            refused += 1
    assert 100 < refused < 290
