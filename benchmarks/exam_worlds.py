"""Flies the test worlds of judgements, and writes the exam's questions about them.

    python -m benchmarks.exam_worlds [--worlds 60] [--kinds death,battery] [--each N] [--first 0] > judgement.jsonl
    python -m benchmarks.exam_worlds --worlds 52 --kinds blocked --each 4 --first 23 >> judgement.jsonl
    python -m benchmarks.exam_worlds --worlds 24 --kinds order --each 2 --first 33 >> judgement.jsonl

In each world every option is flown from the same seed. A question is kept if exactly one option is the best as flown,
and the same one by the figures in the question: it can be answered, and code knows that the answer is right. Half of
the wishes are the program's own; the others say the same in other words, where the first thing that counts decides.
`--each N` keeps at most N questions of a kind that share a right answer, as waiting is right after most blocked ways.
"""

from __future__ import annotations

import argparse
import json
import re
from collections import Counter
from typing import Any

from benchmarks.judgement import Fixed, World, fly, world_of

from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.llm._simulated.prompt_reader import JUDGEMENT_MARK
from llm_flock.planner import AIMS, JudgementOption, best_option
from llm_flock.runtime import Stream, stream

OPTION = re.compile(
    r"^- ([a-z]+): (.*) Rounds: (\d+); flying: ([\d.]+) units; empty places: (\d+); robots lost: (\d+)\.$", re.MULTILINE
)
WISHES = {
    "gaps": (
        "the picture in the sky must be whole, however long that takes and whatever it costs.",
        "a hole in the formation is what the judges of the contest will not forgive; they have all day.",
        "nobody may see a place where a robot is missing. Never mind time and energy.",
    ),
    "rounds": (
        "we are in a hurry: the photographer leaves in a moment, and a hole would not disturb him.",
        "speed is everything today. It need not be pretty, nor cheap.",
        "the sooner the team is at rest again, the better; all else is a matter of taste.",
    ),
    "distance": (
        "spare the motors: every unit that nobody has to fly is a gift, even if it looks worse.",
        "energy is scarce this week, so move as little as you can. Time and looks do not matter.",
        "the less is flown in all, the happier I am.",
    ),
}


SAYS = {"death": "has failed", "battery": "battery", "blocked": "An obstacle", "order": "an order in words"}
"""What a question about each kind of event says."""


class Heard:
    """A good *simulated* model that keeps the first judgement that it is asked for, with the robot."""

    simulated = True
    asked: dict[str, Any] = {}  # noqa: RUF012 -- one for all robots of a run

    def __init__(self, seed: int, robot: int) -> None:
        self._good = SimulatedModel(parse_profile("ideal"), stream(seed, Stream.MODEL, robot))

    async def ask(self, call: Any) -> Any:
        text = call.messages[-1].text
        if JUDGEMENT_MARK in text and not self.asked:
            event = text.partition(JUDGEMENT_MARK)[2].partition("\n")[0].strip()
            self.asked.update(robot=call.robot, event=event, options=OPTION.findall(text))
        return await self._good.ask(call)


def question_of(world: World, kind: str, seed: int) -> dict[str, Any] | None:
    """The question about a world, without an id; None where it has no answer that is clearly right."""
    Heard.asked.clear()
    n, aim = int(world.mission["n_robots"]), world.counts
    if aim not in AIMS:
        return None
    fly(world, [Heard(seed, robot) for robot in range(n)])
    names = ("choice", "does", "rounds", "distance", "gaps", "lost")
    kinds = (str, str, int, float, int, int)
    found = Heard.asked.get("options", [])
    rows: list[dict[str, Any]] = [
        {name: of(cell) for name, of, cell in zip(names, kinds, row, strict=True)} for row in found
    ]
    options = [JudgementOption(**row) for row in rows]
    if len(options) < 2 or SAYS[kind] not in Heard.asked["event"]:
        return None
    flown: dict[str, tuple[float, ...]] = {}
    for one in options:
        done = fly(world, [Fixed(one.choice, seed, robot) for robot in range(n)])
        flown[one.choice] = (done.lost, *(round(float(getattr(done, name))) for name in AIMS[aim]))
    best = [choice for choice, worth in flown.items() if worth == min(flown.values())]
    if best != [best_option(options, aim)]:
        return None
    wish, tags = aim, [kind, "figures"]
    if seed % 2:
        first = AIMS[aim][0]
        safe = [option for option in options if option.lost == min(one.lost for one in options)]
        if sum(getattr(option, first) == min(getattr(one, first) for one in safe) for option in safe) > 1:
            return None
        wish, tags = WISHES[first][seed // 2 % len(WISHES[first])], [kind, "wish"]
    question = {
        "section": "judgement",
        "n": n,
        "tags": tags,
        "mission": world.mission,
        "robots": [Heard.asked["robot"]],
    }
    question |= {"event": Heard.asked["event"], "options": rows, "wish": wish, "wanted": [{"choice": best[0]}]}
    return question


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=60)
    parser.add_argument("--kinds", default="death,battery")
    parser.add_argument("--each", type=int)
    parser.add_argument("--first", type=int, default=0, help="number of the first question")
    given = parser.parse_args()
    number, right = given.first, Counter[tuple[str, str]]()
    for seed in range(given.worlds):
        for kind in given.kinds.split(","):
            question = question_of(world_of(kind, seed), kind, seed)
            answer = kind, "" if question is None else question["wanted"][0]["choice"]
            if question is not None and (given.each is None or right[answer] < given.each):
                print(json.dumps({"id": f"judgement-{number:04d}", **question}, separators=(",", ":")), flush=True)
                number += 1
                right[answer] += 1


if __name__ == "__main__":
    main()
