"""The operator's keyboard, where there is none."""

from __future__ import annotations

import asyncio
import os
import sys
from types import SimpleNamespace
from typing import Any, cast

import pytest

from llm_flock_flight._cli.keyboard import Keyboard, ask


def test_without_a_standard_input_no_question_is_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    assert asyncio.run(ask("Fly? ")) == ""
    Keyboard(cast(Any, SimpleNamespace())).listen()


def test_a_terminal_that_is_gone_confirms_no_question(monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    os.close(writing)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: reading))
    assert asyncio.run(ask("Fly? ")) == ""
