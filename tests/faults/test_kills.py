"""Commands that are killed: the same command goes on, and ends with the same bytes."""

from __future__ import annotations

from pathlib import Path

import pytest

from faults.children import KILL, Fault
from faults.conftest import Unbroken

WHOLE_RUN = (
    "os.rename run/run.json",
    "open run/.observation.partial/frame.png",
    "os.rename run/scene/source.json",
    "os.rename run/scene/config.json",
    "os.rename run/scene/work/initialisation.safetensors",
    "os.rename run/scene/scene.json",
    "os.remove run/scene/work/initialisation.safetensors",
    "os.rename run/refined",
    "os.rename run/turntable.mp4",
    "os.rename run/timings.json",
    "os.rename run/evaluation",
    "os.rename run/rollouts/advancing-a/replaced",
    "os.rename run/metrics.json",
    "os.rename run/report",
)


def test_a_run_that_is_killed_at_every_step(finished: Unbroken, tmp_path: Path) -> None:
    """Each try goes on where the last one was killed."""
    out = tmp_path / "run"
    for moment in WHOLE_RUN:
        assert any(moment in one for one in finished.moments), moment
        ended = finished.again(out, Fault(tmp_path, KILL, moment))
        assert ended.code == KILL, (moment, ended.err)
    assert finished.again(out).code == 0
    assert finished.same(out)


@pytest.mark.parametrize("step", ["rollout-advancing-a-replaced", "report"])
def test_a_step_that_is_killed_at_ten_moments(
    finished: Unbroken, tmp_path: Path, step: str
) -> None:
    """Moments spread evenly over all changes that a command makes which has this step to do."""
    changes = len(finished.again(finished.without(step, tmp_path / "first")).moments)
    assert changes > 30
    out = finished.without(step, tmp_path)
    for tenth in range(10):
        at = 1 + changes * tenth // 10
        ended = finished.again(out, Fault(tmp_path, KILL, at))
        assert ended.code == KILL, (at, ended.err)
    assert finished.again(out).code == 0
    assert finished.same(out)


def test_a_grid_that_is_killed_ten_times(finished_grid: Unbroken, tmp_path: Path) -> None:
    """Each try goes on where the last one was killed, and makes a twelfth of all changes."""
    out, at = tmp_path / "grid", len(finished_grid.moments) // 12
    assert at > 1
    for _ in range(10):
        ended = finished_grid.again(out, Fault(tmp_path, KILL, at))
        assert ended.code == KILL, ended.err
    assert finished_grid.again(out).code == 0
    assert finished_grid.same(out)
