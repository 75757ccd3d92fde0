"""The consensus game: how it ends, what rules, models and liars do in it, and what the benchmark prints."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from benchmarks import agreement

from llm_flock.errors import InputError, ModelError
from llm_flock.exam.consensus_game import Deal, GameResult, Hearing, Player, Said, deal, judge, play
from llm_flock.exam.consensus_players import STAND_INS, GameStandIn, Liar, RulePlayer, Talker, messages, read
from llm_flock.llm.port import Call, Reply
from llm_flock.protocol.agreement.consensus import InfluenceConsensus, NoConsensus, ProvenanceConsensus

FOUR = Deal(values=(7, 3, 9, 3), liars=frozenset())


class Fixed:
    """Says the same in every round."""

    def __init__(self, value: int | None, *, stop: bool) -> None:
        self.said = Said(value=value, stop=stop)
        self.heard: list[Hearing] = []

    def begins(self, me: int, n: int, value: int) -> Said:
        return Said(value=value)

    async def speaks(self, hearing: Hearing) -> Said:
        self.heard.append(hearing)
        return self.said


def played(players: Sequence[Player], dealt: Deal = FOUR, rounds: int = 5) -> GameResult:
    return asyncio.run(play(players, dealt, rounds))


def games(
    player: Callable[[int], Player], agents: int, liars: int, count: int = 60, *, boasts: bool = False
) -> Counter[str]:
    found: Counter[str] = Counter()
    for game in range(count):
        dealt = deal(agents, liars, seed=0, game=game)
        players = agreement.seated(dealt, player, seed=0, game=game, boasts=boasts)
        found[asyncio.run(play(players, dealt, 20)).outcome] += 1
    return found


@pytest.mark.parametrize(
    ("values", "outcome"),
    [((3, 3, 3, 3), "valid"), ((4, 4, 4, 4), "invalid"), ((3, 3, 3, 9), "split")],
)
def test_a_game_that_is_stopped_is_judged_by_its_values(values: Sequence[int], outcome: str) -> None:
    result = played([Fixed(value, stop=True) for value in values])
    assert (result.outcome, result.rounds, result.values) == (outcome, 1, tuple(values))


def test_two_thirds_of_all_agents_stop_a_game() -> None:
    three = [Fixed(3, stop=k < 3) for k in range(4)]
    assert played(three).outcome == "valid"
    assert played([Fixed(3, stop=k < 2) for k in range(4)]).outcome == "timeout"
    assert (
        len(three[0].heard) == 1
        and played([Fixed(3, stop=k < 2) for k in range(3)], deal(3, 0, seed=0, game=0)).rounds == 1
    )


def test_liars_vote_but_their_values_do_not_count() -> None:
    dealt = Deal(values=(7, 3, 9, 3), liars=frozenset({2}))
    players = [Fixed(3, stop=True), Fixed(3, stop=True), Fixed(9, stop=True), Fixed(3, stop=False)]
    assert played(players, dealt).outcome == "valid"
    assert judge([9, 9], [9, 1]) == "valid" and judge([9, 9], [3, 1]) == "invalid"
    outside = [Fixed(9, stop=True), Fixed(9, stop=True), Fixed(9, stop=True), Fixed(9, stop=True)]
    assert played(outside, dealt).outcome == "invalid", "nobody honest began with 9"


def test_an_answer_that_cannot_be_read_keeps_the_value() -> None:
    result = played([Fixed(None, stop=False), *(Fixed(7, stop=True) for _ in range(3))])
    assert (result.outcome, result.unread, result.values) == ("valid", 1, (7, 7, 7, 7))


def test_everybody_hears_what_all_others_said_last() -> None:
    one = Fixed(5, stop=False)
    played([one, Fixed(6, stop=False), Fixed(8, stop=True)], deal(3, 0, seed=1, game=0), rounds=2)
    first, second = one.heard
    values = deal(3, 0, seed=1, game=0).values
    assert {k: said.value for k, said in first.heard.items()} == {1: values[1], 2: values[2]}
    assert {k: said.value for k, said in second.heard.items()} == {1: 6, 2: 8}
    assert (first.own, second.own, second.began) == (first.began, 5, first.began) and second.n == 3


def test_deals_repeat_and_are_checked() -> None:
    assert deal(8, 2, seed=3, game=4) == deal(8, 2, seed=3, game=4) != deal(8, 2, seed=3, game=5)
    assert len(deal(8, 2, seed=3, game=4).liars) == 2
    for agents, liars, field in ((1, 0, "agents"), (4, 2, "liars"), (4, -1, "liars")):
        with pytest.raises(InputError, match=field):
            deal(agents, liars, seed=0, game=0)


def test_our_rule_agrees_in_two_rounds_and_the_literal_one_never() -> None:
    assert games(lambda _: RulePlayer(ProvenanceConsensus()), 8, 0) == {"valid": 60}
    dealt = deal(8, 0, seed=0, game=0)
    result = played([RulePlayer(ProvenanceConsensus()) for _ in range(8)], dealt)
    assert result.rounds == 2 and set(result.values) == {dealt.values[7]}, "the highest id decides among equals"
    assert games(lambda _: RulePlayer(InfluenceConsensus()), 8, 0) == {"split": 60}, "nobody has more influence"
    assert games(lambda _: RulePlayer(NoConsensus()), 8, 0) == {"split": 60}


def test_a_liar_stops_our_rule_where_it_comes_first_in_the_order() -> None:
    for game in range(30):
        dealt = deal(4, 1, seed=0, game=game)
        players = agreement.seated(dealt, lambda _: RulePlayer(ProvenanceConsensus()), seed=0, game=game)
        outcome = asyncio.run(play(players, dealt, 20)).outcome
        assert outcome == ("timeout" if 3 in dealt.liars else "valid")
    boasting = games(lambda _: RulePlayer(ProvenanceConsensus()), 8, 1, boasts=True)
    assert boasting["valid"] == 0, "without keys, nobody can check what a robot says of its influence"


HEARING = Hearing(
    round=2, rounds=9, me=1, began=4, own=6, heard={0: Said(value=6), 2: Said(value=41), 3: Said(value=6, stop=True)}
)


def test_a_model_is_told_the_rules_and_what_the_others_said() -> None:
    system, user = messages(HEARING)
    assert "You are agent 1 of 4" in system.text and "from 0 to 50" in system.text
    assert user.text.splitlines() == [
        "Round 2 of at most 9.",
        "You began with 4. Your number: 6",
        "The others said: agent 0: 6, agent 2: 41, agent 3: 6",
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"value": 6, "stop": true}', Said(value=6, stop=True)),
        ('I would say: {"value": 0, "stop": false}.', Said(value=0)),
        ('{"value": 51, "stop": true}', Said(value=None)),
        ('{"value": 6.5, "stop": true}', Said(value=None)),
        ('{"value": 6}', Said(value=None)),
        ("6, stop", Said(value=None)),
    ],
)
def test_answers_are_read_strictly(text: str, said: Said) -> None:
    assert read(text) == said


def stood_in(profile: str, hearing: Hearing = HEARING) -> Said:
    return asyncio.run(Talker(GameStandIn(profile, np.random.default_rng(0))).speaks(hearing))


def test_stand_ins_do_what_their_names_say() -> None:
    assert stood_in("majority") == Said(value=6, stop=True)
    assert stood_in("average") == Said(value=15)
    assert stood_in("stubborn") == Said(value=6)
    assert set(STAND_INS) == {"majority", "average", "stubborn", "chance"}
    with pytest.raises(InputError, match="did you mean 'majority'"):
        GameStandIn("majorty", np.random.default_rng(0))


def test_stand_ins_end_games_as_differently_as_they_are() -> None:
    def talker(profile: str) -> Callable[[int], Player]:
        return lambda k: Talker(GameStandIn(profile, np.random.default_rng(k)))

    assert games(talker("majority"), 8, 0) == {"valid": 60}
    assert 0 < games(talker("majority"), 8, 2)["invalid"] < 30, "a liar may have the lowest number"
    assert games(talker("average"), 8, 0)["invalid"] > 40, "a mean is seldom a number that somebody began with"
    assert games(talker("stubborn"), 4, 0) == {"timeout": 60}
    assert games(talker("chance"), 8, 0) == {"split": 60}


def test_a_failed_call_is_no_answer() -> None:
    class Down:
        name = "down"

        async def ask(self, call: Call) -> Reply:
            raise ModelError("server", "down")

    talker = Talker(Down())
    assert asyncio.run(talker.speaks(HEARING)) == Said(value=None) and talker.failed == 1


def test_liars_say_the_same_to_all_and_never_stop() -> None:
    said = [asyncio.run(Liar(np.random.default_rng(k)).speaks(HEARING)) for k in range(20)]
    assert len({one.value for one in said}) > 5 and not any(one.stop for one in said)
    boasting, modest = (Liar(np.random.default_rng(0), boasts).begins(1, 4, 0).origin for boasts in (True, False))
    assert boasting is not None and modest is not None and boasting.degree > modest.degree == 3


def test_the_benchmark_prints_one_table(capsys: pytest.CaptureFixture[str]) -> None:
    agreement.main(["simulated:majority", "--games", "3", "--agents", "4", "--liars", "0,1,2", "--rounds", "4"])
    rows = capsys.readouterr().out.splitlines()[2:]
    assert [row.split(" | ")[:4] for row in rows if "simulated" in row] == [
        ["| discussion, `simulated:majority` *simulated*", "4", "0", "3"],
        ["| discussion, `simulated:majority` *simulated*", "4", "1", "3"],
    ], "two liars among four are too many"
    assert "| our rule, `provenance` | 4 | 0 | 3 | 3 of 3 [44, 100] | 0 | 0 | 0 | 2 | 0 | - |" in rows


def test_a_game_that_the_budget_cut_off_is_not_counted(capsys: pytest.CaptureFixture[str]) -> None:
    agreement.main(
        [
            "exam_models:Keeper",
            "--games",
            "3",
            "--agents",
            "4",
            "--liars",
            "0",
            "--only-models",
            "--max-calls",
            "6",
        ]
    )
    (row,) = capsys.readouterr().out.splitlines()[2:]
    assert row.split(" | ")[3:6] == ["1", "0 of 1 [0, 79]", "0"], row


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("simulated:ideal", "unknown stand-in; expected one of majority"),
        ("geometry", "a language model"),
        ("--agents four", "whole numbers"),
        ("--games 0", "at least 1"),
        ("--liars -1", "whole numbers"),
        ("--rounds 0", "at least 1"),
    ],
)
def test_wrong_input_is_refused(line: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        agreement.main([*line.split(), "--only-models"])
    assert caught.value.code == 2 and text in capsys.readouterr().err
