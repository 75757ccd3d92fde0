"""Directives that draw pages from the code, so that the pages cannot fall behind it.

`agent-states`       diagram and table of the agent's transitions
`cli-options`        every command of the command line with its arguments and options
`config-fields`      every field of the configuration file with default and description
`summary-keys`       every key that `run --json` prints
`sweep-fields`       every field of a sweep's own tables
`result-columns TABLE` every column of `trials` or `rounds`, the tables of a sweep
`message-fields`     every field of a protocol message
`record-fields TOPIC` every field of a channel of a record
`shapes`             every named shape with its team sizes
`providers`          every provider of models with its key, address and an example
`rooms [PACKAGE]`    the packages by import layer, or those of a package, one line each
`modules`            the modules of each package, one line each
`protocol-constants` every documented constant of the protocol with its value
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.docutils import SphinxDirective
from state_diagram import draw

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "packages" / "llm-flock" / "src" / "llm_flock"
TOPS = sorted(ROOT.glob("packages/*/src/llm_flock*"), key=lambda top: (top != SOURCE, top.name))
"""The package of every part, the core first."""

MAX_VALUE_LENGTH = 40
"""Constants whose value is longer than this [characters] are tables of the code, not figures of the protocol."""


def table(header: Sequence[str], rows: Iterable[Sequence[str]], code_columns: int = 1) -> nodes.table:
    """A table whose first columns are set as code."""
    group = nodes.tgroup(cols=len(header))
    group += [nodes.colspec(colwidth=1) for _ in header]
    head, body = nodes.thead(), nodes.tbody()

    def row(cells: Sequence[str], as_code: bool) -> nodes.row:
        line = nodes.row()
        for column, text in enumerate(cells):
            inline = [nodes.literal(text=text)] if as_code and column < code_columns and text else spans(text)
            line += nodes.entry("", nodes.paragraph("", "", *inline))
        return line

    head += row(header, as_code=False)
    body += [row(cells, as_code=True) for cells in rows]
    group += [head, body]
    return nodes.table("", group)


def spans(text: str) -> list[nodes.Node]:
    """Plain words, with what stands between backticks as code."""
    parts = text.split("`")
    return [nodes.literal(text=part) if k % 2 else nodes.Text(part) for k, part in enumerate(parts) if part]


class AgentStates(SphinxDirective):
    """The agent's state machine, as a picture and as a table."""

    def run(self) -> list[nodes.Node]:
        from llm_flock.events import TRANSITIONS

        edges = [
            (str(source), event.__name__, sorted(map(str, targets))) for (source, event), targets in TRANSITIONS.items()
        ]
        always = everywhere(edges)
        ends = [event for event in dict.fromkeys(event for _, event, _ in edges) if final(edges, event)]
        rows = [(s, event, " or ".join(targets)) for s, event, targets in edges if event not in (*always, *ends)]
        rows += [(s, event, " or ".join(targets)) for s, event, targets in edges if event in always and targets != [s]]
        rows += [("any phase", event, "the same phase") for event in always]
        rows += [("any phase", event, final(edges, event)) for event in ends]
        drawn = draw([edge for edge in edges if edge[1] not in always or set(edge[2]) != {edge[0]}])
        return [nodes.raw("", drawn, format="html"), table(("Phase", "Event", "Leads to"), rows, 2)]


def everywhere(edges: list[tuple[str, str, list[str]]]) -> list[str]:
    """Events that every phase with a way out takes and that only one phase, if any, leaves by."""
    phases = {source for source, _, _ in edges}
    stays: dict[str, int] = defaultdict(int)
    for source, event, targets in edges:
        stays[event] += source in targets
    return [event for event, count in stays.items() if count == len(phases)]


def final(edges: list[tuple[str, str, list[str]]], event: str) -> str:
    """The one phase to which an event leads from all others; empty where there is no such phase."""
    sources = {source for source, _, _ in edges}
    leads = {source: targets for source, name, targets in edges if name == event}
    one = {target for targets in leads.values() for target in targets}
    return one.pop() if leads.keys() == sources and len(one) == 1 else ""


class CliOptions(SphinxDirective):
    """One section a command: what it does, its arguments and its options."""

    def run(self) -> list[nodes.Node]:
        import typer.main

        from llm_flock.cli import app

        group: Any = typer.main.get_command(app)
        sections: list[nodes.Node] = []
        for name, command in group.commands.items():
            title = f"llm-flock {name}"
            section = nodes.section(ids=[nodes.make_id(title)], names=[title])
            section += nodes.title(text=title)
            for paragraph in (command.help or "").split("\n\n"):
                if paragraph.strip():
                    section += nodes.paragraph(text=" ".join(paragraph.split()))
            rows = [option_row(param) for param in command.params]
            if rows:
                section += table(("Argument or option", "Default", "Meaning"), rows, 2)
            sections.append(section)
        return sections


def option_row(param: Any) -> tuple[str, str, str]:
    """How a parameter is written, its default, and its help."""
    if param.param_type_name == "argument":
        spelled = (param.metavar or param.name).upper()
    else:
        spelled = " / ".join([", ".join(param.opts), *param.secondary_opts])
    empty = param.default is None or callable(param.default) or repr(param.default).startswith("Sentinel")
    return spelled, "" if empty else str(param.default), getattr(param, "help", None) or ""


class ConfigFields(SphinxDirective):
    """One section a table of the configuration file."""

    def run(self) -> list[nodes.Node]:
        from llm_flock_swarm._network.config import SwarmConfig

        sections: list[nodes.Node] = []
        for name, info in SwarmConfig.model_fields.items():
            section_type: Any = info.annotation
            section = nodes.section(ids=[f"config-{name}"], names=[f"config {name}"])
            section += nodes.title("", "", nodes.literal(text=f"[{name}]"))
            section += table(
                ("Field", "Default", "Meaning"),
                [
                    (field, "" if detail.default is None else str(detail.default), detail.description or "")
                    for field, detail in section_type.model_fields.items()
                ],
                2,
            )
            sections.append(section)
        return sections


class SummaryKeys(SphinxDirective):
    """The keys of the object that `run --json` prints, from the comments beside the fields of the summary."""

    def run(self) -> list[nodes.Node]:
        return [table(("Key", "Meaning"), commented("llm_flock.runtime._result", "Summary"), 1)]


class SweepFields(SphinxDirective):
    """The fields of the tables that only a sweep's file has."""

    def run(self) -> list[nodes.Node]:
        from llm_flock_lab._experiments import sweep_file

        tables = {
            "sweep": sweep_file.SweepTable,
            "budget": sweep_file.BudgetTable,
            "providers.NAME": sweep_file.ProviderTable,
            "expect": sweep_file.ExpectTable,
        }
        rows = [
            (f"[{name}]", field, _default(detail), detail.description or "")
            for name, model in tables.items()
            for field, detail in model.model_fields.items()
        ]
        return [table(("Table", "Field", "Default", "Meaning"), rows, 3)]


def _default(detail: Any) -> str:
    if detail.is_required() or detail.default is None:
        return ""
    return str(detail.default)


class ResultColumns(SphinxDirective):
    """The data dictionary of one table."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        from llm_flock_lab._experiments import tables

        columns = {"trials": tables.TRIALS, "rounds": tables.ROUNDS}[self.arguments[0]]
        rows = [(column.name, column.kind, column.unit, column.meaning) for column in columns]
        return [table(("Column", "Type", "Unit", "Meaning"), rows, 1)]


class MessageFields(SphinxDirective):
    """The fields of a protocol message, from the comments beside them."""

    def run(self) -> list[nodes.Node]:
        return [table(("Field", "Meaning"), commented("llm_flock.message", "Message"), 1)]


class Shapes(SphinxDirective):
    """What `llm-flock shapes` prints."""

    def run(self) -> list[nodes.Node]:
        from llm_flock import shapes as formations

        listed = (*formations.shapes(), *formations.drawn_shapes())
        rows = [(shape.name, shape.legal, shape.description) for shape in listed]
        return [table(("Shape", "N", "What it is"), rows, 1)]


class Providers(SphinxDirective):
    """What `llm-flock models` prints of providers."""

    def run(self) -> list[nodes.Node]:
        from llm_flock.llm._providers import PROVIDERS

        rows = [
            (
                f"`{info.example}`",
                f"`{info.key_env}`",
                "yes" if info.key_required else "no",
                info.base_url or "to be given",
            )
            for info in PROVIDERS.values()
        ]
        return [table(("Example", "Key in the environment", "Key needed", "Address"), rows, 0)]


class RecordFields(SphinxDirective):
    """The fields of one channel of a record, with those of objects inside it."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        from llm_flock.record._schema import CHANNELS, channel_schema

        rows = record_rows(channel_schema(CHANNELS[self.arguments[0]]), CHANNELS[self.arguments[0]])
        return [table(("Field", "Type", "Meaning"), rows, 1)]


def record_rows(schema: dict[str, Any], model: Any, prefix: str = "") -> list[tuple[str, str, str]]:
    """Name, type and meaning of each field; `optional` may be left out, `volatile` may differ between two runs."""
    rows: list[tuple[str, str, str]] = []
    for name, field in schema["properties"].items():
        info = model.model_fields[name]
        extra = info.json_schema_extra or {}
        marks = [
            "list" if field["type"] == "array" else field["type"],
            "optional" if info.default is None and not info.is_required() else "",
            "volatile" if extra.get("volatile") else "",
        ]
        rows.append((prefix + name, ", ".join(filter(None, marks)), info.description))
        for kind in (info.annotation, *get_args(info.annotation)):
            if hasattr(kind, "model_fields"):
                inside = field["items"] if field["type"] == "array" else field
                rows += record_rows(inside, kind, f"{prefix}{name}{'[].' if inside is not field else '.'}")
    return rows


def packages() -> Iterator[tuple[str, Path]]:
    """Dotted name and folder of every package, the core first; the core's names are those below `llm_flock`."""
    for top in TOPS:
        for init in sorted(top.rglob("__init__.py")):
            yield ".".join(init.parent.relative_to(top if top == SOURCE else top.parent).parts), init.parent


def first_line(module: Path) -> str:
    """The first line of a module's docstring; empty where it has none."""
    text = ast.get_docstring(ast.parse(module.read_text(encoding="utf-8")))
    return (text or "").partition("\n")[0]


class Rooms(SphinxDirective):
    """One row for each package: by layer, the highest first, or those within a package that is named."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        if self.arguments:
            inside = f"{self.arguments[0]}."
            rows = [(name, first_line(path / "__init__.py")) for name, path in packages() if name.startswith(inside)]
            return [table(("Package", "What it is for"), rows)]
        rows = [(str(level), name, first_line(source(name))) for level, name in by_layer()]
        return [table(("Layer", "Package or module", "What it is for"), rows, 2)]


def source(name: str) -> Path:
    """The file with the docstring of a package or module at the top of the tree."""
    package = SOURCE / name / "__init__.py"
    return package if package.exists() else SOURCE / f"{name}.py"


def by_layer() -> list[tuple[int, str]]:
    """Every name in the import contract with the number of its layer, 1 for the lowest; the highest first."""
    found = layers()
    return [(len(found) - k, name) for k, layer in enumerate(found) for name in re.findall(r"\w+", layer)]


class Modules(SphinxDirective):
    """One section for each package, one row for each of its modules."""

    def run(self) -> list[nodes.Node]:
        sections: list[nodes.Node] = []
        for name, folder in packages():
            rows = [(path.name, first_line(path)) for path in sorted(folder.glob("*.py")) if path.stem != "__init__"]
            if rows:
                title = name or "llm_flock"
                section = nodes.section(ids=[nodes.make_id(f"modules {title}")], names=[f"modules {title}"])
                section += nodes.title("", "", nodes.literal(text=title))
                section += table(("Module", "What it is for"), rows)
                sections.append(section)
        return sections


def layers() -> list[str]:
    """The layers of the import contract, the highest first."""
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = config["tool"]["importlinter"]["contracts"]
    return next(contract["layers"] for contract in contracts if contract["type"] == "layers")


def constants(module: Path) -> list[tuple[str, str, str]]:
    """Name, value and meaning of every public constant of a module with a docstring, or a comment in its line."""
    text = module.read_text(encoding="utf-8")
    lines, body = text.splitlines(), ast.parse(text).body
    found: list[tuple[str, str, str]] = []
    for node, after in pairwise([*body, ast.Pass()]):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        meaning = lines[node.lineno - 1].partition("  # ")[2]
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            meaning = " ".join(str(after.value.value).split())
        name = ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target).strip("()")
        if meaning and re.fullmatch(r"[A-Z][A-Z0-9_]*(, [A-Z][A-Z0-9_]*)*", name):
            found.append((name, ast.unparse(node.value), f"{meaning[0].upper()}{meaning[1:].rstrip('.')}."))
    return found


class ProtocolConstants(SphinxDirective):
    """One section for each module of the protocol that has constants."""

    def run(self) -> list[nodes.Node]:
        sections: list[nodes.Node] = []
        for path in sorted((SOURCE / "protocol").rglob("*.py")):
            rows = [row for row in constants(path) if len(row[1]) <= MAX_VALUE_LENGTH]
            if rows:
                title = ".".join(path.relative_to(SOURCE / "protocol").with_suffix("").parts)
                section = nodes.section(ids=[nodes.make_id(f"constants {title}")], names=[f"constants {title}"])
                section += nodes.title("", "", nodes.literal(text=title))
                section += table(("Constant", "Value", "Meaning"), rows, 2)
                sections.append(section)
        return sections


def commented(module: str, of: str) -> list[tuple[str, str]]:
    """Name and meaning of each field of a class with a comment beside it, in their order."""
    found = ModuleAnalyzer.for_module(module).find_attr_docs()
    return [(name, " ".join(lines).strip()) for (owner, name), lines in found.items() if owner == of]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directives."""
    app.add_directive("agent-states", AgentStates)
    app.add_directive("cli-options", CliOptions)
    app.add_directive("config-fields", ConfigFields)
    app.add_directive("summary-keys", SummaryKeys)
    app.add_directive("sweep-fields", SweepFields)
    app.add_directive("result-columns", ResultColumns)
    app.add_directive("message-fields", MessageFields)
    app.add_directive("record-fields", RecordFields)
    app.add_directive("shapes", Shapes)
    app.add_directive("providers", Providers)
    app.add_directive("rooms", Rooms)
    app.add_directive("modules", Modules)
    app.add_directive("protocol-constants", ProtocolConstants)
    return {"parallel_read_safe": True}
