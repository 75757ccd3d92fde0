"""Flies the runs of docs/gallery.md and takes their pictures: `python docs/gallery_images.py [NAME]...`.

The commands are read from the page, so that each of them is tried. Prints the rows of its table.
"""

from __future__ import annotations

import io
import json
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from llm_flock.record.reader import read_record
from llm_flock.viz import figures

DOCS = Path(__file__).parent
COLOURS = 48
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
    return f"| [{name}](#{name}) | {formed} | {result['wall_s']:.1f} s |"


def main() -> None:
    found = COMMAND.findall((DOCS / "gallery.md").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        for name, command in found:
            if not sys.argv[1:] or name in sys.argv[1:]:
                print(fly(Path(folder), name, command), flush=True)


if __name__ == "__main__":
    main()
