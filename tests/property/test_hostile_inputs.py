"""Hostile but legal messages, reports, configurations and answers end nothing, and reach nothing outside.

They are made from the types that read them (`hostile.py`), and a part of them is damaged besides. A plain run tries
some two hundred of each; `make fuzz` tries twenty thousand.
"""

from __future__ import annotations

import asyncio
import json
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from audit import kept_inside, reading_anywhere
from flights import flight_config
from gguf_files import MODEL, TENSORS, gguf
from hostile import Hostile, damaged, drawn, seeds, toml
from mangled import changed_bytes, mangled_json, tried
from reports import CONFIG, MISSION, N, told
from rounds import round_began
from sample_records import run_info
from signed_team import Liar, SignedTeam, good_plan
from sweeps import small_file
from toy_keys import ToyKeys
from whole_agent import whole_agent

from llm_flock.agent import Agent
from llm_flock.errors import AnswerError, InputError, MessageError
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
from llm_flock.llm._answer_forms import answer_schema
from llm_flock.llm._answers import read_plan, read_waypoints
from llm_flock.llm._planner import LanguagePlanner
from llm_flock.llm._port import AnswerForm, Call, Reply, Usage
from llm_flock.llm._prompting import PromptSet
from llm_flock.message import Message, decode
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepQuestion
from llm_flock.point_files import load_points
from llm_flock.protocol._verification.validator import Validator
from llm_flock.record._reader import read_record
from llm_flock.record._writer import RecordWriter
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._forecast import expect_run
from llm_flock.runtime._planners import check_planners
from llm_flock.runtime._rules import PRESETS, assignment_rule, consensus_rule
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_lab._experiments.sweep_file import SweepFile, load_sweep
from llm_flock_onboard._local.gguf import read_header
from llm_flock_swarm._network.config import SwarmConfig
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
from llm_flock_swarm._signed.certificates import Proofs, unwrap, wrap
from llm_flock_swarm._signed.guilt import guilt
from llm_flock_swarm._trust.envelope import Envelope, _Content

PARTS = 4
parts = pytest.mark.parametrize("part", range(PARTS))
CASES = 200
VALIDATOR = Validator(shield_on=True)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Tests run in a folder of their own, with bait in it and beside it."""
    with kept_inside(tmp_path, monkeypatch) as folder:
        yield folder


# --- messages ---------------------------------------------------------------------------------------------------------


def legal_message(payload: bytes, rng: random.Random) -> bytes:
    """Another message that its receiver can decode, or nearly; most of it is that of an honest robot."""
    changed = Hostile(rng, binary=True).struct(Message, msgspec.msgpack.decode(payload[1:]))
    return damaged(payload[:1] + msgspec.msgpack.encode(changed), rng)


def legal_proofs(payload: bytes, rng: random.Random) -> bytes:
    message, proofs = unwrap(payload, 4)
    if rng.random() < 0.6:
        message = legal_message(message, rng)
    if rng.random() < 0.6:
        changed = Hostile(rng, binary=True).struct(Proofs, msgspec.to_builtins(proofs))
        proofs = msgspec.convert(changed, Proofs, strict=False)
    return damaged(wrap(message, proofs), rng)


def team(n: int = 4) -> list[Agent]:
    """Agents without keys that have agreed on nothing yet."""
    rules = PRESETS["flock"]
    mission = Mission(shape="circle", n_robots=n)
    consensus, assignment = consensus_rule(rules["consensus"]), assignment_rule(rules["assignment"])
    return [whole_agent(j, mission, consensus, assignment, shield_on=True) for j in range(n)]


def fly(agents: list[Agent], rng: random.Random, hostile: Callable[[bytes], bytes]) -> None:
    """Rounds in which all robots hear each other, and what `hostile` makes of each message."""
    spots = [(45.0 + 10.0 * (j % 2), 45.0 + 10.0 * (j // 2)) for j in range(len(agents))]
    ideal = agents[0].mission.ideal or ()
    for number in range(1, 4):
        for j, agent in enumerate(agents):
            sensed = {k: x for k, x in enumerate(spots) if k != j}
            for _ in agent.handle(round_began(number, spots[j], sensed)):
                agent.handle(Planned(PlanAnswer(plan=Plan.of(ideal), slot=j)))
        for _ in range(2):
            said = [e.payload for a in agents for e in a.handle(CommRoundBegan()) if isinstance(e, Broadcast)]
            for j, payload in enumerate(said):
                for k, agent in enumerate(agents):
                    if k != j:
                        agent.handle(Received(payload, j))
                        agent.handle(Received(hostile(payload), rng.choice((j, None))))
            for agent in agents:
                agent.handle(CommRoundEnded())
        for agent in agents:
            if isinstance(agent.handle(AgreementEnded())[-1], AskStep):
                agent.handle(Decided(NoAnswer(cause="timeout", reason="none")))
            agent.handle(Arrived())


@parts
def test_no_message_ends_an_agent(part: int) -> None:
    """Each flight has 72 hostile messages."""
    taken = heard = 0
    for seed in seeds("fly", CASES // 50, part, PARTS):
        with drawn(seed) as rng:

            def hostile(payload: bytes, rng: random.Random = rng) -> bytes:
                nonlocal taken, heard
                lie = legal_message(payload, rng)
                heard += 1
                taken += tried(lambda: decode(lie, 4, 2), MessageError) is None
                return lie

            tried(lambda rng=rng, hostile=hostile: fly(team(), rng, hostile))
    assert 0.1 * heard < taken < 0.95 * heard or not heard


@parts
def test_no_signed_message_ends_an_agent(part: int) -> None:
    """The certificates too: of honest robots, changed on the way, and of a member that signs anything."""
    for seed in seeds("signed", CASES // 20, part, PARTS):
        with drawn(seed) as rng:
            honest = SignedTeam(Mission(shape="line", n_robots=4), [(20.0 + 10 * j, 50.0 + 3 * j) for j in range(4)])
            liar = Liar(honest)
            honest.begin()
            for _ in range(3):
                said = (a.handle(CommRoundBegan()) for a in honest.agents)
                heard = [e.payload for effects in said for e in effects if isinstance(e, Broadcast)]
                heard.append(liar.says(slot=rng.randrange(4)))
                plan = good_plan(honest.mission, rng.randrange(3))
                heard.append(liar.says(plan=plan, provenance=liar.provenance(), table=None))
                hostile = [legal_proofs(rng.choice(heard), rng) for _ in range(7)]
                tried(lambda lies=[*hostile, heard[-1]], honest=honest: honest.comm_round(lies))
                for lie in hostile:
                    tried(lambda lie=lie, of=honest.mission: guilt(lie, 3, [of], VALIDATOR, ToyKeys(0)))
            honest.end()


@parts
def test_envelopes_are_opened_or_rejected(part: int) -> None:
    reader, sender = Envelope(ToyKeys(2), 7, max_payload=1000), ToyKeys(1)
    for seed in seeds("seal", CASES, part, PARTS):
        with drawn(seed) as rng:
            sealed = Envelope(sender, 7, max_payload=1000).seal(b"hello", "say/1")
            content = Hostile(rng, binary=True).struct(_Content, msgspec.msgpack.decode(sealed[1:-64]))
            hostile = sealed[:1] + msgspec.msgpack.encode(content)
            hostile = damaged(hostile + sender.sign(b"envelope\0" + (5).to_bytes(4) + b"say/1" + hostile), rng)
            tried(lambda hostile=hostile: reader.open(hostile, "say/1"), MessageError)


NEAR = (50.0, 50.0)
BEACON = Beacon(stamp=100.0, position=NEAR)
SENT = [
    BEACON,
    BeaconedMessage(beacon=BEACON, message=b"said"),
    Command(number=3, stamp=100.0, origin=NEAR, target=NEAR),
    WorldState(stamp=100.0, closest=5.0, bodies=(Body(position=NEAR, end=NEAR, command=1),) * N, late=0),
    MissionOrder(fields=MISSION.model_dump(mode="json", exclude_none=True), counter=77, signature=b"s" * 64),
]


@parts
def test_the_wire_is_taken_or_rejected(part: int) -> None:
    world = WorldBodies(np.array([NEAR, (60.0, 50.0)]), speed=5.0, period_s=0.1, lag_s=0.05, now=100.0)
    for seed in seeds("wire", CASES, part, PARTS):
        with drawn(seed) as rng:
            for message in SENT:
                hostile = Hostile(rng, binary=True)
                changed = hostile.struct(type(message), msgspec.msgpack.decode(pack(message)[1:]))
                if isinstance(message, MissionOrder):
                    changed["fields"] = hostile.model(Mission, message.fields)
                payload = damaged(pack(message)[:1] + msgspec.msgpack.encode(changed), rng)

                def take(message: Any = message, payload: bytes = payload) -> None:
                    found = unpack(type(message), payload)
                    if isinstance(found, Command):
                        world.command(0, found, 100.0)
                        world.advance(100.5)
                        assert np.isfinite(world.positions).all()
                    if isinstance(found, MissionOrder):
                        MISSION.change(**found.fields)

                tried(take, MessageError, InputError)


@parts
def test_no_report_ends_an_observer(part: int, here: Path) -> None:
    """Every report that is taken is in the record, which can be read; a plain state of the world comes between."""
    for number, seed in enumerate(seeds("report", CASES // 10, part, PARTS)):
        path = here / f"{number}.mcap"
        with drawn(seed) as rng, RecordWriter(path) as writer:
            hostile = Hostile(rng, binary=True)
            writer.write(run_info())
            seen = Observer(CONFIG, writer, clock=lambda: 50.0)
            bodies = tuple(Body(position=NEAR, end=NEAR, command=0) for _ in range(N))
            world = WorldState(stamp=1.0, closest=5.0, bodies=bodies, late=0)
            plain = msgspec.msgpack.decode(pack(world)[1:])
            for k in range(10):
                robot = k % N
                seen.comes_or_goes(robot, True)
                shape = hostile.model(Mission, MISSION.model_dump(mode="json"))
                good = told(robot, **({"shape": shape, "mission": (7, MISSION.digest)} if rng.random() < 0.3 else {}))
                report = hostile.struct(RobotReport, msgspec.msgpack.decode(pack(good)[1:]))
                payload = damaged(pack(good)[:1] + msgspec.msgpack.encode(report), rng)
                tried(
                    lambda seen=seen, robot=robot, it=payload: seen.report(robot, unpack(RobotReport, it)), MessageError
                )
                seen.world(world)
                state = pack(world)[:1] + msgspec.msgpack.encode(hostile.struct(WorldState, plain))
                tried(lambda seen=seen, it=state: seen.world(unpack(WorldState, it)), MessageError)
                seen.check()
        assert read_record(path).rounds >= 0
        path.unlink()


# --- files ------------------------------------------------------------------------------------------------------------


@parts
def test_the_head_of_a_model_is_read_or_rejected(part: int) -> None:
    path = Path("model.gguf")
    for seed in seeds("gguf", CASES // 8, part, PARTS):
        with drawn(seed) as rng:
            path.write_bytes(changed_bytes(gguf(MODEL, TENSORS), rng))

            def read() -> None:
                head = read_header(path)
                assert head.alignment > 0 and head.cache_bytes >= 0 and isinstance(head.is_adapter, bool)

            tried(read, InputError)


GOOD_POINTS = {
    "a.csv": b"x,y\n1,2\n3.5,-40\n7,8\n",
    "b.csv": b"id;x;y\n1;2,5;3\n2;3,5;-40\n",
    "a.json": b"[[1, 2], [3.5, -40], [7, 8]]",
    "b.json": b'{"A": {"x": 1, "y": 2}, "B": [3.5, -40]}',
    "a.svg": b'<svg><g transform="translate(1 2) rotate(30)"><polygon points="1,2 3.5,-40 7e1,8"/></g></svg>',
}


def test_a_file_of_points_is_taken_or_rejected() -> None:
    for seed in seeds("points", CASES // 8):
        with drawn(seed) as rng:
            for name, good in GOOD_POINTS.items():
                path = Path(name)
                path.write_bytes(mangled_json(good, rng) if name.endswith("json") else changed_bytes(good, rng))
                tried(lambda path=path: load_points(path), InputError)


def dry_run(kind: Any, path: Path) -> None:
    """The dry run of the configurations in a file; rehearsals of large teams would take long."""
    with reading_anywhere():
        found = [trial.config for trial in load_sweep(path).trials[:1]] if kind is SweepFile else [kind.load(path)]
        for config in found:
            check_planners(config, asks=False)
            if type(config) is RunConfig and config.mission.n_robots <= 4 and (config.trial.rounds or 99) <= 3:
                expect_run(config)


@parts
@pytest.mark.parametrize("kind", [RunConfig, SwarmConfig, FlightConfig, SweepFile])
def test_a_configuration_is_taken_or_rejected(kind: Any, part: int, here: Path) -> None:
    """From a file of one's own, up to its dry run, and as stored by others."""
    sample = {"shape": "triangle", "n_robots": 3, "rounds": 2}
    if kind is FlightConfig:
        good = flight_config().model_dump(mode="json")
    elif kind is SweepFile:
        good = msgspec.toml.decode(small_file(here).read_bytes())
    else:
        good = kind.build(**sample).model_dump(mode="json")
    taken = 0
    for seed in seeds(kind.__name__, CASES // 4, part, PARTS):
        with drawn(seed) as rng:
            data = Hostile(rng).model(kind, good)
            path = Path("config.toml")
            path.write_bytes(damaged(toml(data).encode("utf-8", "surrogatepass"), rng))
            taken += tried(lambda path=path: dry_run(kind, path), InputError) is None
            if issubclass(kind, RunConfig):
                tried(lambda data=data: kind.stored(data), InputError)
    assert taken


# --- answers ----------------------------------------------------------------------------------------------------------

TRIANGLE = build_mission(shape="triangle", n_robots=3)
POINTS = [[50.0, 55.77], [45.0, 47.11], [55.0, 47.11]]
LABELS = {"plan": "Plan", "my_plan": "my plan", "position": "Position", "path": "Path", "reasoning": "Reasoning"}


def legal_answer(kind: Any, form: AnswerForm, rng: random.Random) -> str:
    """An answer by the schema that models are given, as JSON or as text, and some of it repeated thousands of times."""
    good = {"plan": POINTS, "my_plan": 2, "position": [1.0, 3.0], "path": [[1.0, 3.0], [2.0, 4.0]], "reasoning": "near"}
    schema = answer_schema(kind, form)
    values = Hostile(rng).schema(schema, {name: good[name] for name in schema["properties"]})
    text = json.dumps(values, ensure_ascii=rng.random() < 0.5)
    if not form.json:
        text = "\n".join(f"{LABELS[name]}: {json.dumps(value)}" for name, value in values.items())
    raw = text.encode("utf-8", "surrogatepass")
    text = damaged(raw, rng).decode("utf-8", "replace")
    if rng.random() < 0.3:
        thought = Hostile(rng).text()
        text = rng.choice(("<think>{}</think>{}", "```json\n{1}\n```", "{}{}", "[THINK]{}{}")).format(thought, text)
    if rng.random() < 0.02:
        at = rng.randrange(len(text) + 1)
        text = text[:at] + text[at : at + rng.choice((1, 2, 9, 60))] * rng.choice((1_000, 20_000)) + text[at:]
    return text


class Speaker:
    """A language model that gives hostile answers."""

    name = "hostile:one"

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.answers = 0

    async def ask(self, call: Call) -> Reply:
        assert call.form is not None
        self.answers += 1
        usage = Usage(input=self.rng.choice((0, 2**53)), output=1)
        return Reply(text=legal_answer(call.kind, call.form, self.rng), model=self.name, latency_s=0.1, usage=usage)


@parts
@pytest.mark.parametrize("as_json", [False, True])
def test_an_answer_is_used_or_rejected(as_json: bool, part: int) -> None:
    """By its readers, and by a planner that asks again and keeps the conversation: no pattern takes much time."""
    prompts = PromptSet.load(json=as_json)
    used = asked = 0
    for seed in seeds(f"answer{as_json}", CASES // 4, part, PARTS):
        with drawn(seed) as rng:
            model = Speaker(rng)
            planner = LanguagePlanner(0, model, prompts, history=rng.choice((0, 1)))
            question = PlanQuestion(mission=TRIANGLE, robot=0, round=1, position=(1.0, 2.0), neighbors=())
            step = StepQuestion(
                **{name: getattr(question, name) for name in ("mission", "robot", "round", "position", "neighbors")},
                plan=Plan.of(POINTS),
                slot=2,
                horizon=rng.choice((1, 3)),
            )
            for question_asked in (planner.plan(question), planner.step(step)):
                found = asyncio.run(question_asked)
                asked, used = asked + 1, used + (not isinstance(found, NoAnswer))
            form = AnswerForm(n=3, dim=2, horizon=step.horizon, json=not as_json)
            for read in (read_plan, read_waypoints):
                text = legal_answer(rng.choice(("plan", "step")), form, rng)
                tried(lambda read=read, text=text, form=form: read(text, form), AnswerError)
    assert 0.2 * asked < used
