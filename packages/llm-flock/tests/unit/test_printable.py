"""What is written out before text is shown: all that draws nothing, by the properties of Unicode."""

from __future__ import annotations

import pytest

from llm_flock.errors import InputError
from llm_flock.mission import build_mission
from llm_flock.printable import csv_cell, hidden, printable

UNSEEN = r"[\p{Cc}\p{Cf}\p{Cs}\p{Co}\p{Zl}\p{Zp}\p{Default_Ignorable_Code_Point}\p{Noncharacter_Code_Point}]"
BLANK = "\u2800\U0001d159\U00016fe4"
JOINERS = "\u2d7f\U0001107f\U00011a47\U00011a99"


def test_all_that_draws_nothing_is_written_out() -> None:
    regex = pytest.importorskip("regex", reason="regex is not installed")
    unseen, assigned, emoji = regex.compile(UNSEEN), regex.compile(r"\P{Cn}"), regex.compile(r"\p{Emoji}")
    # The planes in between have no letter, the last ones private ones only.
    codes = [*range(0x40000), *range(0xE0000, 0xE1100), *range(0xEFF00, 0xF0100), *range(0x10FF00, 0x110000)]
    letters = [chr(code) for code in codes if code != 0x0A]
    for letter, shown in zip(letters, printable("b\na".join(letters)).split("b\na"), strict=True):
        if shown != letter:
            assert shown == letter.encode("unicode_escape").decode()
            # What this Python does not know may be anything.
            known = unseen.match(letter) or letter in BLANK + JOINERS or not letter.isprintable()
            assert known and not emoji.match(letter), shown
        elif assigned.match(letter):
            assert letter == "\t" or not unseen.match(letter), hex(ord(letter))


@pytest.mark.parametrize("letter", "\u3164\u115f\u1160\uffa0\u034f\u2800\ufe0f\u180b\u17b4\U0001d159\u200d\u2065\ue200")
def test_no_shape_has_a_letter_that_draws_nothing(letter: str) -> None:
    with pytest.raises(InputError, match="visible letters only"):
        build_mission(shape=f"text:a{letter}b")


@pytest.mark.parametrize(
    "text",
    [
        "❤️ ☀️ ⭐ ✅ 1️⃣ 👁️‍🗨️ 👩🏽‍🚀 🏳️‍🌈 🇩🇪 \U0001fae8",
        "naïve café cafe\u0301 « x » Grüße",
        "編隊 한국어 日本語\u3000です",
        "هفت \u0645\u06cc\u200c\u062e\u0648\u0627\u0647\u0645 क्\u200dष עברית ไทย",
    ],
)
def test_words_and_emoji_stay_as_they_are(text: str) -> None:
    assert printable(text) == text and hidden(text) is None


def test_joiners_are_left_only_where_they_join() -> None:
    assert printable("a\ufe0fb ❤\ufe0f\ufe0f c\u200dd") == "a\\ufe0fb ❤\ufe0f\\ufe0f c\\u200dd"


def test_a_cell_is_cleaned_and_is_no_formula() -> None:
    assert csv_cell("\x1b[31m=1") == "\\x1b[31m=1" and csv_cell("=\u202e1") == "'=\\u202e1"
    assert csv_cell(-1.5) == -1.5 and csv_cell(None) is None
