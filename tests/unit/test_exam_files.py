"""Files of the exam that are broken, shared, cut off or somebody else's: refused in one line, and left as they are."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from command_line import flock
from exam_models import Key

from llm_flock.errors import FlockError, InputError, RecordError
from llm_flock.exam.examinee import Setup
from llm_flock.exam.leaderboard import PAGE, check_page, page_text, publish, read_rows, write_page
from llm_flock.exam.session import Finished, Paper, hold_exam
from llm_flock.exam.splits import public_split
from llm_flock.llm.own import OwnModel
from llm_flock.llm.port import Call, Reply, Usage

DAY = date(2026, 1, 2)
MODEL, PAPER = "simulated:ideal", Paper(sections="plan,step", limit=2)


def hold(folder: Path, model: str = MODEL, *, paper: Paper = PAPER, own: Any = None, **fields: Any) -> Finished:
    setup = Setup(model=model if own is None else "exam_models:Own", **fields)
    return asyncio.run(hold_exam(setup, paper, folder, own=None if own is None else OwnModel(own), today=DAY))


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("good")
    assert hold(folder).complete
    return (folder / "simulated-ideal.jsonl").read_text(encoding="utf-8")


DAMAGES: dict[str, Callable[[str], str]] = {
    "no JSON": lambda text: text.replace('"calls":1', '"calls":', 1),
    "null": lambda text: text + "null\n",
    "list": lambda text: text + "[1]\n",
    "empty": lambda text: text + "{}\n",
    "deep": lambda text: text + "[" * 100_000 + "\n",
    "calls": lambda text: text.replace('"calls":1', '"calls":"x"', 1),
    "below 0": lambda text: text.replace('"calls":1', '"calls":-1', 1),
    "NaN": lambda text: re.sub(r'"seconds":[0-9.e-]+', '"seconds":NaN', text, count=1),
    "seconds": lambda text: re.sub(r'"seconds":[0-9.e-]+', '"seconds":"a"', text, count=1),
    "tries": lambda text: text.replace('"tries":0', '"tries":0.5', 1),
    "n": lambda text: re.sub(r'"n":\d+', '"n":null', text, count=1),
    "tags": lambda text: re.sub(r'"tags":\[[^]]*\]', '"tags":5', text, count=1),
    "readable": lambda text: text.replace('"readable":true', '"readable":"yes"', 1),
    "cost": lambda text: text.replace('"cost_usd":0.0', '"cost_usd":"free"', 1),
    "endless cost": lambda text: text.replace('"cost_usd":0.0', '"cost_usd":1.7e308', 1),
    "endless places": lambda text: re.sub(r'"n":\d+', f'"n":{2**62}', text, count=1),
    "question": lambda text: re.sub(r'"question":"[^"]*"', '"question":[1]', text, count=1),
    "unknown question": lambda text: text.replace("plan-0000", "plan-9999", 1),
    "other section": lambda text: text.replace('"section":"plan"', '"section":"nope"', 1),
    "other repeat": lambda text: text.replace('"repeat":0', '"repeat":7', 1),
    "header null": lambda text: "null\n" + text,
    "header setup": lambda text: re.sub(r'"setup":{[^}]*}', '"setup":5', text, count=1),
    "header count": lambda text: re.sub(r'"count":\d+', '"count":"x"', text, count=1),
    "half characters": lambda text: text.replace("plane", "pla\udcffe", 1),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_result_file_is_refused_and_left_alone(
    damage: Callable[[str], str], good: str, tmp_path: Path
) -> None:
    path = tmp_path / "simulated-ideal.jsonl"
    broken = damage(good).encode("utf-8", "surrogateescape")
    assert broken != good.encode()
    path.write_bytes(broken)
    with pytest.raises(RecordError, match=r"simulated-ideal\.jsonl(, line \d+)?: (damaged|not a result file)") as said:
        hold(tmp_path)
    assert "\n" not in str(said.value) and path.read_bytes() == broken


@pytest.mark.parametrize("size", [0, 1, 10, 50])
def test_an_exam_that_was_killed_at_once_begins_again(size: int, good: str, tmp_path: Path) -> None:
    path = tmp_path / "simulated-ideal.jsonl"
    path.write_text(good[:size], encoding="utf-8")
    assert hold(tmp_path).complete
    again = path.read_text(encoding="utf-8")
    assert again.count("\n") == good.count("\n") and again.splitlines()[0] == good.splitlines()[0]


def test_a_file_of_somebody_else_is_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "simulated-ideal.jsonl"
    path.write_text("buy milk", encoding="utf-8")
    with pytest.raises(RecordError, match="not a result file"):
        hold(tmp_path)
    assert path.read_text(encoding="utf-8") == "buy milk"


def test_two_exams_do_not_write_one_file(tmp_path: Path) -> None:
    class Meanwhile(Key):
        said: str | None = None

        async def ask(self, call: Call) -> str:
            if self.said is None:
                self.said = ""
                with pytest.raises(InputError, match="another exam writes this file now") as refused:
                    await hold_exam(
                        Setup(model="exam_models:Own"), PAPER, tmp_path, own=OwnModel(Key(public_split())), today=DAY
                    )
                self.said = str(refused.value)
            return await super().ask(call)

    model = Meanwhile(public_split())
    assert hold(tmp_path, own=model).complete and model.said
    lines = (tmp_path / "exam-models-Own.jsonl").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 5 and len(list(tmp_path.glob("*.part-*"))) == 1


def killed(folder: Path, cut: Callable[[Path], object]) -> Finished:
    """An exam that was killed: `cut` does to its recording what the kill did."""
    hold(folder, own=Key(public_split()), max_calls=2)
    (part,) = folder.glob("*.part-*.jsonl")
    cut(part)
    return hold(folder, own=Key(public_split()))


@pytest.mark.parametrize("lost", [1, 40])
def test_a_recording_that_was_cut_off_is_joined_with_the_rest(lost: int, tmp_path: Path) -> None:
    def cut(part: Path) -> None:
        with part.open("a", encoding="ascii") as file:
            file.write('{"robot":0,"round":5,"attempt":0,"kind":"st'[:-lost])

    finished = killed(tmp_path, cut)
    assert finished.complete and finished.recording is not None
    again = hold(tmp_path / "again", f"replay:{finished.recording}")
    assert [o.tries for o in again.outcomes] == [0] * 4


def test_a_session_that_was_killed_before_its_first_line_is_none(tmp_path: Path) -> None:
    hold(tmp_path, own=Key(public_split()), max_calls=2)
    (tmp_path / "exam-models-Own.part-007.jsonl").write_bytes(b"")
    finished = hold(tmp_path, own=Key(public_split()))
    assert finished.complete and (tmp_path / "exam-models-Own.part-008.jsonl").exists()


def test_results_without_their_recording_are_told_before_anything_is_asked(tmp_path: Path) -> None:
    asked = 0

    class Counting(Key):
        async def ask(self, call: Call) -> str:
            nonlocal asked
            asked += 1
            return await super().ask(call)

    hold(tmp_path, own=Counting(public_split()), max_calls=2)
    next(tmp_path.glob("*.part-*.jsonl")).unlink()
    asked = 0
    with pytest.raises(RecordError, match=r"2 results have no recording \(plan-\d+, .*put the missing part back"):
        hold(tmp_path, own=Counting(public_split()))
    assert asked == 0


@pytest.mark.parametrize("content", ["hello\n", "null\n", '{"llm_flock_cassette": 9}\n', "\xff\n"])
def test_a_recording_that_is_none_is_named(content: str, tmp_path: Path) -> None:
    part = tmp_path / "exam-models-Own.part-001.jsonl"
    part.write_text(content, encoding="latin-1")
    with pytest.raises(RecordError, match=r"part-001\.jsonl: "):
        hold(tmp_path, own=Key(public_split()))
    assert part.read_text(encoding="latin-1") == content


def test_a_budget_counts_calls_of_questions_that_were_cut_off(tmp_path: Path) -> None:
    class Wrong:
        calls = 0

        async def ask(self, call: Call) -> str:
            self.calls += 1
            return "no idea"

    model, paper = Wrong(), Paper(sections="step", limit=4)
    for _ in range(5):  # each question takes three calls
        hold(tmp_path, own=model, paper=paper, max_calls=5, max_concurrent=1)
    assert model.calls == 5


ANSWERS: tuple[Any, ...] = (
    "", "\0" * 1000, "[" * 50_000, "9" * 100_000, "Plan: " + "[1e999, 1]," * 2000, "\ud800", "Position: [NaN, 1]",
    '{"shape": "circle", "n_robots": 99999999999999999999999}', '{"shape": "points:/etc/passwd", "n_robots": 3}',
    '{"shape": "text:x", "n_robots": 1e308, "center": [1e308, -1e308]}', None, 5, b"bytes", ["Position: [1, 2]"],
    Reply(text="x", model="m", usage=Usage(input=-1)), Reply(text="x", model="m", cost_usd=float("nan")),
    Reply(text="x" * 300_000, model="|`\n", usage=Usage(input=2**52)),
)  # fmt: skip


def test_answers_without_sense_are_wrong_answers(tmp_path: Path) -> None:
    class Odd:
        def __init__(self) -> None:
            self.calls = 0

        async def ask(self, call: Call) -> Any:
            self.calls += 1
            return ANSWERS[self.calls % len(ANSWERS)]

    finished = hold(tmp_path, own=Odd(), paper=Paper(limit=4), max_tries=1)
    assert {o.tries for o in finished.outcomes} == {None}
    assert all(o.reason and len(o.reason) <= 300 for o in finished.outcomes)
    assert sum(o.cause == "garbage" for o in finished.outcomes) > 3


@pytest.fixture(scope="module")
def row(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    finished = hold(tmp_path_factory.mktemp("row"), paper=Paper(limit=2))
    assert finished.row is not None
    return finished.row


@pytest.mark.parametrize("without", ["model", "simulated", "figures", "exam", "command", "date", "recording"])
def test_a_row_that_lacks_a_field_is_named(without: str, row: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "broken.json"
    path.write_text(json.dumps({k: v for k, v in row.items() if k != without}), encoding="utf-8")
    with pytest.raises(InputError, match=rf"broken\.json.*a row of the leaderboard \('{without}' is missing\)"):
        read_rows(tmp_path)


def test_a_page_and_a_row_of_somebody_else_are_left_alone(row: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a folder that is there"):
        write_page(tmp_path / "none")
    page = tmp_path / PAGE
    page.write_text("# My notes\n", encoding="utf-8")
    for tried in (lambda: write_page(tmp_path), lambda: publish(tmp_path, row, None)):
        with pytest.raises(InputError, match="not written by this command"):
            tried()
    assert [path.name for path in tmp_path.iterdir()] == [PAGE] and page.read_text() == "# My notes\n"
    page.unlink()
    publish(tmp_path, row, None)
    publish(tmp_path, row, None)  # the same exam again
    with pytest.raises(InputError, match="row of simulated:ideal, whose name is the same"):
        check_page(tmp_path, "simulated:ideal!", "public", None, 1000)
    fewer = {**row, "exam": {**row["exam"], "count": 1}}
    with pytest.raises(InputError, match="a row of 16 questions; one of 1 goes into another folder"):
        publish(tmp_path, fewer, None)
    assert read_rows(tmp_path) == [row]
    flown = dict.fromkeys(("team", "formed", "trials", "by_models", "broken", "violations"), 0)
    flown |= dict.fromkeys(("fallback", "ratio", "calls", "cost_per_formed", "own_waypoints"))
    publish(tmp_path, {**row, "missions": [flown]}, None)
    with pytest.raises(InputError, match="has whole missions; add --missions"):
        publish(tmp_path, row, None)
    assert read_rows(tmp_path) == [{**row, "missions": [flown]}]
    with pytest.raises(InputError, match="a folder"):
        check_page(page, MODEL, "public", None, 16)


def test_no_name_of_a_model_breaks_the_table(row: dict[str, Any]) -> None:
    text = page_text([{**row, "answered_by": "a|b\n| c |", "simulated": False}])
    columns = {len(re.findall(r"(?<!\\)\|", line)) for line in text.splitlines() if "a&#124;b" in line}
    header = next(line for line in text.splitlines() if "Answered by" in line)
    assert columns == {header.count("|")}


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("exam simulated:ideal simulated:ideal", "simulated:ideal: is named twice"),
        ("exam simulated:ideal --out notes.txt", "--out notes.txt"),
        (
            "exam openai-compatible:a/b openai-compatible:a-b --base-url http://127.0.0.1:1",
            "openai-compatible:a-b: its results have the file name of those of openai-compatible:a/b",
        ),
        ("exam simulated:ideal simulated:nope", "unknown profile 'nope'"),
        ("exam simulated:ideal --page notes.txt", "--page notes.txt: expected a folder"),
        ("exam --page none", "--page none: expected a folder that is there"),
        ("exam --export notes.txt", "--export notes.txt: expected a file that is not there yet"),
        ("exam --export none/questions.jsonl", "--export none/questions.jsonl: expected a file in a folder"),
        ("exam", "MODEL: expected at least one model"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_is_asked(line: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    done = flock(*line.split(), cwd=tmp_path, check=False)
    assert done.returncode == 2 and text in done.stderr, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    assert (tmp_path / "notes.txt").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    "paper", [Paper(repeats=0), Paper(repeats=10**9), Paper(limit=0), Paper(split="private", seed=-1)]
)
def test_a_paper_without_bounds_is_refused(paper: Paper) -> None:
    with pytest.raises(FlockError, match=r"repeats|limit|seed"):
        paper.questions()
