"""The example notebooks run from the first cell to the last, and are committed without what they printed."""

import os
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[2] / "examples").glob("*.ipynb"))


def execute(cells: list[str], folder: Path) -> Any:
    """A notebook of these cells, executed by a new kernel."""
    book: Any = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    NotebookClient(book, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    return book


def shown(cell: Any) -> dict[str, Any]:
    """Everything that a cell showed, by MIME type."""
    found: dict[str, Any] = {}
    for output in cell.outputs:
        found |= output.get("data", {})
    return found


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path, tmp_path: Path) -> None:
    book: Any = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in book.cells), "clear the outputs"
    NotebookClient(book, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}).execute()
    pictures = [shown(cell).get("text/html", "") for cell in book.cells if cell.cell_type == "code"]
    assert any("data:image/png;base64" in picture for picture in pictures)
    assert not list(tmp_path.iterdir()), "a run without `out` writes nothing"


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) >= 2


def test_progress_shows_and_an_interrupt_leaves_all_working(tmp_path: Path) -> None:
    cells = [
        "from llm_flock import run\nr = run(n_robots=6, seed=1, model='simulated:slow@1', rounds=2)\nr.formed",
        "r2 = run(n_robots=3, shape='triangle', seed=1, progress=False)",
    ]
    interrupt = (
        "import os, signal, threading\nfrom llm_flock import read_record, run\n"
        "def stop(now):\n"
        "    if now.round == 2:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "try:\n"
        "    run(n_robots=6, seed=1, model='simulated:slow@1', out='broken', on_round=stop)\n"
        "    raise AssertionError('not interrupted')\n"
        "except KeyboardInterrupt:\n"
        "    pass\n"
        "assert read_record('broken').result['stopped'] == 'interrupted'\n"
        "assert not [t for t in threading.enumerate() if t.name == 'llm-flock run']\n"
    )
    book = execute([*cells, interrupt, "run(n_robots=3, shape='triangle', seed=1).formed"], tmp_path)
    html = shown(book.cells[0])["text/html"]
    assert "<progress" in html and "circle · round" in html
    assert not book.cells[1].outputs
    assert shown(book.cells[3])["text/plain"] == "True"
    assert os.listdir(tmp_path) == ["broken"]  # noqa: PTH208 - one folder
