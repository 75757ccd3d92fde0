"""Flies the runs of docs/gallery.md and takes their pictures: `python docs/gallery_images.py [NAME]...`.

So it does with the figures of the README and of the first comparison. The commands are read from the pages, so that
each of them is tried. Prints the rows of the gallery's table. `demo` is the animation of `make demo`, and `report` are
the figures of a report of 800 trials, which takes the longest.
"""

from __future__ import annotations

import io
import json
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from llm_flock.record._reader import read_record
from llm_flock_view._figures import figures

DOCS = Path(__file__).parent
COLOURS, FINER = 128, 256
DPI = 84
COMMAND = re.compile(r"^## (\w+)\n.*?```bash\nllm-flock (run .*?)\n```", re.MULTILINE | re.DOTALL)


def fly(folder: Path, name: str, command: str) -> str:
    arguments = [*shlex.split(command), "--quiet", "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "llm_flock", *arguments], cwd=folder, check=True, capture_output=True, text=True
    )
    result = json.loads(done.stdout)
    record = read_record(folder / "runs" / name / "run.mcap")
    figure = figures.snapshots(record, sorted({0, record.rounds // 3, record.rounds}))
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=DPI, format="png")
    picture = Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    picture.save(DOCS / "images" / f"gallery-{name}.png", optimize=True)
    formed = f"in round {result['rounds_to_formed']}" if result["formed"] else f"no, {result['rounds']} rounds flown"
    return f'{name},"{formed}",{result["wall_s"]:.1f}'


PAGES = {"in-flight": "tutorial/tour.md", "three-rules": "tutorial/quickstart.md"}
"""Pages with the commands for other pictures, in the block before each."""


def draw(folder: Path, name: str, page: str) -> str:
    text = (DOCS / page).read_text(encoding="utf-8")
    before = text.partition(f"images/{name}.png")[0]
    block = re.findall(r"```bash\n(.*?)```", before, re.DOTALL)[-1].replace("\\\n", " ")
    for line in block.strip().splitlines():
        command = [sys.executable, "-m", "llm_flock", *shlex.split(line)[1:]]
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    drawn = folder / shlex.split(block.strip().splitlines()[-1])[-1]
    reduced(drawn, name)
    return name


def reduced(drawn: Path, name: str) -> None:
    picture = Image.open(drawn).convert("RGB").quantize(FINER, dither=Image.Dither.NONE)
    picture.save(DOCS / "images" / f"{name}.png", optimize=True)


def demo(folder: Path) -> None:
    """The animation of the first lines of the README."""
    recipe = (DOCS.parent / "Makefile").read_text(encoding="utf-8").partition("\ndemo:")[2].partition("\n\n")[0]
    for line in re.findall(r"llm-flock ((?:run|animate) .*)", recipe):
        subprocess.run([sys.executable, "-m", "llm_flock", *shlex.split(line)], cwd=folder, check=True)
    shutil.copy(folder / "runs" / "demo" / "animation.gif", DOCS / "images" / "circle.gif")


def report(folder: Path) -> None:
    """The figures of docs/how-to/report.md."""
    sweep = DOCS.parent / "experiments" / "paper-figures.toml"
    for command in (["sweep", str(sweep)], ["report", "runs/paper-figures", "--formats", "png"]):
        subprocess.run([sys.executable, "-m", "llm_flock", *command, "--quiet"], cwd=folder, check=True)
    shown = {"report-success": "success", "report-paired": "paired-error"}
    for name in ("paper-error", "paper-circle-10", *shown):
        reduced(folder / "runs" / "paper-figures" / "report" / "figures" / f"{shown.get(name, name)}.png", name)


OTHERS = {"demo": demo, "report": report}


def main() -> None:
    found = COMMAND.findall((DOCS / "gallery.md").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        for name, command in found:
            if not sys.argv[1:] or name in sys.argv[1:]:
                print(fly(Path(folder), name, command), flush=True)
        for name, page in PAGES.items():
            if not sys.argv[1:] or name in sys.argv[1:]:
                print(draw(Path(folder), name, page), flush=True)
        for name, take in OTHERS.items():
            if not sys.argv[1:] or name in sys.argv[1:]:
                take(Path(folder))


if __name__ == "__main__":
    main()
