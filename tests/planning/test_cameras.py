"""A planner's pictures on the rigs of the datasets: chosen by direction, virtual where needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.cameras import CameraMount, PinholeCamera, View
from recast.cameras.mounts import (
    Look,
    camera_pose,
    choose_views,
    directions,
    match_cameras,
    seen_by,
)
from recast.core.errors import InputError
from recast.logs.importers.waymo import load_waymo
from recast.planning import (
    ConstantVelocity,
    looked_at,
    make_planner,
    seen_lines,
    seen_record,
    shown_views,
    virtual_mounts,
)
from recast.planning.gtrs import nuplan_rig
from recast.simulation import NullRenderer, camera_mounts
from recast.simulation.scene_renderer import through_lenses
from recast.synthetic.world import make_rig

Rig = dict[str, CameraMount]


def _rig(**cameras: tuple[int, int, float, float]) -> Rig:
    """Width, height, focal length, yaw; each at a place of its own."""
    return {
        name: CameraMount(
            PinholeCamera(width, height, focal, focal, width / 2, height / 2),
            camera_pose((1.0 + 0.1 * i, 0.05 * i, 1.5 + 0.01 * i), yaw, 0.0),
        )
        for i, (name, (width, height, focal, yaw)) in enumerate(cameras.items())
    }


WAYMO = _rig(
    FRONT=(1920, 1280, 2055.0, 0.3),
    FRONT_LEFT=(1920, 1280, 2055.0, 44.9),
    FRONT_RIGHT=(1920, 1280, 2055.0, -45.2),
    SIDE_LEFT=(1920, 886, 2055.0, 89.5),
    SIDE_RIGHT=(1920, 886, 2055.0, -90.4),
)
NUSCENES = _rig(
    CAM_FRONT=(1600, 900, 1266.0, 0.2),
    CAM_FRONT_RIGHT=(1600, 900, 1260.0, -56.0),
    CAM_BACK_RIGHT=(1600, 900, 1259.0, -111.0),
    CAM_BACK=(1600, 900, 809.0, 180.0),
    CAM_BACK_LEFT=(1600, 900, 1256.0, 108.0),
    CAM_FRONT_LEFT=(1600, 900, 1272.0, 55.0),
)
ARGOVERSE = _rig(
    ring_front_center=(1550, 2048, 1686.0, 0.1),
    ring_front_left=(2048, 1550, 1686.0, 45.0),
    ring_front_right=(2048, 1550, 1686.0, -45.0),
    ring_side_left=(2048, 1550, 1686.0, 99.0),
    ring_side_right=(2048, 1550, 1686.0, -99.0),
    ring_rear_left=(2048, 1550, 1686.0, 153.0),
    ring_rear_right=(2048, 1550, 1686.0, -153.0),
    stereo_front_left=(2048, 1550, 3370.0, 0.0),
)
KITTI = _rig(image_02=(1242, 375, 721.5, 0.0))
SYNTHETIC = {
    name: CameraMount(mounted.camera, mounted.rig_from_camera)
    for name, mounted in make_rig(480, 320).cameras.items()
}
THREE = ("front_left", "front", "front_right")


class Looker(ConstantVelocity):
    """Wants what gtrs-mini wants."""

    name, needs_images = "looker", True

    def __init__(self, views: tuple[View, ...] | None = None) -> None:
        super().__init__()
        self.wanted_views = make_planner("gtrs-mini").wanted_views if views is None else views

    def choose_cameras(self, mounts: Mapping[str, CameraMount]) -> dict[str, str]:
        return choose_views(self.wanted_views, mounts)


@pytest.fixture(scope="module")
def looker() -> Looker:
    return Looker()


def test_the_pictures_of_gtrs_mini_are_the_synthetic_rigs(looker: Looker) -> None:
    for view in looker.wanted_views:
        mount = SYNTHETIC[view.name]
        assert view.off_by(mount) < 1e-4
        ours = view.mount((480, 320), mount.rig_from_camera[:3, 3])
        np.testing.assert_allclose(ours.rig_from_camera, mount.rig_from_camera, atol=1e-12)
        np.testing.assert_allclose(ours.camera.matrix, mount.camera.matrix, rtol=1e-9)


@pytest.mark.parametrize(
    ("rig", "expected"),
    [
        (WAYMO, ("FRONT_LEFT", "FRONT", "FRONT_RIGHT")),
        (NUSCENES, ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT")),
        (ARGOVERSE, ("ring_front_left", "ring_front_center", "ring_front_right")),
    ],
)
def test_cameras_by_direction_and_field(
    rig: Rig, expected: tuple[str, ...], looker: Looker
) -> None:
    """Argoverse's stereo camera looks as straight ahead as the ring's, but sees half as much."""
    wanted = {view.name: view.look for view in looker.wanted_views}
    assert tuple(match_cameras(wanted, rig).values()) == expected
    backwards = dict(reversed(rig.items()))
    assert match_cameras(wanted, backwards) == match_cameras(wanted, rig)


def test_a_camera_that_looks_down_is_ahead_of_nothing() -> None:
    down = CameraMount(
        PinholeCamera(100, 100, 50.0, 50.0, 50.0, 50.0), camera_pose((1, 0, 2), 0, -80)
    )
    assert match_cameras({"front": Look.level(0.0, 50.0)}, {"down": down}) == {}
    assert directions({"down": down}) == "down (ahead, 90 wide)" and directions({}) == "none"


@pytest.mark.parametrize("rig", [SYNTHETIC, WAYMO])
def test_cameras_that_show_the_pictures_stay_as_they_are(rig: Rig, looker: Looker) -> None:
    assert virtual_mounts(looker, rig) == {}
    shown = shown_views(looker, rig)
    assert [view.view for view in shown] == list(THREE)
    assert all(view.seen == 1.0 and not view.virtual for view in shown)
    assert rig is not SYNTHETIC or [view.camera for view in shown] == list(THREE)


@pytest.mark.parametrize(
    ("rig", "sources"),
    [
        (NUSCENES, ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT")),
        (ARGOVERSE, ("ring_front_left", "ring_front_center", "ring_front_right")),
    ],
)
def test_other_shapes_of_images_are_virtual_cameras_at_the_same_places(
    rig: Rig, sources: tuple[str, ...], looker: Looker
) -> None:
    made = virtual_mounts(looker, rig)
    assert list(made) == [f"virtual_{name}" for name in THREE]
    for mount, view, source in zip(made.values(), looker.wanted_views, sources, strict=True):
        assert mount.source == source
        place = rig[source].rig_from_camera[:3, 3]
        np.testing.assert_array_equal(mount.rig_from_camera[:3, 3], place)
        assert view.off_by(mount) == pytest.approx(0.0, abs=1e-6)
        assert mount.camera == view.camera
    shown = shown_views(looker, rig | made)
    assert all(view.virtual for view in shown)
    # The cameras' fields touch or overlap at half height, and reach beyond the cropped rows.
    assert min(view.seen for view in shown) > 0.98
    assert seen_lines(looker, rig | made)[1] is None


def test_what_one_wide_camera_sees_of_the_sides(looker: Looker) -> None:
    """Up to 45 degrees on both sides: half of each side picture, exactly."""
    rig = _rig(wide=(1000, 1000, 500.0, 0.0))
    made = virtual_mounts(looker, rig)
    left, front, right = (made[f"virtual_{name}"].seen for name in THREE)
    assert left is not None and front is not None and right is not None
    assert front.all()
    assert left[:, 240:].all() and not left[:, :240].any()
    assert right[:, :240].all() and not right[:, 240:].any()
    shown = shown_views(looker, rig | made)
    assert [view.seen for view in shown] == [0.5, 1.0, 0.5]
    assert [view.source for view in shown] == ["wide"] * 3
    said, warning = seen_lines(looker, rig | made)
    assert said == (
        "planner looker sees front_left by a virtual camera at wide (50% seen by the log's "
        "cameras); front by a virtual camera at wide (100% seen by the log's cameras); "
        "front_right by a virtual camera at wide (50% seen by the log's cameras)"
    )
    assert warning == (
        "planner looker sees black where no camera of the log looks: 50% of front_left, 50% of "
        "front_right"
    )
    assert seen_record(looker, rig | made)["views"][0] == {
        "view": "front_left",
        "camera": "virtual_front_left",
        "source": "wide",
        "virtual": True,
        "seen": 0.5,
        "width": 480,
        "height": 320,
    }


def test_kitti_sees_ahead_and_a_third_of_the_sides(looker: Looker) -> None:
    mounts = KITTI | virtual_mounts(looker, KITTI)
    left, front, right = shown_views(looker, mounts)
    # 29.1 degrees high where 27.9 of 34.7 are used: all of what the planner looks at ahead.
    assert front.seen == 1.0 and not mounts["virtual_front"].seen.all()  # type: ignore[union-attr]
    # Its edge at 40.7 degrees, in pictures whose used part spans 31.0 to 69.8 and back.
    assert left.seen == pytest.approx(right.seen) and 0.25 < left.seen < 0.4


def test_pixels_that_no_camera_sees_are_black_and_the_others_right(looker: Looker) -> None:
    class Painter(NullRenderer):
        """Each pixel's colour says where it looks; never black."""

        def render(self, state: Any, camera_names: Sequence[str]) -> dict[str, np.ndarray]:
            return {name: _painted(self.mounts[name]) for name in camera_names}

    mounts = KITTI | virtual_mounts(looker, KITTI)
    renderer = through_lenses(mounts, Painter)
    assert renderer.mounts == mounts
    images = renderer.render(None, tuple(mounts))  # type: ignore[arg-type]
    np.testing.assert_array_equal(images["image_02"], _painted(KITTI["image_02"]))
    for name in THREE:
        mount = mounts[f"virtual_{name}"]
        image, painted = images[f"virtual_{name}"], _painted(mount)
        assert image.dtype == np.uint8 and image.shape == (320, 480, 3)
        np.testing.assert_array_equal(image[mount.seen], painted[mount.seen])
        assert not image[~mount.seen].any() and painted.min() > 0  # type: ignore[operator]


def test_a_rig_that_does_not_look_ahead_is_refused(looker: Looker) -> None:
    rig = {name: NUSCENES[name] for name in ("CAM_BACK", "CAM_FRONT_LEFT")}
    message = (
        r"^planner looker: view front: looks ahead, but the log's cameras see \d+% of it \(50% is "
        r"needed\); use a log with .*there are CAM_BACK \(180 degrees left, 89 wide\), CAM_FRONT_L"
    )
    with pytest.raises(InputError, match=message):
        shown_views(looker, rig | virtual_mounts(looker, rig))
    with pytest.raises(InputError, match=r"see 0% of it .*there are none"):
        shown_views(looker, virtual_mounts(looker, {}))


def test_the_rig_that_a_planner_names_is_marked_too() -> None:
    planner = ConstantVelocity()
    planner.needs_images = True
    planner.camera_names = ("nuplan_f0", "FRONT")  # type: ignore[attr-defined]
    rig = nuplan_rig(0.1)
    made = virtual_mounts(planner, WAYMO, 0.1)
    assert list(made) == ["nuplan_f0"] and made["nuplan_f0"].source is None
    np.testing.assert_array_equal(
        made["nuplan_f0"].rig_from_camera, rig["nuplan_f0"].rig_from_camera
    )
    ahead, own = shown_views(planner, WAYMO | made)
    # Waymo's front camera is 34.6 degrees high, nuPlan's 38.5 and more at the bent corners.
    assert ahead.virtual and 0.75 < ahead.seen < 0.9
    assert (own.camera, own.virtual, own.seen) == ("FRONT", False, 1.0)
    behind = {"CAM_BACK": NUSCENES["CAM_BACK"], "FRONT": WAYMO["SIDE_LEFT"]}
    with pytest.raises(InputError, match="view nuplan_f0: looks ahead, but the log's cameras see"):
        shown_views(planner, behind | virtual_mounts(planner, behind, 0.1))


def test_virtual_cameras_join_real_ones_of_their_size(looker: Looker) -> None:
    """Front as it is, at the log's size; the sides beside it at the same, under free names."""
    rig = {"virtual_front_left": replace(SYNTHETIC["front"])}
    camera = rig["virtual_front_left"].camera.resized(240, 160)
    rig["virtual_front_left"] = replace(rig["virtual_front_left"], camera=camera)
    made = virtual_mounts(looker, rig)
    assert list(made) == ["virtual_front_left_", "virtual_front_right"]
    assert {(mount.camera.width, mount.camera.height) for mount in made.values()} == {(240, 160)}
    chosen = choose_views(looker.wanted_views, rig | made)
    assert list(chosen.values()) == [
        "virtual_front_left_",
        "virtual_front_left",
        "virtual_front_right",
    ]


def test_real_cameras_of_two_sizes_are_not_mixed(looker: Looker) -> None:
    front = SYNTHETIC["front"]
    large = replace(front, camera=front.camera.resized(960, 640))
    rig = SYNTHETIC | {"front": large}
    made = virtual_mounts(looker, rig)
    assert list(made) == ["virtual_front"] and made["virtual_front"].camera.width == 480
    chosen = choose_views(looker.wanted_views, rig | made)
    assert list(chosen.values()) == ["front_left", "virtual_front", "front_right"]


@pytest.mark.parametrize("rig", [SYNTHETIC, WAYMO, NUSCENES, ARGOVERSE, KITTI])
def test_names_say_nothing(rig: Rig, looker: Looker) -> None:
    """Any other names, the misleading ones of the planner's included: the same pictures."""
    names = [*THREE, *(f"c{i}" for i in range(8))][-len(rig) - 2 :][: len(rig)][::-1]
    renamed = dict(zip(names, rig.values(), strict=True))
    back = dict(zip(names, rig, strict=True))
    ours, theirs = virtual_mounts(looker, rig), virtual_mounts(looker, renamed)
    for one, other in zip(ours.values(), theirs.values(), strict=True):
        assert one.camera == other.camera and one.source == back[str(other.source)]
        assert one.rig_from_camera.tobytes() == other.rig_from_camera.tobytes()
        assert one.seen is not None and other.seen is not None
        assert one.seen.tobytes() == other.seen.tobytes()
    chosen = choose_views(looker.wanted_views, renamed | theirs)
    expected = choose_views(looker.wanted_views, rig | ours)
    assert [back.get(name, name) for name in chosen.values()] == list(expected.values())


def test_planners_that_want_no_pictures_say_nothing() -> None:
    blind = ConstantVelocity()
    assert virtual_mounts(blind, WAYMO) == {} and shown_views(blind, WAYMO) == ()
    assert seen_lines(blind, WAYMO) == ("", None)
    computing = ConstantVelocity()
    computing.device = "cuda"  # type: ignore[attr-defined]
    assert seen_lines(computing, WAYMO) == ("planner constant-velocity on cuda", None)
    assert seen_record(computing, WAYMO) == {
        "planner": "constant-velocity",
        "device": "cuda",
        "views": [],
    }


def _painted(mount: CameraMount) -> np.ndarray:
    rays = mount.camera.rays(mount.camera.pixel_grid()) @ mount.rig_from_camera[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.rint(128 + 120 * np.sin(2 * rays)).astype(np.uint8)


def test_large_pictures_are_looked_at_in_small() -> None:
    wide = _rig(wide=(1000, 1000, 500.0, 0.0))["wide"]
    camera = PinholeCamera(1600, 1200, 1600.0, 1600.0, 800.0, 600.0)
    large = CameraMount(camera, camera_pose((0.0, 0.0, 1.0), 45.0, 0.0))
    seen = seen_by(large, [wide])
    assert seen.shape == (1200, 1600) and seen.dtype == np.bool_
    edges = np.argmax(seen, axis=1)  # the first column that is seen, in each row
    assert np.abs(edges - 800).max() <= 1600 / 640


@pytest.mark.real_data
def test_waymos_own_calibration_fits(shared: Path, looker: Looker) -> None:
    log = load_waymo(shared / "data" / "waymo_v1", "pvps_data_one_frame")
    mounts = camera_mounts(log, scale=0.25)
    assert virtual_mounts(looker, mounts) == {}
    shown = shown_views(looker, mounts)
    assert [view.camera for view in shown] == ["FRONT_LEFT", "FRONT", "FRONT_RIGHT"]


def test_of_each_picture_only_what_the_planner_looks_at_is_rendered(looker: Looker) -> None:
    mounts = looked_at(looker, {**SYNTHETIC, "spare": SYNTHETIC["front"]})
    assert mounts["front"].window == (0, 32, 480, 288)
    assert mounts["front_left"].window == mounts["front_right"].window == (104, 32, 376, 288)
    assert mounts["spare"].window is None
    planner = make_planner("gtrs-mini")
    layout = planner._fit(mounts)
    rng = np.random.default_rng(0)
    images = {name: rng.integers(0, 256, (320, 480, 3)).astype(np.uint8) for name in THREE}
    parts = {}
    for name, image in images.items():
        left, top, right, bottom = mounts[name].window
        parts[name] = mounts[name].framed(image[top:bottom, left:right])
        assert parts[name].shape == (320, 480, 3) and not np.array_equal(parts[name], image)
    assert np.array_equal(layout.stitch(parts), layout.stitch(images))


def test_windows_of_one_camera_are_joined_and_other_planners_see_all() -> None:
    front = make_planner("gtrs-mini").wanted_views[1]

    class Twice(Looker):
        def choose_cameras(self, mounts: Mapping[str, CameraMount]) -> dict[str, str]:
            return {"a": "front", "b": "front"}

    views = tuple(
        replace(front, name=name, crop_rows=rows, crop_columns=columns)
        for name, rows, columns in (("a", 64, 0), ("b", 0, 300))
    )
    assert looked_at(Twice(views), SYNTHETIC)["front"].window == (0, 0, 480, 320)
    assert looked_at(Twice(views[:1]), SYNTHETIC)["front"].window == (0, 0, 480, 320)
    assert looked_at(ConstantVelocity(), SYNTHETIC) == SYNTHETIC
