from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from recast.core.errors import InputError
from recast.recar import begin_set, read_set, write_identity
from support.vehicle_sets import (
    HEIGHT,
    VIEWS,
    WIDTH,
    identity_record,
    pictures,
    set_record,
    tree,
    write_set,
)


def edit(path: Path, **changes: Any) -> None:
    record = json.loads(path.read_text())
    record.update(changes)
    path.write_text(json.dumps({k: v for k, v in record.items() if v != "REMOVE"}))


def test_a_set_comes_back_as_it_was_written(tmp_path: Path) -> None:
    written = write_set(tmp_path / "set")
    assert list(written.identities) == ["car-0", "car-1", "car-2"]
    assert written.record == set_record()
    for index, identity in enumerate(written.identities.values()):
        assert identity.record == identity_record(index)
        for view, picture in enumerate(pictures(index)):
            assert np.array_equal(identity.view(view), picture)
    written.check_pictures(decode=True)
    splits = [one.record.id for one in written.of_split("held-out")]
    assert splits == ["car-1"]


def test_colour_is_straight_and_black_without_alpha(tmp_path: Path) -> None:
    image = pictures(0)[0]
    image[0, 0] = (9, 9, 9, 0)
    record = set_record(1, azimuths_deg=(0.0,))
    begin_set(tmp_path, record, ["car-0"])
    write_identity(tmp_path, record, identity_record(0), [image])
    back = cv2.imread(str(tmp_path / "car-0" / "view_00.png"), cv2.IMREAD_UNCHANGED)
    assert tuple(back[0, 0]) == (0, 0, 0, 0)
    assert tuple(back[10, 40]) == (0, 0, 200, 128)


def test_a_photographed_vehicle_needs_no_camera_and_no_size(tmp_path: Path) -> None:
    record = set_record(1, elevation_deg=None, fov_deg=None)
    begin_set(tmp_path, record, ["car-0"])
    unknown = identity_record(0, size=None, distance_m=None, colour=None)
    write_identity(tmp_path, record, unknown, pictures(0))
    edit(tmp_path / "set.json", complete=True)
    identity = read_set(tmp_path).identities["car-0"]
    assert identity.record.size is None
    with pytest.raises(ValueError, match="no camera without"):
        identity.camera(0)


def spoil_png(folder: Path, **arrays: Any) -> None:
    path = folder / "car-1" / "view_02.png"
    cv2.imwrite(str(path), arrays["image"])


def copy_identity(folder: Path, **changes: Any) -> None:
    shutil.copytree(folder / "car-0", folder / "copy")
    edit(folder / "copy" / "identity.json", **changes)
    edit(folder / "set.json", identities=4)


FULL = np.full((HEIGHT, WIDTH, 4), 255, np.uint8)
FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "view missing": (lambda f: (f / "car-1/view_02.png").unlink(), "view_02.png: view: is missing"),
    "other size": (lambda f: spoil_png(f, image=FULL[:, :-1]), "view_02.png: size: is 47x32"),
    "no alpha": (lambda f: spoil_png(f, image=FULL[..., :3]), "view_02.png: alpha: is absent"),
    "grey": (lambda f: spoil_png(f, image=FULL[..., 0]), "view_02.png: alpha: is absent"),
    "transparent": (lambda f: spoil_png(f, image=FULL * [1, 1, 1, 0]), "alpha: is zero everywhere"),
    "no PNG": (lambda f: (f / "car-1/view_02.png").write_bytes(b"GIF89a" * 9), "is not a PNG file"),
    "cut short": (
        lambda f: (f / "car-1/view_02.png").write_bytes(
            (f / "car-1/view_02.png").read_bytes()[:60]
        ),
        "view_02.png: view: cannot be decoded",
    ),
    "twice": (copy_identity, "car-0 is in the set twice, also as car-0"),
    "both splits": (lambda f: copy_identity(f, split="held-out"), "car-0 is in both splits"),
    "folder name": (lambda f: copy_identity(f, id="other"), "is 'other' in the folder 'copy'"),
    "bad id": (lambda f: edit(f / "car-0/identity.json", id="../x"), "identity.json: id:"),
    "bad split": (lambda f: edit(f / "car-0/identity.json", split="test"), "split:"),
    "bad size": (lambda f: edit(f / "car-0/identity.json", size=[4, 0, 1]), "size.1:"),
    "unknown field": (lambda f: edit(f / "car-0/identity.json", make="x"), "make: Extra inputs"),
    "missing field": (lambda f: edit(f / "set.json", licence="REMOVE"), "licence: Field required"),
    "version": (lambda f: edit(f / "set.json", version=2), "version: is 2, this recast reads 1"),
    "format": (lambda f: edit(f / "set.json", format="log"), "format: is 'log'"),
    "irregular": (
        lambda f: edit(f / "set.json", azimuths_deg=[0, 90, 180, 271]),
        "azimuths_deg: Value error, azimuths are not regular: view 3 at 271 degrees, expected 270",
    ),
    "clockwise": (lambda f: edit(f / "set.json", azimuths_deg=[0, 270, 180, 90]), "not regular"),
    "in the making": (lambda f: edit(f / "set.json", complete=False), "is not complete"),
    "identity lost": (lambda f: shutil.rmtree(f / "car-2"), "2 folders, but set.json counts 3"),
    "no set.json": (lambda f: (f / "set.json").unlink(), "set.json: file: is missing"),
    "no folder": (shutil.rmtree, "vehicle set: is missing"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_one_clear_line(tmp_path: Path, fault: str) -> None:
    folder = tmp_path / "set"
    write_set(folder)
    spoil, message = FAULTS[fault]
    spoil(folder)
    with pytest.raises(InputError) as error:
        read_set(folder).check_pictures(decode=True)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_azimuths_may_begin_anywhere(tmp_path: Path) -> None:
    write_set(tmp_path / "set")
    edit(tmp_path / "set" / "set.json", azimuths_deg=[350, 80, 170, 260])
    assert read_set(tmp_path / "set").record.azimuths_deg[0] == 350


def test_headers_alone_find_size_and_missing_alpha(tmp_path: Path) -> None:
    made = write_set(tmp_path / "set")
    calls: list[tuple[int, int]] = []
    made.check_pictures(progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (3 * VIEWS, 3 * VIEWS)
    spoil_png(made.folder, image=FULL[..., :3])
    with pytest.raises(InputError, match="alpha: is absent"):
        made.check_pictures()


@pytest.mark.parametrize("spoil", ["too few", "too many", "shape", "transparent"])
def test_wrong_pictures_leave_nothing_behind(tmp_path: Path, spoil: str) -> None:
    record = set_record(1)
    begin_set(tmp_path, record, ["car-0"])
    images = pictures(0, VIEWS + {"too few": -1, "too many": 1}.get(spoil, 0))
    if spoil == "shape":
        images[2] = images[2][:, :-1]
    if spoil == "transparent":
        images[2][..., 3] = 0
    with pytest.raises(ValueError, match="car-0"):
        write_identity(tmp_path, record, identity_record(0), images)
    assert [path.name for path in tmp_path.iterdir()] == ["set.json"]


def test_the_same_set_is_the_same_bytes(tmp_path: Path) -> None:
    assert tree(write_set(tmp_path / "a").folder) == tree(write_set(tmp_path / "b").folder)
