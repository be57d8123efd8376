from __future__ import annotations

import io

from rich.console import Console

from recast.reconstruction import TrainingStatus
from recast.runs.display import TrainingDisplay, describe

STATUS = TrainingStatus(
    "train",
    50,
    200,
    gaussians=123456,
    loss=0.0512,
    psnr=21.5,
    held_out_psnr=20.25,
    iterations_per_second=11.52,
    seconds_left=95.2,
)


def test_one_line_with_the_known_figures() -> None:
    assert describe(STATUS) == (
        "123,456 Gaussians, loss 0.0512, train 21.50 dB, held out 20.25 dB, 11.5 it/s, 1:35 left"
    )
    assert describe(TrainingStatus("initialise", 0, 200)) == ""


def test_display_shows_phase_count_and_figures() -> None:
    stream = io.StringIO()
    console = Console(file=stream, width=120, force_terminal=False)
    with TrainingDisplay(console) as display:
        display(STATUS)
    shown = stream.getvalue()
    assert "train" in shown and "50/200" in shown and "held out 20.25 dB" in shown
