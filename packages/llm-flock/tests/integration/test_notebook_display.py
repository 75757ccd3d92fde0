"""What a result and a record show in a notebook, and the frames that they give."""

import re
import sys
import types
from pathlib import Path
from typing import Any

import pytest

import llm_flock
from llm_flock.errors import InputError
from llm_flock.runtime import _notebook as notebook
from llm_flock.runtime._notebook import in_notebook, notebook_progress, progress_html
from llm_flock.runtime._result import RunResult
from llm_flock.runtime._trial import TrialProgress


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunResult, Path]:
    """A short run, and the folder of its record."""
    folder = tmp_path_factory.mktemp("run")
    return llm_flock.run(shape="triangle", n_robots=3, seed=1, rounds=3, out=folder), folder


def test_a_result_is_a_picture_and_a_table(flown: tuple[RunResult, Path]) -> None:
    html = flown[0]._repr_html_()
    assert html is not None
    assert "data:image/png;base64," in html and "alt=" in html
    assert "triangle, 3 robots, seed 1 (simulated language models)" in html
    assert ">outcome</th>" in html and ">Not formed: all 3 rounds were used up<" in html
    assert ">none (simulated)</td>" in html
    assert re.fullmatch(r"RunResult\(triangle, 3 robots, seed 1, .*, simulated language models\)", repr(flown[0]))


def test_a_record_shows_the_same_and_says_where_it_is_from(flown: tuple[RunResult, Path]) -> None:
    record = llm_flock.read_record(flown[1])
    assert "(simulated language models)" in (record._repr_html_() or "")
    assert str(flown[1]) in repr(record) and len(repr(record)) < 400


def test_words_of_a_record_are_no_html(flown: tuple[RunResult, Path]) -> None:
    result = llm_flock.run(shape="text:<script>alert(1)</script>", n_robots=3, rounds=1, fallback="hold")
    assert "<script>" not in (result._repr_html_() or "")


def test_a_result_animates(flown: tuple[RunResult, Path], tmp_path: Path) -> None:
    animation = flown[0].animate(fps=10)
    assert animation.gif.startswith(b"GIF89a") and "data:image/gif;base64," in animation._repr_html_()
    animation.save(tmp_path / "run.gif")
    assert (tmp_path / "run.gif").read_bytes() == animation.gif
    with pytest.raises(InputError, match="fps"):
        flown[0].animate(fps=0)


def test_frames_have_the_rounds_and_the_robots(flown: tuple[RunResult, Path]) -> None:
    result, folder = flown
    rounds, robots = result.to_polars(), result.to_polars("robots")
    assert rounds.height == 4 and rounds["round"].to_list() == [0, 1, 2, 3]
    assert robots.height == 12 and robots["x"].to_list() == result.positions[:, :, 0].ravel().tolist()
    record = llm_flock.read_record(folder)
    assert record.to_polars().equals(rounds) and record.to_polars("robots").equals(robots)
    with pytest.raises(InputError, match="rounds or robots"):
        result.to_polars("messages")  # pyright: ignore[reportArgumentType]


def test_pandas_gets_the_same_frames(flown: tuple[RunResult, Path]) -> None:
    pytest.importorskip("pandas")
    for table in ("rounds", "robots"):
        frame, wanted = flown[0].to_pandas(table), flown[0].to_polars(table)
        assert list(frame.columns) == wanted.columns and frame.shape == wanted.shape
    assert str(flown[0].to_pandas("robots")["slot"].dtype) == "Int64"


def test_without_pandas_the_line_names_the_extra(
    flown: tuple[RunResult, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"pip install 'llm-flock\[notebook\]'"):
        flown[0].to_pandas()


def test_a_result_without_a_trace_shows_nothing_and_says_why() -> None:
    result = llm_flock.run(n_robots=3, shape="triangle", rounds=1, trace=False)
    assert result._repr_html_() is None
    with pytest.raises(InputError, match="trace"):
        result.to_polars()


def test_a_run_of_no_rounds_shows_its_start() -> None:
    result = llm_flock.run(n_robots=1, shape="line", rounds=0)
    assert result._repr_html_() and result.to_polars("robots").height == 1


NOW = TrialProgress(
    round=3,
    rounds=9,
    at_goal=1,
    n_robots=4,
    plans_in_use=2,
    distinct_goals=3,
    error=1.5,
    model_calls=7,
    tokens=1234,
    cost_usd=0.5,
)


def test_progress_is_one_line_that_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []

    class Handle:
        def update(self, html: str) -> None:
            shown.append(html)

    def display(html: str, *, display_id: bool) -> Handle:
        shown.append(f"new {html}")
        return Handle()

    fake: Any = types.ModuleType("IPython")
    fake.get_ipython = lambda: types.SimpleNamespace(kernel=object())
    module: Any = types.ModuleType("IPython.display")
    module.HTML, module.display = str, display
    monkeypatch.setitem(sys.modules, "IPython", fake)
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    monkeypatch.setattr(notebook, "PATIENCE_S", 0.0)
    heard: list[TrialProgress] = []
    with notebook_progress("circle", heard.append) as on_round:
        assert on_round is not None
        on_round(NOW)
        on_round(NOW)
    assert heard == [NOW, NOW]
    assert [text.startswith("new ") for text in shown] == [True, False], "the second drawing comes at the end"
    assert 'value="1" max="4"' in shown[0] and "0.5000 USD" in shown[0]
    monkeypatch.setattr(notebook, "PATIENCE_S", 60.0)
    with notebook_progress("circle") as on_round:
        assert on_round is not None
        on_round(NOW)
    assert len(shown) == 2, "a quick run shows nothing"


def test_a_notebook_that_cannot_draw_ends_no_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def display(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(notebook, "in_notebook", lambda: True)
    monkeypatch.setattr(notebook, "import_module", lambda _: types.SimpleNamespace(HTML=str, display=display))
    monkeypatch.setattr(notebook, "PATIENCE_S", 0.0)
    heard: list[TrialProgress] = []
    with notebook_progress("circle", heard.append) as on_round:
        assert on_round is not None
        on_round(NOW)
    assert heard == [NOW]


def test_outside_notebooks_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    assert not in_notebook()
    with notebook_progress("circle", print) as on_round:
        assert on_round is print


def test_labels_are_no_html() -> None:
    assert "<b>" not in progress_html("<b>", NOW)
