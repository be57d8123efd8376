from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from recast.cameras import box_rectangle
from recast.core.errors import InputError
from recast.geometry import se3
from recast.recar import SynthesisSettings, VehicleSet, read_set, synthesize_set
from support.vehicle_sets import tree

pytest.importorskip("embreex")

TINY = SynthesisSettings(seed=3, views=4, width=48, height=32)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> VehicleSet:
    """Three vehicles and a shape, made in one go by one process."""
    return synthesize_set(tmp_path_factory.mktemp("whole") / "set", 3, TINY, shapes=1)


def test_what_was_asked_for_is_there(whole: VehicleSet) -> None:
    whole.check_pictures(decode=True)
    names = ["shape-00000", "vehicle-00000", "vehicle-00001", "vehicle-00002"]
    assert list(whole.identities) == names
    records = [one.record for one in whole.identities.values()]
    assert {record.split for record in records} == {"train", "held-out"}
    assert records[0].category == "misc"
    assert all(record.size is not None for record in records)
    assert len({record.distance_m for record in records}) == 4
    assert whole.record.azimuths_deg == (0, 90, 180, 270)
    assert not [path for path in whole.folder.iterdir() if path.name.startswith(".")]


def test_every_view_shows_the_whole_vehicle(whole: VehicleSet) -> None:
    for identity in whole.identities.values():
        for view in range(4):
            alpha = identity.view(view)[..., 3]
            edge = np.concatenate([alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]])
            assert not edge.any()
            assert (alpha == 255).mean() > 0.05


def test_a_killed_run_resumes_to_the_same_bytes(whole: VehicleSet, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(whole.folder, folder)
    shutil.rmtree(folder / "vehicle-00001")
    (folder / "shape-00000").rename(folder / ".shape-00000.partial")
    (folder / ".shape-00000.partial" / "view_03.png").write_bytes(b"cut")
    record = json.loads((folder / "set.json").read_text()) | {"complete": False}
    (folder / "set.json").write_text(json.dumps(record))
    kept = (folder / "vehicle-00002" / "view_00.png").stat().st_mtime_ns
    calls: list[tuple[int, int]] = []
    synthesize_set(folder, 3, TINY, shapes=1, progress=lambda *call: calls.append(call))
    assert tree(folder) == tree(whole.folder)
    assert calls[0] == (8, 16)
    assert calls[-1] == (16, 16)
    assert (folder / "vehicle-00002" / "view_00.png").stat().st_mtime_ns == kept


def test_two_processes_make_a_grown_set_of_the_same_bytes(
    whole: VehicleSet, tmp_path: Path
) -> None:
    folder = tmp_path / "set"
    shutil.copytree(whole.folder, folder)
    for name in ("vehicle-00002", "shape-00000"):
        shutil.rmtree(folder / name)
    record = json.loads((folder / "set.json").read_text()) | {"identities": 2}
    (folder / "set.json").write_text(json.dumps(record))
    calls: list[tuple[int, int]] = []
    synthesize_set(folder, 3, TINY, shapes=1, workers=2, progress=lambda *c: calls.append(c))
    assert tree(folder) == tree(whole.folder)
    assert calls[-1] == (16, 16)


def test_another_seed_gives_other_vehicles(whole: VehicleSet, tmp_path: Path) -> None:
    other = synthesize_set(tmp_path / "set", 1, SynthesisSettings(4, 4, 48, 32))
    first, second = (one.identities["vehicle-00000"].record for one in (whole, other))
    assert first.size != second.size


def test_only_the_kinds_asked_for(tmp_path: Path) -> None:
    made = synthesize_set(tmp_path / "set", 2, SynthesisSettings(0, 1, 48, 32, ("bus",)))
    assert {one.record.kind for one in made.identities.values()} == {"bus"}


@pytest.fixture
def block(tmp_path: Path) -> Path:
    """A mesh that fills its box, glTF axes: y up, facing +z."""
    path = tmp_path / "block.glb"
    trimesh.creation.box((1.8, 1.5, 4.4)).export(path)
    return path


def test_the_silhouette_is_where_the_camera_says(block: Path, tmp_path: Path) -> None:
    settings = SynthesisSettings(views=4, width=240, height=160)
    made = synthesize_set(tmp_path / "set", 0, settings, meshes=[block])
    (identity,) = made.identities.values()
    assert identity.record.source == "block.glb"
    size = identity.record.size
    assert size == pytest.approx((4.4, 1.8, 1.5))
    for view in range(4):
        camera, actor_from_camera = identity.camera(view)
        expected = box_rectangle(size, se3.inverse(actor_from_camera), camera)
        assert expected is not None
        rows, columns = np.nonzero(identity.view(view)[..., 3] > 127)
        found = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
        assert np.abs(found - expected).max() < 1.0


def test_other_axes_are_another_identity(block: Path, tmp_path: Path) -> None:
    synthesize_set(tmp_path / "set", 0, TINY, meshes=[block])
    with pytest.raises(InputError, match="not among the 1 requested"):
        synthesize_set(tmp_path / "set", 0, TINY, meshes=[block], mesh_axes="-z,y")
    with pytest.raises(InputError, match="`mesh_axes`"):
        synthesize_set(tmp_path / "set", 0, TINY, meshes=[block], mesh_axes="z")


def test_a_mesh_is_checked_before_any_work(block: Path, tmp_path: Path) -> None:
    mesh = trimesh.load(block, force="mesh")
    mesh.update_faces(np.arange(len(mesh.faces)) > 1)
    mesh.export(tmp_path / "open.glb")
    with pytest.raises(InputError, match="watertight"):
        synthesize_set(tmp_path / "set", 1, TINY, meshes=[block, tmp_path / "open.glb"])
    with pytest.raises(InputError, match="given twice"):
        synthesize_set(tmp_path / "set", 1, TINY, meshes=[block, block])
    with pytest.raises(InputError, match="is missing"):
        synthesize_set(tmp_path / "set", 1, TINY, meshes=[tmp_path / "none.glb"])
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("settings", "counts", "option"),
    [
        (TINY, {"vehicles": -1}, "`vehicles`"),
        (TINY, {"vehicles": 0}, "`vehicles`"),
        (TINY, {"vehicles": 1, "shapes": -1}, "`shapes`"),
        (TINY, {"vehicles": 1, "workers": 0}, "`workers`"),
        (SynthesisSettings(width=0), {"vehicles": 1}, "`width`"),
        (SynthesisSettings(height=100_000), {"vehicles": 1}, "`height`"),
        (SynthesisSettings(views=0), {"vehicles": 1}, "`views`"),
        (SynthesisSettings(seed=-1), {"vehicles": 1}, "`seed`"),
        (SynthesisSettings(kinds=("tank",)), {"vehicles": 1}, "`kinds`: tank"),
        (SynthesisSettings(licence=" "), {"vehicles": 1}, "`licence`"),
    ],
)
def test_impossible_wishes(
    settings: SynthesisSettings, counts: dict[str, int], option: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as error:
        synthesize_set(tmp_path / "set", settings=settings, **counts)
    assert str(error.value).startswith(option)
    assert not (tmp_path / "set").exists()


def test_a_set_of_other_settings_is_left_alone(whole: VehicleSet) -> None:
    before = tree(whole.folder)
    with pytest.raises(InputError, match="seed: differs"):
        synthesize_set(whole.folder, 3, SynthesisSettings(4, 4, 48, 32), shapes=1)
    assert tree(whole.folder) == before
    assert read_set(whole.folder).record.complete
