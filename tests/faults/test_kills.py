"""Commands that are killed: the same command goes on, and ends with the same bytes."""

from __future__ import annotations

from pathlib import Path

import pytest

from faults.small_run import small_run
from recast.core import files
from support.children import KILL, Fault
from support.moments import killed_before
from support.unbroken import Unbroken, contents, kept, stamps

pytestmark = pytest.mark.whole

WHOLE_RUN = (
    ("os.rename run/run.json", ""),
    ("os.rename store/store.json", ""),
    ("os.rename {part}/data/source.json", "scene/recast"),
    ("os.rename {part}/data/config.json", "scene/recast"),
    ("os.rename {part}/data/work/initialisation.safetensors", "scene/recast"),
    ("os.rename {part}/data/scene.json", "scene/recast"),
    ("os.remove {part}/data/work/initialisation.safetensors", "scene/recast"),
    ("os.rename {part}/artefact.json", "scene/recast"),
    ("os.rename {whole}", "scene/recast"),
    ("os.rename store/users/", ""),
    ("os.symlink run/scenes/recast", ""),
    ("os.rename {whole}", "evaluation/recast"),
    ("open {part}/data/.observation.partial/frame.png", "registered/replaced"),
    ("os.rename {part}/data/actor", "registered/replaced"),
    ("os.rename {whole}", "registered/replaced"),
    ("os.rename {part}/data/refinement.safetensors", "actor/replaced"),
    ("os.remove {part}/data/refinement.safetensors", "actor/replaced"),
    ("os.rename {part}/artefact.json", "actor/replaced"),
    ("os.rename {part}/data/turntable.mp4", "turntable/replaced"),
    ("os.rename {part}/data/image_02.mp4", "rollout/advancing-a/idm-follower/native"),
    ("os.rename {whole}", "rollout/advancing-a/idm-follower/replaced"),
    ("os.symlink run/rollouts/advancing-a/idm-follower/replaced", ""),
    ("os.rename run/metrics.json", ""),
    ("os.rename run/report", ""),
)
"""Moments, and the use of the artefact whose folder in the store they name."""


def test_a_run_that_is_killed_at_every_step(finished: Unbroken, tmp_path: Path) -> None:
    """Each try goes on where the last one was killed."""
    out = tmp_path / "1" / "run"
    out.parent.mkdir()
    before: dict[Path, int] = {}
    for moment, use in WHOLE_RUN:
        whole = finished.place(use).relative_to(finished.out.parent)
        part = whole.with_name(f".{whole.name}.partial")
        words = moment.format(whole=whole, part=part)
        assert any(words in one for one in finished.moments), words
        ended = finished.again(out, Fault(out.parent, KILL, words))
        assert ended.code == KILL, (words, ended.err)
        assert kept(before, out)
        before = stamps(out)
    assert finished.again(out).code == 0
    assert kept(before, out) and finished.same(out)


@pytest.mark.parametrize("step", ["rollout/advancing-a/idm-follower/replaced", "report"])
def test_a_step_that_is_killed_at_ten_moments(
    finished: Unbroken, tmp_path: Path, step: str
) -> None:
    """Moments spread evenly over all changes that a command makes which has this step to do."""
    changes = len(finished.again(finished.without(step, tmp_path / "0")).moments)
    assert changes > 30
    out = finished.without(step, tmp_path / "1")
    before = stamps(out)
    for tenth in range(10):
        at = 1 + changes * tenth // 10
        ended = finished.again(out, Fault(out.parent, KILL, at))
        assert ended.code == KILL, (at, ended.err)
    assert finished.again(out).code == 0
    assert kept(before, out) and finished.same(out)


def test_a_finished_run_that_is_killed_while_a_part_is_made_again_keeps_the_others(
    finished: Unbroken, tmp_path: Path
) -> None:
    """The record and the links still lead to all that was finished."""
    step = "evaluation/recast"
    out = finished.without(step, tmp_path / "1")
    assert finished.again(out, Fault(out.parent, KILL, 5)).code == KILL
    found, whole = (files.read_json(run / "run.json")["artefacts"] for run in (out, finished.out))
    assert found == {use: name for use, name in whole.items() if use != step}
    assert contents(finished.out).keys() == contents(out).keys()


def test_every_change_of_a_run_folder_and_its_store(tmp_path: Path) -> None:
    """Killed before each change in turn: the next try goes on and ends with the same bytes."""
    whole = contents(small_run(tmp_path / "whole"))
    change, went_on = 0, True
    while went_on:
        folder = tmp_path / str(change)
        went_on = killed_before(change, lambda to=folder: small_run(to), folder)
        before = stamps(folder / "run")
        assert contents(small_run(folder)) == whole
        assert kept(before, folder / "run")
        change += 1
    assert change > 60


def test_a_grid_that_is_killed_ten_times(finished_grid: Unbroken, tmp_path: Path) -> None:
    """Each try goes on where the last one was killed, and makes a twelfth of all changes."""
    out, at = tmp_path / "1" / "grid", len(finished_grid.moments) // 12
    out.parent.mkdir()
    assert at > 1
    for _ in range(10):
        ended = finished_grid.again(out, Fault(out.parent, KILL, at))
        assert ended.code == KILL, ended.err
    assert finished_grid.again(out).code == 0
    assert finished_grid.same(out)
