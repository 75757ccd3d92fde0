"""What a command imports before it has something to do with it, and what is said where an extra is missing."""

from __future__ import annotations

import json
import pickle
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer.main
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.errors import InputError
from llm_flock.extras import EXTRAS, ExtraMissing, require, require_posix

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "packages" / "llm-flock" / "pyproject.toml").read_text(encoding="utf-8"))["project"]

HEAVY = (
    *("scipy.optimize", "scipy.sparse", "scipy.spatial", "scipy.special", "shapely", "polars", "matplotlib", "PIL"),
    *(
        "pydantic_ai",
        "openai",
        "anthropic",
        "genai_prices",
        "httpx2",
        "starlette",
        "uvicorn",
        "zenoh",
        "cryptography",
        "ray",
        "torch",
    ),
    *("transformers", "cflib", "jax", "pymavlink", "serial"),
)
"""What takes long to import. None of it is needed to list the commands or to refuse a wrong value."""

CONFIG = ("numpy", "scipy")
"""What the configuration needs, but neither the help nor commands without it."""

LINES = {
    "": CONFIG,
    "--help": CONFIG,
    "no-such-command": CONFIG,
    "models": CONFIG,
    "view --help": CONFIG,
    "view no-such-file": CONFIG,
    "distill --help": CONFIG,
    "report no-such-folder": CONFIG,
    "export no-such-folder": CONFIG,
    "run --help": (),
    "run --sensing-range 1": (),
    "run --no-such-flag": (),
    "sweep no-such-file": (),
    "fly --crazyflies no-such-file --robots 0": (),
    "swarm --robots 0": (),
    "mission --set nothing": (),
    "inspect no-such-file": (),
    "figure no-such-file": (),
    "animate no-such-file": (),
}
"""Command lines that have nothing to fly or draw, and what else they must not import."""

PROBE = """
import json, sys
from llm_flock.__main__ import main
found = []
for line, heavy in json.loads(sys.argv[1]):
    sys.argv[1:] = line.split()
    try:
        main()
    except SystemExit:
        pass
    found.append([name for name in heavy if name in sys.modules])
print(json.dumps(found), file=sys.stderr)
"""


def probed(asked: str, probe: str = PROBE) -> list[str]:
    """What a new process writes to stderr that runs command lines one after another; the modules found are last."""
    command = [sys.executable, "-c", probe, asked]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stderr.splitlines()


def imported(lines: list[str]) -> list[list[str]]:
    """Heavy modules that are loaded after each of some command lines, one after another in one new process."""
    return json.loads(probed(json.dumps([(line, (*HEAVY, *LINES[line])) for line in lines]))[-1])


@pytest.mark.slow
def test_commands_that_refuse_import_nothing_heavy() -> None:
    # The order of LINES is from the lightest to those with the configuration: one process will do.
    assert dict(zip(LINES, imported(list(LINES)), strict=True)) == {line: [] for line in LINES}


@pytest.mark.slow
def test_the_probe_would_notice() -> None:
    assert probed('[["shapes", ["numpy", "json", "shapely"]]]')[-1] == '[["numpy", "json"]]'


def test_the_viewer_loads_no_other_command() -> None:
    # A page waits for it. It refuses what it is given here after it has built its options.
    probe = PROBE.replace("sys.argv[1:] = line.split()", 'sys.argv[1:] = ["view", *line.split()]')
    *said, found = probed('[["no-such-file", ["llm_flock.cli._run", "rich", "asyncio", "typer", "numpy"]]]', probe)
    assert "no-such-file" in "\n".join(said)
    assert found == '[["typer"]]'


def test_the_list_of_commands_is_that_of_the_commands() -> None:
    group = typer.main.get_command(app)
    listed = {name: group.get_command(None, name).help for name in group.list_commands(None)}  # type: ignore[attr-defined]
    built = {name: command.help for name, command in group.commands.items()}  # type: ignore[attr-defined]
    assert {name: text.splitlines()[0] for name, text in listed.items()} == {
        name: text.splitlines()[0] for name, text in built.items()
    }
    assert len(listed) > 15 and all(listed.values())


def test_extras_are_those_of_the_project() -> None:
    declared = PROJECT["optional-dependencies"]
    assert set(EXTRAS) == declared.keys() - {"all", "dev", "docs"}
    named = re.fullmatch(r"llm-flock\[(.*)\]", declared["all"][0])
    assert named is not None
    left_out = {"crazyflie", "distill", "exam", "local", "mavlink", "mocap", "physics", "rerun"}
    assert set(EXTRAS) - set(named[1].split(",")) == left_out


def test_the_page_on_installation_lists_every_extra() -> None:
    page = (ROOT / "docs/how-to/installation.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| `([a-z0-9]+)` \|", page, re.MULTILINE) == [*EXTRAS, "all"]
    for extra in PROJECT["optional-dependencies"].keys() - {"dev", "docs"}:
        assert f"| `{extra}` |" in page


@pytest.mark.parametrize("name", EXTRAS)
def test_a_missing_extra_is_named_in_one_line(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in EXTRAS[name].modules:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ExtraMissing) as caught:
        require(name, "this")
    assert str(caught.value) == f"this needs the extra {name}: pip install 'llm-flock[{name}]'"
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value) and again.extra == name


@pytest.mark.parametrize(
    ("module", "line", "extra"),
    [
        ("polars", "sweep no-such-file", "sweep"),
        ("polars", "report no-such-folder", "sweep"),
        ("matplotlib", "export .", "sweep"),
        ("matplotlib", "figure no-such-file", "figures"),
        ("PIL", "animate no-such-file", "figures"),
        ("zenoh", "keys no-such-folder --robots 2", "network"),
        ("starlette", "view no-such-file", "view"),
        ("mcp", "mcp", "mcp"),
        ("openai", "run --robots 3 --shape triangle --model vllm:x --no-record", "openai"),
        ("anthropic", "run --robots 3 --shape triangle --model anthropic:x --no-record", "anthropic"),
    ],
)
def test_commands_name_the_extra_that_they_need(
    module: str, line: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setenv("ANTHROPIC_API_KEY", "a-key")
    result = CliRunner().invoke(app, line.split())
    assert isinstance(result.exception, ExtraMissing)
    assert str(result.exception).endswith(f" needs the extra {extra}: pip install 'llm-flock[{extra}]'")


def test_models_lists_what_needs_no_provider(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("QWEN_API_KEY", "")
    monkeypatch.setenv("DASHSCOPE_API_KEY", "a-secret")
    text = CliRunner().invoke(app, ["models"]).output
    assert "simulated:ideal" in text and "geometry" in text and "a-secret" not in text
    assert re.search(r"DASHSCOPE_API_KEY\W+yes", text)


def test_command_for_posix_is_refused_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    require_posix("swarm")
    monkeypatch.setattr("llm_flock.extras.os", SimpleNamespace(name="nt"))
    with pytest.raises(InputError, match=r"swarm.*Subsystem for Linux"):
        require_posix("swarm")
