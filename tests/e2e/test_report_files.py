"""The whole report of results with every way to end: whole in itself, and the same whenever it is made."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

from sample_results import trial, write_results

from llm_flock_lab._experiments.store import Store
from llm_flock_lab._report.page import write_report


class Page(HTMLParser):
    """What a page would load, and whether its ids are unique."""

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            elif name in ("src", "data", "srcset") or (name in ("href", "xlink:href") and tag not in ("a", "use")):
                self.loads.append(value or "")
            elif name in ("href", "xlink:href"):
                self.links.append(value or "")


def test_the_page_is_whole_in_itself(tmp_path: Path) -> None:
    written = write_report(write_results(tmp_path / "results"), tmp_path, formats=["png"])
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert all(address.startswith(("data:", "#")) for address in page.loads)
    assert len(page.ids) == len(set(page.ids))
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)
    assert not re.search(r"url\((?!#)", text) and "@import" not in text
    assert "counted as not formed" in text and "ZeroDivisionError: in a rule" in text
    markdown = (tmp_path / "report.md").read_text(encoding="utf-8")
    pictures = re.findall(r"\]\((figures/[^)]+)\)", markdown)
    assert len(pictures) > 8 and all((tmp_path / picture).exists() for picture in pictures)
    assert {path.name for path in written} >= {"report.html", "report.md", "success.png"}


def test_the_same_results_make_the_same_report(tmp_path: Path) -> None:
    Store(tmp_path).save(trial("circle", 10, "flock", 0))
    for name in ("a", "b"):
        write_report(tmp_path, tmp_path / name, formats=["svg", "pdf"])
    for path in sorted((tmp_path / "a").rglob("*.*")):
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes(), path.name
