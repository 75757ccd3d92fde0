"""The list of mutants fits sources and tests. Trying them all takes minutes: `make mutants`."""

from pathlib import Path

import pytest
from benchmarks.mutants import COPIED, ROOT, load

MUTANTS = load()


def test_names_are_unique() -> None:
    names = [mutant.name for mutant in MUTANTS]
    assert len(set(names)) == len(names)
    assert all((ROOT / name).exists() for name in COPIED)


def test_every_mutant_fits_the_sources() -> None:
    for mutant in MUTANTS:
        text = mutant.path(ROOT).read_text(encoding="utf-8")
        changed = mutant.applied(text)
        assert changed != text, mutant.name
        compile(changed, mutant.file, "exec")


def test_the_tests_that_have_to_fail_exist() -> None:
    for mutant in MUTANTS:
        path, _, function = mutant.test.partition("::")
        assert f"def {function}(" in Path(ROOT / path).read_text(encoding="utf-8"), mutant.name


def test_a_snippet_that_is_gone_or_occurs_twice_is_refused() -> None:
    mutant = MUTANTS[0]
    for text in ("", mutant.snippet * 2):
        with pytest.raises(LookupError, match=mutant.name):
            mutant.applied(text)
