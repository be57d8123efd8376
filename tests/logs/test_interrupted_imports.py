"""An import that ends midway, of any dataset, leaves nothing, and the next one succeeds."""

from __future__ import annotations

import errno
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from recast.core.errors import InputError
from recast.logs import read_log
from recast.logs.importers import IMPORTERS
from support import (
    tiny_argoverse2,
    tiny_drive,
    tiny_nuscenes,
    tiny_processed,
    tiny_py123d,
    tiny_waymo,
    tiny_waymo2,
)
from support.importing import import_drive

Import = Callable[..., None]
"""Import into a folder, with a progress callback."""


def _prepared(name: str, root: Path, request: pytest.FixtureRequest) -> Import:
    """A written drive of the dataset, to be imported."""
    monkeypatch = request.getfixturevalue("monkeypatch")
    if name == "kitti":
        drive = request.getfixturevalue("tiny_drive")
        # Matching sweeps and finding the road take seconds, before anything is written.
        quick = {"labels": drive.labels, "refine": False, "with_map": False}
        return partial(import_drive, name, drive.root, tiny_drive.DRIVE, **quick)
    if name == "argoverse2":
        tiny_argoverse2.write_tiny_log(root)
        return partial(import_drive, name, root, tiny_argoverse2.LOG)
    if name == "nuscenes":
        tiny_nuscenes.write_tiny_nuscenes(root)
        return partial(import_drive, name, root, tiny_nuscenes.SCENE)
    if name == "py123d":
        tiny_py123d.install(monkeypatch, root, tiny_py123d.Scene())
        return partial(import_drive, name, root, tiny_py123d.NAME)
    if name.startswith("waymo"):
        (tiny_waymo if name == "waymo" else tiny_waymo2).write_segment(root / "training")
        return partial(import_drive, name, root, tiny_waymo.NAME)
    if name == "drivestudio":
        tiny_processed.write_drivestudio(root)
    else:
        tiny_processed.write_street_gaussians(root)
    return partial(import_drive, name, root, tiny_processed.SCENE)


WITHOUT_FRAMES = {"alpasim"}
"""Importers that write no image and no sweep, between which they could end."""


@pytest.mark.parametrize("name", sorted(set(IMPORTERS.names()) - WITHOUT_FRAMES))
def test_an_import_that_ends_midway_leaves_nothing(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    run = _prepared(name, tmp_path / "data", request)
    folder, totals = tmp_path / "out", []

    def end(share: float, error: BaseException, done: int, total: int) -> None:
        if done == int(share * total) > 0:
            totals.append(total)
            assert [path.name for path in folder.iterdir()] == [".log.partial"]
            raise error

    for share, error, seen in (
        (0.5, KeyboardInterrupt(), KeyboardInterrupt),
        (0.5, RuntimeError("broken"), RuntimeError),
        (1.0, OSError(errno.ENOSPC, "No space left on device"), InputError),
    ):
        with pytest.raises(seen):
            run(folder / "log", progress=partial(end, share, error))
        assert list(folder.iterdir()) == []
    assert len(totals) == 3 and totals[0] > 3
    # A killed import cannot clean up; the next one into the same folder does.
    (folder / ".log.partial" / "camera").mkdir(parents=True)
    (folder / ".log.partial" / "camera" / "half").write_bytes(b"half")
    run(folder / "log")
    assert [path.name for path in folder.iterdir()] == ["log"]
    assert not (folder / "log" / "camera").exists()
    read_log(folder / "log")
