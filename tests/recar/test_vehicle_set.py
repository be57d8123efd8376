"""Vehicle sets: written, read and refused; cameras, split and figures."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from recast.cameras import box_rectangle
from recast.core.errors import InputError
from recast.geometry import se3
from recast.recar import (
    Identity,
    begin_set,
    camera_pose,
    finish_set,
    fitting_distance,
    pinhole,
    read_set,
    set_statistics,
    split_of,
    statistics_table,
    write_identity,
)
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


IDS = ["car-0", "car-1", "car-2"]


def test_a_set_in_the_making_is_marked_and_goes_on(tmp_path: Path) -> None:
    record = set_record()
    assert begin_set(tmp_path / "set", record, IDS) == frozenset()
    write_identity(tmp_path / "set", record, identity_record(0), pictures(0))
    (tmp_path / "set" / ".car-1.partial").mkdir()
    (tmp_path / "set" / ".car-1.partial" / "view_00.png").write_bytes(b"cut")
    with pytest.raises(InputError, match="is not complete"):
        read_set(tmp_path / "set")
    assert begin_set(tmp_path / "set", record, IDS) == {"car-0"}
    for index in (1, 2):
        write_identity(tmp_path / "set", record, identity_record(index), pictures(index))
    finish_set(tmp_path / "set", record)
    assert tree(tmp_path / "set") == tree(write_set(tmp_path / "whole").folder)


def test_a_finished_set_stays_finished(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    assert begin_set(tmp_path, made.record, IDS) == set(IDS)
    assert read_set(tmp_path).record.complete


def test_a_set_grows_and_keeps_its_split(tmp_path: Path) -> None:
    small = write_set(tmp_path, 2)
    record = set_record(3)
    assert begin_set(tmp_path, record, IDS) == {"car-0", "car-1"}
    write_identity(tmp_path, record, identity_record(2), pictures(2))
    finish_set(tmp_path, record)
    grown = read_set(tmp_path)
    for name, identity in small.identities.items():
        assert grown.identities[name].record == identity.record


@pytest.mark.parametrize(
    ("changes", "field"), [({"width": 64}, "width"), ({"split_seed": 1}, "split_seed")]
)
def test_another_configuration_is_refused(
    tmp_path: Path, changes: dict[str, int], field: str
) -> None:
    before = tree(write_set(tmp_path).folder)
    with pytest.raises(InputError, match=f"{field}: differs"):
        begin_set(tmp_path, set_record(**changes), IDS)
    assert tree(tmp_path) == before


def test_settings_of_the_generator_are_named(tmp_path: Path) -> None:
    begin_set(tmp_path, set_record(1, generator={"kinds": ["van"]}), ["car-0"])
    with pytest.raises(InputError, match="kinds: differs"):
        begin_set(tmp_path, set_record(1, generator={"kinds": []}), ["car-0"])


def test_fewer_identities_are_refused(tmp_path: Path) -> None:
    write_set(tmp_path)
    with pytest.raises(InputError, match="car-2: is in the folder but not among the 2 requested"):
        begin_set(tmp_path, set_record(2), IDS[:2])


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="exists and is not a vehicle set"):
        begin_set(tmp_path, set_record(), IDS)
    with pytest.raises(InputError, match="exists and is not a vehicle set"):
        begin_set(tmp_path / "notes.txt", set_record(), IDS)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_finished_identity_that_lost_a_view_is_found(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    (tmp_path / "car-1" / "view_03.png").unlink()
    with pytest.raises(InputError, match=r"view_03\.png: view: is missing"):
        begin_set(tmp_path, made.record, IDS)


def test_an_identity_is_never_written_over(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    with pytest.raises(InputError, match="exists already"):
        write_identity(tmp_path, made.record, identity_record(0), pictures(1))


def test_the_split_in_the_tests_is_the_one_of_the_library() -> None:
    assert identity_record(1).split == split_of("car-1", 0, index=1) == "held-out"


@given(st.text(min_size=1, max_size=20), st.integers(0, 2**40), st.floats(0, 1), st.floats(0, 1))
def test_a_larger_share_only_adds_to_the_held_out(
    name: str, seed: int, first: float, second: float
) -> None:
    small, large = sorted((first, second))
    if split_of(name, seed, small) == "held-out":
        assert split_of(name, seed, large) == "held-out"


def test_the_share_is_kept_and_the_seed_matters() -> None:
    names = [f"vehicle-{i:05d}" for i in range(20000)]
    first = np.array([split_of(name, 0) == "held-out" for name in names])
    second = np.array([split_of(name, 1) == "held-out" for name in names])
    assert abs(first.mean() - 0.05) < 0.005  # 3 standard deviations of 20,000 draws
    assert abs((first & second).mean() - 0.0025) < 0.0012


def test_the_decision_is_the_same_for_ever() -> None:
    # A set on disk keeps its split with every later version: these never change.
    held = [i for i in range(120) if split_of(f"vehicle-{i:05d}", 0) == "held-out"]
    assert held == [26, 39, 47, 53, 65, 75, 101]


def test_small_sets_have_both_parts() -> None:
    for seed in range(50):
        assert split_of("vehicle-00000", seed, index=0) == "train"
        assert split_of("vehicle-00001", seed, index=1) == "held-out"
    assert split_of("a", 0, 0.0, index=1) == "train"


FRONT, LEFT, TOP = np.array([2.0, 0, 0]), np.array([0, 0.9, 0]), np.array([0, 0, 0.7])


def pixel(point: np.ndarray, view: int) -> np.ndarray:
    record = set_record(1)
    camera, actor_from_camera = Identity(Path(), identity_record(0), record).camera(view)
    pixels, depth = camera.project(se3.apply(se3.inverse(actor_from_camera), point[None]))
    assert depth[0] > 0
    return pixels[0]


def test_from_ahead_the_left_side_is_to_the_right() -> None:
    centre = pixel(np.zeros(3), 0)
    assert centre == pytest.approx([24.0, 16.0])
    assert pixel(LEFT, 0)[0] > 24.0
    assert pixel(FRONT, 0)[0] == pytest.approx(24.0)
    assert pixel(FRONT, 0)[1] > 16.0  # nearer, below the line of sight
    assert pixel(TOP, 0)[1] < 16.0


def test_from_the_left_the_front_points_left() -> None:
    assert pixel(FRONT, 1)[0] < 24.0
    assert pixel(LEFT, 1)[0] == pytest.approx(24.0)


def test_from_behind_and_from_the_right() -> None:
    assert pixel(LEFT, 2)[0] < 24.0
    assert pixel(FRONT, 3)[0] > 24.0


def test_the_camera_stands_where_azimuth_and_elevation_say() -> None:
    _, pose = Identity(Path(), identity_record(0), set_record(1)).camera(1)
    expected = 8.0 * np.array([0, np.cos(np.radians(15)), np.sin(np.radians(15))])
    assert pose[:3, 3] == pytest.approx(expected)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


def test_the_angle_of_view_is_across_the_width() -> None:
    camera = pinhole(1200, 800, 40.0)
    edge = camera.rays([[0.0, 400.0]])[0]
    assert np.degrees(np.arctan(-edge[0])) == pytest.approx(20.0)
    assert camera.fx == camera.fy


def test_a_view_that_is_not_there() -> None:
    with pytest.raises(IndexError, match="views 0 to 3"):
        Identity(Path(), identity_record(0), set_record(1)).camera(4)


@settings(deadline=None, max_examples=15)
@given(
    st.tuples(st.floats(1, 14), st.floats(0.5, 3), st.floats(0.5, 4)),
    st.sampled_from([(1200, 800), (256, 256), (60, 200)]),
    st.floats(-30, 60),
    st.integers(0, 359),
)
def test_the_box_fits_with_its_margin_and_no_more(
    size: tuple[float, float, float], pixels: tuple[int, int], elevation: float, azimuth: int
) -> None:
    camera = pinhole(*pixels, 40.0)
    distance = fitting_distance(size, camera, elevation, margin=0.05)

    def room(azimuth: float, at: float) -> float:
        """Least share of the image between the box and an edge."""
        rectangle = box_rectangle(size, se3.inverse(camera_pose(azimuth, elevation, at)), camera)
        assert rectangle is not None
        shares = rectangle / np.tile([camera.width, camera.height], 2)
        return float(min(shares[0], shares[1], 1 - shares[2], 1 - shares[3]))

    assert room(float(azimuth), distance) > 0.05 - 1e-9
    tightest = min(room(float(degrees), distance) for degrees in range(91))
    assert tightest == pytest.approx(0.05, abs=1e-6)


def test_the_numbers_of_a_small_set(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    found = set_statistics(made)
    assert (found.identities, found.pictures) == (3, 3 * VIEWS)
    assert found.splits == {"train": 2, "held-out": 1}
    assert list(found.kinds.items()) == [("sedan", 2), ("van", 1)]
    assert list(found.colours.items()) == [("white", 2), ("red", 1)]
    assert found.sizes is not None
    assert found.sizes[0] == pytest.approx((4.5, 1.8, 1.5))
    assert found.sizes[1][0] == pytest.approx(4.6)
    assert found.sizes[2][0] == pytest.approx(4.7)
    assert found.bytes == sum(p.stat().st_size for p in tmp_path.rglob("*.png"))


def test_the_table_says_it_in_words(tmp_path: Path) -> None:
    made = write_set(tmp_path)
    printer = Console(width=100, record=True, file=io.StringIO())
    printer.print(statistics_table(made, set_statistics(made)))
    text = printer.export_text()
    assert "2 train, 1 held out" in text
    assert "4 per identity, 48x32, 12 images" in text
    assert "sedan" in text
    assert "66.7 %" in text
    assert "4.60 m median, 4.50 to 4.70" in text
