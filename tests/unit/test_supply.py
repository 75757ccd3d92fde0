"""The list of parts, and the advisories about them."""

from __future__ import annotations

import pytest

pytest.importorskip("cyclonedx")


import json
import zipfile
from pathlib import Path
from typing import Any

import pytest
from benchmarks.supply import audit, bill, main, pins

TEXT = """\
Some_Package==1.2.3 ; python_full_version < '3.12' \\
    --hash=sha256:{a} \\
    --hash=sha256:{b}
other==2.0 \\
    --hash=sha256:{a}
""".format(a="a" * 64, b="b" * 64)


def advisory(name: str, **affected: Any) -> dict[str, Any]:
    return {
        "id": "PYSEC-1",
        "summary": "a fault",
        "affected": [{"package": {"ecosystem": "PyPI", "name": name}, **affected}],
    }


def events(*pairs: tuple[str, str]) -> dict[str, Any]:
    return {"ranges": [{"type": "ECOSYSTEM", "events": [{kind: version} for kind, version in pairs]}]}


def test_pins_are_read_with_their_hashes() -> None:
    assert pins(TEXT) == {"some-package": ("1.2.3", ["a" * 64, "b" * 64]), "other": ("2.0", ["a" * 64])}


def test_the_bill_names_every_part() -> None:
    found = json.loads(bill(TEXT))
    assert found["bomFormat"] == "CycloneDX" and found["metadata"]["component"]["name"] == "llm-flock"
    parts = {part["purl"]: len(part["hashes"]) for part in found["components"]}
    assert parts == {"pkg:pypi/some-package@1.2.3": 2, "pkg:pypi/other@2.0": 1}


@pytest.mark.parametrize(
    ("found", "hit"),
    [
        (advisory("some.package", versions=["1.2.3"]), True),
        (advisory("some.package", versions=["1.2.4"]), False),
        (advisory("some-package", **events(("introduced", "0"), ("fixed", "1.2.4"))), True),
        (advisory("some-package", **events(("introduced", "0"), ("fixed", "1.2.3"))), False),
        (advisory("some-package", **events(("introduced", "1.3"))), False),
        (advisory("some-package", **events(("introduced", "1.0"), ("last_affected", "1.2.3"))), True),
        (advisory("some-package", **events(("fixed", "1.1"), ("introduced", "0"), ("introduced", "1.2"))), True),
        (advisory("third", versions=["1.2.3"]), False),
        ({**advisory("some-package", versions=["1.2.3"]), "withdrawn": "2026-01-01"}, False),
    ],
)
def test_an_advisory_concerns_the_versions_that_it_names(found: dict[str, Any], hit: bool, tmp_path: Path) -> None:
    (tmp_path / "1.json").write_text(json.dumps(found), encoding="utf-8")
    packed = tmp_path / "all.zip"
    with zipfile.ZipFile(packed, "w") as file:
        file.write(tmp_path / "1.json", "1.json")
    expected = ["some-package 1.2.3: PYSEC-1 a fault"] if hit else []
    assert audit(TEXT, tmp_path) == audit(TEXT, packed) == expected


def test_the_commands_say_what_they_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sbom", str(tmp_path / "sbom.json")]) == 0
    assert len(json.loads((tmp_path / "sbom.json").read_bytes())["components"]) > 100
    (tmp_path / "db").mkdir()
    assert main(["audit", str(tmp_path / "db")]) == 0
    assert "parts is named" in capsys.readouterr().out
    assert main(["audit", str(tmp_path / "none")]) == main([]) == 2
