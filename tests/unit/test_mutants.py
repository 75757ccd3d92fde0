"""The list of mutants fits sources, tests and documentation. Trying them all takes minutes: `make mutants`."""

import re
from pathlib import Path

import pytest
from benchmarks.mutants import COPIED, ROOT, mutated, source
from benchmarks.mutations import MUTANTS, Mutant

IDS = [mutant.name for mutant in MUTANTS]


def test_names_are_unique() -> None:
    assert len(set(IDS)) == len(IDS)
    assert all((ROOT / name).exists() for name in COPIED)


@pytest.mark.parametrize("mutant", MUTANTS, ids=IDS)
def test_a_mutant_fits_the_sources(mutant: Mutant) -> None:
    text = source(ROOT, mutant).read_text(encoding="utf-8")
    changed = mutated(text, mutant)
    assert changed != text
    compile(changed, mutant.file, "exec")


@pytest.mark.parametrize("mutant", MUTANTS, ids=IDS)
def test_the_test_that_has_to_fail_exists(mutant: Mutant) -> None:
    path, _, function = mutant.test.partition("::")
    assert f"def {function}(" in Path(ROOT / "tests" / path).read_text(encoding="utf-8")


def test_a_snippet_that_is_gone_or_stands_twice_is_refused() -> None:
    mutant = MUTANTS[0]
    for text in ("", mutant.snippet * 2):
        with pytest.raises(LookupError, match=mutant.name):
            mutated(text, mutant)


def test_the_documentation_lists_the_mutants() -> None:
    page = (ROOT / "docs" / "explanation" / "testing.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `[a-z-]+` \|.*\|$", page, re.MULTILINE)
    assert rows == [mutant.row for mutant in MUTANTS]
