"""What this project is built from: a list of parts, and which of them have known faults.

    python -m benchmarks.supply sbom FILE         a software bill of materials of requirements.txt (CycloneDX, JSON)
    python -m benchmarks.supply audit DATABASE    advisories that concern these versions; the exit code is 1 if any do

DATABASE is a folder, or a zip file, of advisories in the OSV format (one JSON file each), as osv.dev offers them for
PyPI. Nothing is fetched: the check is as new as the database.
"""

from __future__ import annotations

import json
import re
import sys
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from cyclonedx import model
from cyclonedx.model import bom as boms
from cyclonedx.model import component as components
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

ROOT = Path(__file__).parents[1]

# Their decorators hide the types of these classes.
Bom: Any = boms.Bom
Component: Any = components.Component
HashType: Any = model.HashType


def pins(text: str) -> dict[str, tuple[str, list[str]]]:
    """Version and SHA-256 hashes of each requirement of a file, by its normal name."""
    found: dict[str, tuple[str, list[str]]] = {}
    for line in text.replace("\\\n", "").splitlines():
        match = re.match(r"([A-Za-z0-9._-]+)==([^\s;]+)", line)
        if match is not None:
            found[canonicalize_name(match[1])] = match[2], re.findall(r"--hash=sha256:([0-9a-f]{64})", line)
    return found


def bill(requirements: str) -> str:
    """The bill of materials as JSON. A part has the hashes of all its files, whichever of them is installed."""
    parts = [
        Component(
            type=components.ComponentType.LIBRARY,
            name=name,
            version=version,
            purl=PackageURL("pypi", None, name, version),
            hashes=[HashType(alg=model.HashAlgorithm.SHA_256, content=content) for content in hashes],
        )
        for name, (version, hashes) in pins(requirements).items()
    ]
    whole = Component(type=components.ComponentType.APPLICATION, name="llm-flock")
    bom = Bom(components=parts)
    bom.metadata.component = whole
    bom.register_dependency(whole, parts)
    return JsonV1Dot6(bom).output_as_string(indent=2)


def advisories(database: Path) -> Iterator[Mapping[str, Any]]:
    """Every advisory of a database."""
    if database.is_dir():
        for path in sorted(database.rglob("*.json")):
            yield json.loads(path.read_bytes())
        return
    with zipfile.ZipFile(database) as packed:
        for name in packed.namelist():
            if name.endswith(".json"):
                yield json.loads(packed.read(name))


def concerns(advisory: Mapping[str, Any], name: str, version: str) -> bool:
    """Whether an advisory, unless withdrawn, names this version of a package, or a range that holds it."""
    if advisory.get("withdrawn"):
        return False
    for affected in cast("Sequence[Mapping[str, Any]]", advisory.get("affected", ())):
        package = affected.get("package", {})
        if package.get("ecosystem") != "PyPI" or canonicalize_name(package.get("name", "")) != name:
            continue
        if version in affected.get("versions", ()):
            return True
        if any(_within(found.get("events", ()), version) for found in affected.get("ranges", ()) if _orders(found)):
            return True
    return False


def _orders(found: Mapping[str, Any]) -> bool:
    return found.get("type") in ("ECOSYSTEM", "SEMVER")


def _within(events: Sequence[Mapping[str, str]], version: str) -> bool:
    """Whether a version lies in a range of introductions and fixes."""
    inside, here = False, Version(version)
    for event in sorted(events, key=lambda event: _ordered(next(iter(event.values())))):
        (kind, text), *_ = event.items()
        there = _ordered(text)
        if kind == "introduced" and here >= there:
            inside = True
        elif (kind == "fixed" and here >= there) or (kind == "last_affected" and here > there):
            inside = False
    return inside


def _ordered(text: str) -> Version:
    try:
        return Version(text)
    except InvalidVersion:
        return Version("0")  # the range is then read as beginning earlier, or ending: versions are listed besides


def audit(requirements: str, database: Path) -> list[str]:
    """A line for every advisory that concerns one of the requirements."""
    parts, lines = pins(requirements), list[str]()
    for advisory in advisories(database):
        lines += [
            f"{name} {version}: {advisory.get('id')} {advisory.get('summary', '')}".rstrip()
            for name, (version, _) in parts.items()
            if concerns(advisory, name, version)
        ]
    return lines


def main(arguments: Sequence[str]) -> int:
    """Do as told; returns the exit code."""
    requirements = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    match list(arguments):
        case ["sbom", file]:
            Path(file).write_text(bill(requirements) + "\n", encoding="utf-8")
            return 0
        case ["audit", database] if database and Path(database).exists():
            lines = audit(requirements, Path(database))
            print("\n".join(lines) or f"none of {len(pins(requirements))} parts is named by an advisory")
            return 1 if lines else 0
        case _:
            print(__doc__, file=sys.stderr)
            return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
