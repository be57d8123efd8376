from __future__ import annotations

import io

import pytest
from rich.console import Console

from recast.core import diagnostics
from recast.core.diagnostics import ProgressBar, time_left


def test_time_left_in_words() -> None:
    assert time_left(0.4) == "0:00 left"
    assert time_left(245) == "4:05 left"
    assert time_left(9000) == "2:30:00 left"


def test_finished_pictures_of_an_earlier_run_cost_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 10.0])
    monkeypatch.setattr(diagnostics.time, "monotonic", lambda: next(clock))
    bar = ProgressBar("pictures", Console(file=io.StringIO()))
    bar(50, 100)
    bar(60, 100)
    assert bar._bars.tasks[0].fields["left"] == "0:40 left"
