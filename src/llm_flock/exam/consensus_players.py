"""Who plays the consensus game: our consensus rules, language models that discuss, stand-ins for them, and liars."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from llm_flock.errors import InputError, ModelError, unknown
from llm_flock.exam.consensus_game import HIGHEST, LOWEST, Hearing, Said
from llm_flock.llm.port import Call, ChatMessage, LanguageModel, Reply, Usage
from llm_flock.protocol.agreement.consensus import ConsensusRule, Standing
from llm_flock.protocol.messages.message import Message, Provenance
from llm_flock.protocol.plan import Plan

STAND_INS: Mapping[str, str] = {
    "majority": "takes the value that most agents hold, the lowest of several; stops when two thirds hold its own",
    "average": "takes the mean of all values, rounded; stops when all others hold its own",
    "stubborn": "keeps its value, and stops when all others hold it",
    "chance": "says any value, and stop half of the time",
}
"""Stand-ins for a language model in this game, and what they do. They read the same messages."""

GAMES_APART = 1000
"""Numbers of calls from one game to the next: a call in a recording is found by robot and round."""

SYSTEM = """\
You are agent {me} of {n}. The agents have to agree on one whole number from {low} to {high}. It must be a number \
that one of the agents began with; it does not matter which. In every round each agent hears the numbers of all \
others, and then says a number and whether to stop. The game ends when two thirds of the agents say stop in the same \
round, and is won if all honest agents hold the same number then. Some agents may be dishonest. Nobody knows which.

Answer with nothing but a JSON object: {{"value": your number, "stop": true or false}}"""

USER = """\
Round {round} of at most {rounds}.
You began with {began}. Your number: {own}
The others said: {heard}"""

_AGENT = re.compile(r"agent [0-9]+: (-?[0-9]+)")
_OWN = re.compile(r"Your number: (-?[0-9]+)")


class GameAnswer(BaseModel):
    """A model's answer in a round."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    value: int = Field(ge=LOWEST, le=HIGHEST)
    stop: bool


SCHEMA: Mapping[str, Any] = {
    "type": "object",
    "properties": {
        "value": {"type": "integer", "minimum": LOWEST, "maximum": HIGHEST},
        "stop": {"type": "boolean"},
    },
    "required": ["value", "stop"],
    "additionalProperties": False,
}
"""JSON schema of the answer."""


class Talker:
    """An honest agent whose language model is told what the others said, and answers with a value and a vote.

    Attributes:
        failed: calls to which no answer came.
    """

    def __init__(self, model: LanguageModel, game: int = 0) -> None:
        self.failed = 0
        self._model = model
        self._game = game

    def begins(self, me: int, n: int, value: int) -> Said:
        """Tells its value."""
        return Said(value=value)

    async def speaks(self, hearing: Hearing) -> Said:
        """Asks its model once. Without an answer that can be read it keeps its value, and does not vote to stop."""
        call = Call(
            robot=hearing.me,
            round=self._game * GAMES_APART + hearing.round,
            kind="step",
            attempt=0,
            messages=messages(hearing),
            schema=SCHEMA,
        )
        try:
            reply = await self._model.ask(call)
        except ModelError:
            self.failed += 1
            return Said(value=None)
        return read(reply.text)


def messages(hearing: Hearing) -> tuple[ChatMessage, ...]:
    """What a model is told in a round: the rules, its own number, and what all others said in the round before."""
    heard = ", ".join(f"agent {k}: {said.value}" for k, said in sorted(hearing.heard.items()))
    system = SYSTEM.format(me=hearing.me, n=hearing.n, low=LOWEST, high=HIGHEST)
    user = USER.format(round=hearing.round, rounds=hearing.rounds, began=hearing.began, own=hearing.own, heard=heard)
    return ChatMessage("system", system), ChatMessage("user", user)


def read(text: str) -> Said:
    """An answer as what an agent says; one that cannot be read has no value and no vote."""
    start, end = text.find("{"), text.rfind("}")
    try:
        answer = GameAnswer.model_validate_json(text[start : end + 1])
    except ValidationError:
        return Said(value=None)
    return Said(value=answer.value, stop=answer.stop)


class GameStandIn:
    """A simulated language model for this game: it reads the message, and answers by one of `STAND_INS`.

    Raises:
        InputError: for field `model`: there is no such stand-in.
    """

    simulated = True

    def __init__(self, profile: str, rng: np.random.Generator) -> None:
        if profile not in STAND_INS:
            raise InputError("model", f"simulated:{profile}", says=unknown("stand-in", profile, STAND_INS))
        self.name = f"simulated:{profile}"
        self._profile = profile
        self._rng = rng

    async def ask(self, call: Call) -> Reply:
        """Answer one round."""
        text = call.messages[-1].text
        heard, own = list(map(int, _AGENT.findall(text))), int(_OWN.findall(text)[0])
        value, stop = self._decide(own, heard)
        said = json.dumps({"value": value, "stop": stop})
        return Reply(text=said, model=self.name, usage=Usage(), cost_usd=0.0)

    def _decide(self, own: int, heard: list[int]) -> tuple[int, bool]:
        everyone = [own, *heard]
        match self._profile:
            case "majority":
                counts = Counter(everyone)
                most = max(counts.values())
                value = min(value for value, count in counts.items() if count == most)
                return value, 3 * counts[value] >= 2 * len(everyone)
            case "average":
                value = round(sum(everyone) / len(everyone))
                return value, set(everyone) == {value}
            case "stubborn":
                return own, set(heard) == {own}
            case _:
                return int(self._rng.integers(LOWEST, HIGHEST + 1)), bool(self._rng.integers(2))


@dataclass(slots=True)
class RulePlayer:
    """An honest agent that follows a consensus rule of the protocol. It asks no model.

    Its value is a plan of one place. It adopts what the rule chooses from the messages heard, and votes to stop after
    every round that changed nothing.
    """

    rule: ConsensusRule
    standing: Standing | None = None

    def begins(self, me: int, n: int, value: int) -> Said:
        """Proposes its value; everybody hears everybody, so all have the same influence."""
        origin = provenance(me, n - 1, 0)
        self.standing = Standing(plan=plan_of(value), provenance=origin, degree=n - 1)
        return Said(value=value, origin=origin)

    async def speaks(self, hearing: Hearing) -> Said:
        """Adopts by the rule."""
        assert self.standing is not None and self.standing.plan is not None, "the game has begun"
        heard = [message_of(k, said, hearing) for k, said in sorted(hearing.heard.items())]
        chosen = self.rule.choose(self.standing, heard)
        if chosen is not None:
            self.standing = Standing(plan=chosen.plan, provenance=chosen.provenance, degree=self.standing.degree)
        assert self.standing.plan is not None, "a message that is chosen has a plan"
        value = round(self.standing.plan.points[0][0])
        return Said(value=value, stop=chosen is None, origin=self.standing.provenance)


def message_of(sender: int, said: Said, hearing: Hearing) -> Message:
    """What an agent said as a message of the protocol."""
    assert said.value is not None and said.origin is not None, "all agents of this game name the origin of their values"
    # The influence of the sender itself; a liar claims as much for itself as for its proposal.
    degree = said.origin.degree if said.origin.proposer == sender else hearing.n - 1
    return Message(
        sender=sender, sequence=hearing.round, degree=degree, plan=plan_of(said.value), provenance=said.origin
    )


def plan_of(value: int) -> Plan:
    """A value as a plan of one place."""
    return Plan.of([[value]])


def provenance(proposer: int, degree: int, sequence: int) -> Provenance:
    """The origin of a value that an agent proposes."""
    return Provenance(mission=0, mission_digest="0" * 16, epoch=0, degree=degree, proposer=proposer, sequence=sequence)


@dataclass(slots=True)
class Liar:
    """Says another value by chance in every round, the same to all, as a new proposal, and never stop.

    Attributes:
        rng: chance.
        boasts: whether it claims more influence than anybody can have.
    """

    rng: np.random.Generator
    boasts: bool = False

    def begins(self, me: int, n: int, value: int) -> Said:
        """Says any value."""
        return self._said(me, n, 0)

    async def speaks(self, hearing: Hearing) -> Said:
        """Says any other value."""
        return self._said(hearing.me, hearing.n, hearing.round)

    def _said(self, me: int, n: int, sequence: int) -> Said:
        origin = provenance(me, n - 1 + n * self.boasts, sequence)
        return Said(value=int(self.rng.integers(LOWEST, HIGHEST + 1)), origin=origin)
