"""An import that ends midway, of any dataset, leaves nothing, and the next one succeeds."""

from __future__ import annotations

import errno
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from recast.errors import InputError
from recast.logs import read_log, watch_writing
from recast.logs.importers import IMPORTERS
from recast.logs.importers.kitti import import_kitti
from support import (
    tiny_argoverse2,
    tiny_drive,
    tiny_nuscenes,
    tiny_processed,
    tiny_py123d,
    tiny_waymo,
    tiny_waymo2,
)

Import = Callable[[Path], None]
"""Import into a folder."""


def _prepared(name: str, root: Path, request: pytest.FixtureRequest) -> Import:
    """A written drive of the dataset, to be imported."""
    load = partial(IMPORTERS.load, name)
    monkeypatch = request.getfixturevalue("monkeypatch")
    if name == "kitti":
        drive = request.getfixturevalue("tiny_drive")
        # Matching sweeps and finding the road take seconds, before anything is written.
        monkeypatch.setattr("recast.logs.importers.kitti.ego_path", lambda _: None)
        return lambda out: import_kitti(
            drive.root, tiny_drive.DRIVE, out, drive.labels, refine=False
        )
    if name == "argoverse2":
        tiny_argoverse2.write_tiny_log(root)
        return lambda out: load()(root, tiny_argoverse2.LOG, out)
    if name == "nuscenes":
        tiny_nuscenes.write_tiny_nuscenes(root)
        return lambda out: load()(root, tiny_nuscenes.SCENE, out)
    if name == "py123d":
        tiny_py123d.install(monkeypatch, root, tiny_py123d.Scene())
        return lambda out: load()(root, tiny_py123d.NAME, out)
    if name.startswith("waymo"):
        (tiny_waymo if name == "waymo" else tiny_waymo2).write_segment(root / "training")
        return lambda out: load()(root, tiny_waymo.NAME, out)
    if name == "drivestudio":
        tiny_processed.write_drivestudio(root)
    else:
        tiny_processed.write_street_gaussians(root)
    return lambda out: load()(root, tiny_processed.SCENE, out)


@pytest.mark.parametrize("name", sorted(IMPORTERS.built_in))
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
        with watch_writing(partial(end, share, error)), pytest.raises(seen):
            run(folder / "log")
        assert list(folder.iterdir()) == []
    assert len(totals) == 3 and totals[0] > 3
    # A killed import cannot clean up; the next one into the same folder does.
    (folder / ".log.partial" / "camera").mkdir(parents=True)
    (folder / ".log.partial" / "camera" / "half").write_bytes(b"half")
    run(folder / "log")
    assert [path.name for path in folder.iterdir()] == ["log"]
    assert not (folder / "log" / "camera").exists()
    read_log(folder / "log")
