from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from recast.core.errors import InputError
from recast.dynamics import PACIFICA
from recast.geometry import boxes, se2, se3
from recast.metrics import ViewSettings, evaluate_oracle_views, logged_views, read_oracle_views
from recast.metrics.oracle_scores import (
    Agreement,
    agreement,
    box_pixels,
    grown,
    mask_iou,
    summarise,
)
from recast.metrics.oracle_views import angle_to_nearest, azimuth_elevation, place_views
from support.box_world import (
    CAMERA,
    FACES,
    MOUNTS,
    SIZE,
    BoxOracle,
    box_log,
    box_shares,
    parked_at,
    scene,
)

LOG = box_log()
REAR_ONLY = ((-1, 0, 0),)
WHOLE = tuple(FACES)


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory):
    out = tmp_path_factory.mktemp("oracle") / "truth"
    oracle, told = BoxOracle(), []
    result = evaluate_oracle_views(
        LOG,
        scene(REAR_ONLY, LOG),
        scene(WHOLE, LOG),
        oracle,
        "7",
        MOUNTS,
        out,
        rng=np.random.default_rng(0),
        settings=ViewSettings(moments=1, distances=(9.0,), headings=8),
        exposures={"front": 0.97},
        shares=box_shares(scene(WHOLE, LOG)),
        progress=lambda done, of: told.append((done, of)),
    )
    return result, out, oracle, told


def test_the_log_saw_it_from_behind_only() -> None:
    directions = logged_views(LOG, LOG.tracks["7"])
    assert directions.shape == (7, 3)
    azimuth, elevation = azimuth_elevation(directions[0])
    assert abs(abs(azimuth) - 180) < 1e-6 and elevation == pytest.approx(5.7, abs=0.1)


def test_views_too_far_or_too_small_or_hidden_do_not_count() -> None:
    far = LOG.tracks["7"].trajectory
    away = replace(far, poses=far.poses + _shift(60.0))
    assert len(logged_views(LOG, replace(LOG.tracks["7"], trajectory=away))) == 0
    hidden = replace(LOG, tracks={**LOG.tracks, "w": replace(LOG.tracks["7"], track_id="w")})
    wall = replace(hidden.tracks["w"], size=np.array([0.5, 6.0, 5.0]))
    wall = replace(wall, trajectory=replace(far, poses=far.poses + _shift(-5.0)))
    hidden = replace(hidden, tracks={**LOG.tracks, "w": wall})
    assert len(logged_views(hidden, LOG.tracks["7"])) == 0


def _shift(x: float) -> np.ndarray:
    shift = np.zeros((4, 4))
    shift[0, 3] = x
    return shift


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), st.floats(-1.5, 1.5))
def test_angles_are_those_on_the_sphere(a: float, b: float, c: float, d: float) -> None:
    def unit(azimuth: float, elevation: float) -> np.ndarray:
        flat = np.cos(elevation)
        return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])

    first, second = unit(a, b), unit(c, d)
    angle = angle_to_nearest(first, np.stack([second, -first]))
    assert angle == pytest.approx(
        np.degrees(2 * np.arcsin(np.linalg.norm(first - second) / 2)), abs=1e-4
    )
    assert angle_to_nearest(first, np.stack([second, first])) < 1e-5
    np.testing.assert_allclose(np.radians(azimuth_elevation(first)), (a, b), atol=1e-6)


def test_views_stand_on_the_road_clear_of_the_ego_and_turn_all_the_way() -> None:
    settings = ViewSettings(moments=3, distances=(2.0, 9.0), headings=8)
    views = place_views(LOG, LOG.tracks["7"], MOUNTS, settings)
    assert len(views) == 3 * 2 * 8
    assert len({view.frame for view in views}) == 3
    assert sorted({round(v.heading, 6) for v in views}) == sorted(
        round(float(se2.wrap_angle(np.pi / 8 + k * np.pi / 4)), 6) for k in range(8)
    )
    for view in views:
        pose = se2.from_se3(view.world_from_actor)
        ego = se2.from_se3(view.world_from_camera @ se3.inverse(MOUNTS["front"].rig_from_camera))
        centre = se2.compose(ego, [PACIFICA.centre_offset, 0.0, 0.0])
        overlap = boxes.bev_overlap_area(centre, (PACIFICA.length, PACIFICA.width), pose, SIZE)
        assert overlap == 0.0
        assert view.world_from_actor[2, 3] == pytest.approx(SIZE[2] / 2)
        assert abs(pose[1]) < 1e-6  # in the ego's lane
        assert view.distance == pytest.approx(pose[0] - view.world_from_camera[0, 3], abs=1e-6)
    assert min(view.distance for view in views) > 2.0


def test_places_taken_by_a_parked_car_are_left_out() -> None:
    settings = ViewSettings(moments=1, distances=(9.0,), headings=8)
    [*free] = place_views(LOG, LOG.tracks["7"], MOUNTS, settings)
    x, y, _ = se2.from_se3(free[0].world_from_actor)
    log = box_log(parked_at(x, y + 2.7))
    kept = place_views(log, log.tracks["7"], MOUNTS, settings)
    assert 0 < len(kept) < len(free)


def test_a_road_too_short_is_refused() -> None:
    with pytest.raises(InputError, match="recorded road ahead"):
        place_views(LOG, LOG.tracks["7"], MOUNTS, ViewSettings(distances=(100.0,)))


@pytest.mark.parametrize(
    "settings",
    [ViewSettings(moments=0), ViewSettings(distances=()), ViewSettings(distances=(-1.0,))],
)
def test_impossible_settings_are_refused(settings: ViewSettings) -> None:
    with pytest.raises(ValueError, match="ViewSettings"):
        place_views(LOG, LOG.tracks["7"], MOUNTS, settings)


def test_sharpness_is_that_of_the_vehicle_alone() -> None:
    rng = np.random.default_rng(2)
    truth = rng.integers(0, 255, (120, 160, 3), dtype=np.uint8)
    vehicle = np.zeros((400, 500), bool)
    vehicle[130:190, 230:330] = True  # rows 30 to 90, columns 30 to 130 of the window
    smooth = cv2.GaussianBlur(truth, (0, 0), 6.0)
    beside = truth.copy()
    beside[~vehicle[100:220, 200:360]] = 128

    def sharp(image: np.ndarray) -> float:
        return agreement(image, truth, (30, 30, 130, 90), vehicle, vehicle, (200, 100)).sharpness

    assert sharp(truth) == 1.0
    assert sharp(smooth.astype(np.uint8)) < 0.1
    assert sharp(beside) == pytest.approx(1.0, abs=0.02)


def test_ssim_of_a_rectangle_smaller_than_its_window() -> None:
    rng = np.random.default_rng(1)
    truth = rng.integers(0, 255, (30, 40, 3), dtype=np.uint8)
    empty = np.zeros((30, 40), bool)
    same = agreement(truth, truth, (10, 10, 13, 12), empty, empty)
    assert same == Agreement(100.0, pytest.approx(1.0), 1.0, 0.0)  # no vehicle, so none is sharp
    elsewhere = truth.copy()
    elsewhere[:, :3] = 0  # outside the rectangle, further than a window reaches
    assert agreement(elsewhere, truth, (20, 10, 23, 12), empty, empty) == same
    noisy = rng.integers(0, 255, truth.shape, dtype=np.uint8)
    assert agreement(noisy, truth, (10, 10, 13, 12), empty, empty).ssim < 0.5
    tiny = agreement(noisy[:5, :5], truth[:5, :5], (0, 0, 5, 5), empty, empty)
    assert np.isfinite(tiny.ssim)
    with pytest.raises(ValueError, match="is empty"):
        agreement(truth, truth, (5, 5, 5, 9), empty, empty)


def test_mask_iou_by_hand() -> None:
    first, second = np.zeros((4, 4), bool), np.zeros((4, 4), bool)
    first[:2], second[1:3] = True, True
    assert mask_iou(first, second) == pytest.approx(4 / 12)
    assert mask_iou(first & ~first, first & ~first) == 1.0


def test_a_box_half_out_of_the_image_is_not_scored() -> None:
    ahead = se3.inverse(MOUNTS["front"].rig_from_camera) @ se2.to_se3(np.array([12.0, 0, 0]), 0.75)
    left, top, right, bottom = box_pixels(SIZE, ahead, CAMERA) or (0, 0, 0, 0)
    assert 0 < left < right < CAMERA.width and 0 < top < bottom < CAMERA.height
    beside = se3.inverse(MOUNTS["front"].rig_from_camera) @ se2.to_se3(np.array([12, 6.5, 0]), 0.75)
    assert box_pixels(SIZE, beside, CAMERA) is None
    assert grown((2, 3, 90, 60), 10, 96, 64) == (0, 0, 96, 64)


def test_the_actor_with_all_sides_wins_beyond_the_log(compared) -> None:
    result, *_ = compared
    assert len(result.views) == 8 and result.logged == 7
    for view in result.views:
        if view.angle > 60:
            assert view.candidate.psnr > view.baseline.psnr + 3
            assert view.candidate.mask_iou > 0.85 > view.baseline.mask_iou
    near, *_, beyond, everything = result.summary
    assert beyond == result.beyond_60
    assert near.views + beyond.views <= everything.views == 8
    assert near.baseline is not None and beyond.baseline is not None
    assert near.baseline.mask_iou > beyond.baseline.mask_iou + 0.2  # it has what the log saw
    for measure in ("psnr", "ssim", "mask_iou"):
        assert beyond.candidate_better[measure] == beyond.views
        assert 0 < beyond.difference[measure].low <= beyond.difference[measure].point
    assert sum(b.views for b in result.summary[:4]) == 8


def test_the_folder_holds_what_was_seen(compared) -> None:
    result, out, oracle, told = compared
    assert read_oracle_views(out) == result
    assert told == [(i + 1, 8) for i in range(8)]
    names = {path.name for path in out.iterdir()}
    pictures = {view.picture for view in result.views}
    whole = {f"showcase_{side}.png" for side in ("baseline", "candidate", "truth")}
    assert names == {"oracle_views.json", *pictures, *whole}
    shown = result.views[result.showcase]
    assert shown.angle == max(view.angle for view in result.views)
    truth = np.asarray(Image.open(out / "showcase_truth.png"))
    baseline = np.asarray(Image.open(out / "showcase_baseline.png"))
    assert truth.shape == baseline.shape == (CAMERA.height, CAMERA.width, 3)
    beside = np.asarray(Image.open(out / shown.picture))
    height, width = beside.shape[:2]
    left, top, right, bottom = grown(shown.rectangle, 24, CAMERA.width, CAMERA.height)
    assert (height, width) == (bottom - top, 3 * (right - left) + 8)
    np.testing.assert_array_equal(beside[:, -(right - left) :], truth[top:bottom, left:right])
    assert oracle.calls[0][2:] == (shown.timestamp_us, 0.97)


def test_each_view_tells_what_of_the_vehicle_was_seen(compared) -> None:
    result, *_ = compared
    for view in result.views:
        assert view.coverage is not None
        assert view.coverage.pixels > 50
        rear, left = np.cos(np.radians(view.azimuth)) < 0, np.sin(np.radians(view.azimuth)) > 0
        assert (view.coverage.seen > 0.05) == rear
        assert (view.coverage.mirrored > 0.05) == left


def test_records_without_shares_are_read(compared, tmp_path: Path) -> None:
    result, out, *_ = compared
    record = json.loads((out / "oracle_views.json").read_text())
    for view in record["views"]:
        del view["coverage"]
    (tmp_path / "oracle_views.json").write_text(json.dumps(record))
    older = read_oracle_views(tmp_path)
    assert older.views == tuple(replace(view, coverage=None) for view in result.views)


def test_the_same_again_gives_the_same_bytes(compared, tmp_path: Path) -> None:
    _, out, *_ = compared
    settings = ViewSettings(moments=1, distances=(9.0,), headings=8)
    evaluate_oracle_views(
        LOG,
        scene(REAR_ONLY, LOG),
        scene(WHOLE, LOG),
        BoxOracle(),
        "7",
        MOUNTS,
        tmp_path / "truth",
        rng=np.random.default_rng(0),
        settings=settings,
        exposures={"front": 0.97},
        shares=box_shares(scene(WHOLE, LOG)),
    )
    for path in out.iterdir():
        again = (tmp_path / "truth" / path.name).read_bytes()
        assert hashlib.sha256(again).digest() == hashlib.sha256(path.read_bytes()).digest()


def test_bad_input_names_what_is_wrong(compared, tmp_path: Path) -> None:
    _, out, *_ = compared
    whole, rng = scene(WHOLE, LOG), np.random.default_rng(0)
    with pytest.raises(InputError, match="track 8"):
        evaluate_oracle_views(LOG, whole, whole, BoxOracle(), "8", MOUNTS, rng=rng)
    with pytest.raises(InputError, match=r"baseline scene.*has no model"):
        evaluate_oracle_views(
            LOG, replace(whole, actors={}), whole, BoxOracle(), "7", MOUNTS, rng=rng
        )
    with pytest.raises(InputError, match="camera side"):
        settings = ViewSettings(camera="side")
        evaluate_oracle_views(
            LOG, whole, whole, BoxOracle(), "7", MOUNTS, rng=rng, settings=settings
        )
    with pytest.raises(InputError, match="exists already"):
        evaluate_oracle_views(LOG, whole, whole, BoxOracle(), "7", MOUNTS, out, rng=rng)
    record = json.loads((out / "oracle_views.json").read_text())
    (tmp_path / "oracle_views.json").write_text(json.dumps({**record, "version": 9}))
    with pytest.raises(InputError, match="version"):
        read_oracle_views(tmp_path)


def test_means_by_angle_and_pairs_by_hand() -> None:
    class View:
        def __init__(self, heading: float, angle: float, native: float, replaced: float) -> None:
            self.heading, self.angle = heading, angle
            self.baseline = Agreement(native, native / 100, native / 50, native / 40)
            self.candidate = Agreement(replaced, replaced / 100, replaced / 50, replaced / 40)

    views = [
        View(0.1, 10, 30, 28),
        View(1.0, 60, 10, 14),
        View(1.0, 75, 12, 18),
        View(3.0, 180, 10, 9),
    ]
    first, second, third, last, beyond, everything = summarise(views, np.random.default_rng(0))
    assert [b.views for b in (first, second, third, last, beyond, everything)] == [1, 0, 2, 1, 3, 4]
    assert second.baseline is None and second.difference == {}
    assert third.baseline is not None and third.baseline.psnr == 11.0
    assert beyond.difference["psnr"].point == pytest.approx(3.0)
    assert (beyond.difference["psnr"].low, beyond.difference["psnr"].high) == (-1.0, 5.0)
    assert beyond.candidate_better["psnr"] == 2
