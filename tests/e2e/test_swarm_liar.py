"""A member with its own keys, a process's worth of lies: it holds one place at most, and the honest form without it.

What it signed shows to anybody who has the record and the public keys that it lied.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from pathlib import Path

from swarms import formed, swarm_config
from tables import told
from typer.testing import CliRunner

from llm_flock.arrays import Point
from llm_flock.cli import app
from llm_flock.errors import MessageError
from llm_flock.members import WORLD
from llm_flock.message import UNSAID, Message, Provenance, decode, encode
from llm_flock.plan import Plan
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.connection import load_keys, open_link
from llm_flock_swarm._network.swarm import SwarmResult, launch_swarm
from llm_flock_swarm._network.wire import Beacon, BeaconedMessage, WorldState, pack, unpack
from llm_flock_swarm._signed.certificates import (
    Certificate,
    Context,
    Proofs,
    claim_statement,
    claims_of,
    origin_statement,
    unwrap,
    wrap,
)
from llm_flock_swarm._trust.keys import make_keys

N, LIAR = 5, 4
LIES_S = 6.0


class Liar:
    """Hears all, and answers with lies that bear its own, true signature."""

    def __init__(self, config: SwarmConfig) -> None:
        keys = load_keys(config, LIAR)
        assert keys is not None
        self.keys = keys
        self.link = open_link(config, LIAR, listen="tcp/127.0.0.1:0")
        self.heard: Message | None = None
        self.payload = b""
        self.here: Point | None = None
        self.tables: dict[int, tuple[str | None, dict[int, int]]] = {}
        self.counts = itertools.count(1)
        self.link.listen("say", None, self._hear)
        self.link.listen("frame", None, self._see)

    @property
    def held(self) -> int:
        """Most places that are its own by what any honest robot has said last of each."""
        return max(sum(owner == LIAR for owner in owners.values()) for _, owners in self.tables.values())

    def _hear(self, sender: int, payload: bytes) -> None:
        try:
            payload = unpack(BeaconedMessage, payload).message
            message = decode(unwrap(payload, N)[0], N, 2)
        except MessageError:
            return
        if message.plan is not None and message.provenance is not None:
            self.heard, self.payload = message, payload
        if self.tables.get(sender, ("", {}))[0] != message.plan_digest:
            self.tables[sender] = message.plan_digest, {}
        said = ((slot, entry) for slot, entry in enumerate(message.table or ()) if entry != UNSAID)
        self.tables[sender][1].update((slot, entry[2]) for slot, entry in said)

    def _see(self, sender: int, payload: bytes) -> None:
        if sender == WORLD:
            self.here = unpack(WorldState, payload).bodies[LIAR].position

    def lies(self) -> list[bytes]:
        """Claims on all places, for itself or another, at any version; a hallucinated plan; another's message."""
        known = self.heard
        if known is None or known.plan is None or known.provenance is None:
            return []
        count = next(self.counts)
        about = Context(known.mission, known.plan.digest, known.provenance)
        version, owner = ((0, LIAR), (1, LIAR), (2**39, LIAR), (1, 0))[count % 4]
        entry = (version, -1e-9, owner)
        claims = {
            slot: Certificate(number=count, signature=self.keys.sign(claim_statement(about, slot, entry, count)))
            for slot in range(N)
        }
        said = [self._message(known, certificates=claims, slot=count % N, **told((entry,) * N), beats=(2**39,) * N)]
        everywhere = Plan.of([(50.0, 50.0)] * N)
        best = Provenance(
            mission=known.mission.counter,
            mission_digest=known.mission.digest,
            epoch=0,
            degree=N - 1,
            proposer=LIAR,
            sequence=0,
        )
        said.append(self._message(known, plan=everywhere, provenance=best, **told((UNSAID,) * N), slot=0))
        return [*said, self.payload]

    def _message(
        self, known: Message, *, certificates: dict[int, Certificate] | None = None, **fields: object
    ) -> bytes:
        same = {"plan": known.plan, "provenance": known.provenance}
        whole: dict[str, object] = {**same, **fields}
        message = Message(sender=LIAR, sequence=next(self.counts), degree=N - 1, **whole)  # type: ignore[arg-type]
        assert message.provenance is not None and message.plan is not None
        own = self.keys.sign(origin_statement(message.provenance, message.plan.digest))
        numbers, grants = claims_of(certificates or {})
        return wrap(encode(message), Proofs(claims=numbers, grants=grants, origin=own))

    def speak(self) -> None:
        """Tell the true position of the body, and false ones."""
        if self.here is None:
            return
        beacon = Beacon(stamp=time.time(), position=self.here)
        self.link.publish("beacon", LIAR, pack(beacon))
        for lie in self.lies():
            self.link.publish("say", LIAR, pack(BeaconedMessage(beacon=beacon, message=lie)))


async def fly(config: SwarmConfig) -> tuple[str, SwarmResult, Liar]:
    async with launch_swarm(config, absent=frozenset({LIAR})) as swarm:
        liar = Liar(swarm.config)

        async def lie() -> None:
            end = time.monotonic() + LIES_S
            while time.monotonic() < end:
                liar.speak()
                await asyncio.sleep(0.05)

        task = asyncio.create_task(lie())
        try:
            stopped = await swarm.run(lambda observer: task.done() and formed(observer))
            return stopped, swarm.result(stopped), liar
        finally:
            task.cancel()
            liar.link.close()


def test_lying_member_holds_one_place_and_hurts_no_other(tmp_path: Path) -> None:
    make_keys(tmp_path / "team", N)
    config = swarm_config(N, seed=3, keys=str(tmp_path / "team"), gather_s=1.0, out=str(tmp_path / "run"))
    stopped, result, liar = asyncio.run(fly(config))
    assert stopped == "formed"
    # What it claimed before its last claim counts no more, and is freed as soon as two honest robots say so.
    assert len(liar.tables) == N - 1 and liar.held <= 1
    refused = result.messages_rejected
    assert {"uncertified", "unverified_plan", "impostor"} <= refused.keys(), refused
    assert result.min_separation is not None and result.min_separation >= config.mission.safe_distance - 1e-6
    assert list(result.shown_to_lie) == [LIAR]
    # A third party has the record and the public keys, and nothing else.
    third = tmp_path / "third"
    third.mkdir()
    (third / "team.json").write_bytes((tmp_path / "team" / "team.json").read_bytes())
    shown = CliRunner().invoke(app, ["inspect", str(tmp_path / "run"), "--keys", str(third)])
    assert shown.exit_code == 0
    lines = [line for line in shown.stdout.splitlines() if "accuses" in line]
    assert len(lines) == 1 and f"accuses robot {LIAR} of lying: proven, it signed this message" in lines[0]
