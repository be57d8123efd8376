from __future__ import annotations

import io

import pytest
from rich.console import Console

from recast.core import diagnostics
from recast.core.diagnostics import ProgressBar, time_left
from recast.reconstruction import TrainingStatus
from recast.runs.display import SamplingProgress, TrainingDisplay
from support.terminal import in_terminal, plain


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


def test_a_pipe_gets_a_plain_line_of_what_was_done() -> None:
    console = Console(file=io.StringIO(), width=80)
    with ProgressBar("steps", console, 20):
        pass
    with pytest.raises(ValueError, match="stop"), ProgressBar("images", console, 9) as bar:
        bar.advance()
        raise ValueError("stop")
    with SamplingProgress(console) as stages:
        stages("structure", 0, 25)
        stages("latent", 25, 25)
    with TrainingDisplay(console) as display:
        display(TrainingStatus("train", 3, 9, gaussians=1200))
    written = console.file.getvalue()  # type: ignore[attr-defined]
    assert written.splitlines() == [
        "  images 1/9",
        "  latent 25/25",
        "  scene: train 3/9  1,200 Gaussians",
    ]


def test_a_terminal_keeps_no_bar_on_which_nothing_was_done() -> None:
    code = """
from recast.core.diagnostics import ProgressBar
with ProgressBar("idle", total=20):
    pass
with ProgressBar("busy", total=20) as bar:
    bar(20, 20)
print("end")
"""
    ended, shown = in_terminal([], code=code)
    before, erased, rest = shown.partition("\x1b[2K")
    assert ended == 0 and "idle" in before and erased and "20/20" in rest
    assert "idle" not in rest.rpartition("\x1b[2K")[2] and plain(shown)[-1] == "end"
