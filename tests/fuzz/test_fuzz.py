"""A sample of the fuzzing, and every fault it ever found; `make fuzz` runs the rest."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from fuzz.campaign import REGRESSIONS, Child, shares

SAMPLE = 1000
"""Inputs of all targets together; `make fuzz` runs a hundred times as many."""

FAULTS = sorted(path for path in REGRESSIONS.glob("*/*") if path.is_dir())


@pytest.fixture(scope="module")
def child() -> Iterator[Child]:
    with Child() as one:
        yield one


@pytest.mark.parametrize(("target", "count"), sorted(shares(SAMPLE).items()))
def test_damaged_files_are_refused_in_one_line_or_read_whole(
    child: Child, target: str, count: int
) -> None:
    faults = [r for r in child.run(target, 0, max(count, 5)) if r.outcome == "fault"]
    assert faults == []


@pytest.mark.parametrize("fault", FAULTS, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_a_fault_once_found_stays_mended(child: Child, fault: Path) -> None:
    result = child.replay(fault.parent.name, fault)
    assert result.outcome != "fault", result.text
