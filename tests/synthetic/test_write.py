from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.cameras import PinholeCamera, box_rectangle
from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import DrivingLog, Track, Trajectory, read_log
from recast.synthetic.rendering import WAYMO_TOP
from recast.synthetic.vehicles import sample_vehicle
from recast.synthetic.world import CAMERAS, LIDAR, World, exposure, make_rig, read_truth
from recast.synthetic.write import Oracle, instances, synthesize_log, with_label_noise
from support.small_street import small_world

FRAMES = 6
FIVE_SIGMA = 5 * WAYMO_TOP.range_noise


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def test_the_log_is_what_readers_expect(small: World, small_log: DrivingLog) -> None:
    assert list(small_log.cameras) == list(CAMERAS)
    for name, stream in small_log.cameras.items():
        assert len(stream.images) == len(stream.timestamps_us) == FRAMES
        assert stream.images[FRAMES - 1].shape == (32, 48, 3)
        assert np.ptp(stream.images[0]) > 50, name
        np.testing.assert_allclose(stream.rig_from_camera[2, 3], 2.12)
    sweeps = small_log.lidars[LIDAR]
    np.testing.assert_array_equal(sweeps.timestamps_us, small_log.cameras["front"].timestamps_us)
    assert len(sweeps.sweeps[0].points) > 20_000
    np.testing.assert_allclose(small_log.world_from_rig.poses, small.ego.poses)
    assert small_log.map is not None
    assert list(small_log.map.lanes) == list(small.street.map.lanes)
    assert small_log.metadata["dataset"] == "synthetic"
    assert small_log.metadata["target"] in small_log.tracks
    for key, track in small_log.tracks.items():
        np.testing.assert_allclose(track.size, small.vehicles[key].model.size)
        expected = small.vehicles[key].trajectory.poses
        np.testing.assert_allclose(track.trajectory.poses, expected, atol=1e-9)


def test_cameras_look_where_they_are_named() -> None:
    rig = make_rig(480, 320)
    for name, yaw in (("front_left", 45.0), ("front", 0.0), ("front_right", -45.0)):
        axis = rig.cameras[name].rig_from_camera[:3, 2]
        assert np.rad2deg(np.arctan2(axis[1], axis[0])) == pytest.approx(yaw)
        np.testing.assert_allclose(rig.cameras[name].rig_from_camera[:3, 1], [0, 0, -1], atol=1e-9)
    camera = rig.cameras["front"].camera
    assert np.rad2deg(2 * np.arctan(240 / camera.fx)) == pytest.approx(50.4)
    exposures = [exposure(5, name) for name in CAMERAS]
    assert len(set(exposures)) == 3
    assert all(0.97 <= value <= 1.03 for value in exposures)


def test_points_lie_on_surfaces_and_in_the_boxes_of_their_vehicles(
    small: World, small_log: DrivingLog
) -> None:
    oracle = Oracle(small)
    numbers = instances(small)
    met = set()
    for index in (0, FRAMES - 1):
        lidar = small_log.lidars[LIDAR]
        time = int(lidar.timestamps_us[index])
        world_from_rig = small_log.world_from_rig.at(time)
        points = se3.apply(world_from_rig, lidar.sweeps[index].points)
        origin = (world_from_rig @ lidar.rig_from_lidar)[:3, 3]
        ranges = np.linalg.norm(points - origin, axis=1)
        directions = (points - origin) / ranges[:, None]
        hits = oracle.scene.cast(origin, directions, oracle.logged_poses(time))
        errors = ranges - hits.distance
        near = np.abs(errors) < FIVE_SIGMA
        assert near.mean() > 0.9999  # a ray along an edge may pass beside it the second time
        assert errors[near].std() == pytest.approx(WAYMO_TOP.range_noise, rel=0.1)
        for key, track in small_log.tracks.items():
            pose = track.trajectory.at(time)
            own = near & (hits.instance == numbers[key])
            assert boxes.contains(points[own], track.size, pose, margin=FIVE_SIGMA).all(), key
            inside = near & boxes.contains(points, track.size, pose, margin=-FIVE_SIGMA)
            assert np.all(hits.instance[inside] == numbers[key]), key
            met |= {key} if own.any() else set()
    assert small.target in met


def test_labelled_is_whoever_was_seen(small: World, small_log: DrivingLog) -> None:
    assert set(small_log.tracks) <= set(small.vehicles)
    assert small.target in small_log.tracks


def test_boxes_and_masks_agree(small: World) -> None:
    oracle = Oracle(small)
    rig = make_rig(240, 160)
    checked = 0
    for index in (0, 3, FRAMES):
        poses = {k: v.trajectory.poses[index] for k, v in small.vehicles.items()}
        for mounted in rig.cameras.values():
            world_from_camera = small.ego.poses[index] @ mounted.rig_from_camera
            together = mask_of(oracle, mounted.camera, world_from_camera, poses)
            for key, pose in poses.items():
                number = oracle.instance_of(key)
                alone = mask_of(oracle, mounted.camera, world_from_camera, {key: pose}) == number
                shown = together == number
                rectangle = box_rectangle(
                    small.vehicles[key].model.size,
                    se3.inverse(world_from_camera) @ pose,
                    mounted.camera,
                )
                if rectangle is None or not inside(rectangle, mounted.camera):
                    continue
                if shown.sum() < max(alone.sum(), 40):
                    continue
                rows, columns = np.nonzero(shown)
                edges = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
                assert overlap(rectangle, edges) >= 0.9, key
                checked += 1
    assert checked >= 3


def test_the_mask_of_a_real_shape_is_that_of_its_mesh(small: World) -> None:
    """Rounded bodies fill 0.75 to 0.8 of their boxes' rectangles; their meshes must fit exactly."""
    target = small.vehicles[small.target]
    model = sample_vehicle(np.random.default_rng(0), "hatchback")
    world = replace(small, vehicles={small.target: replace(target, model=model)})
    mounted = make_rig(240, 160).cameras["front"]
    world_from_camera = small.ego.poses[0] @ mounted.rig_from_camera
    pose = small.ego.poses[0].copy()
    pose[:3, 3] += 12.0 * pose[:3, 0] + [0.0, 0.0, model.size[2] / 2]
    shown = mask_of(Oracle(world), mounted.camera, world_from_camera, {small.target: pose}) == 1
    rows, columns = np.nonzero(shown)
    edges = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    camera_from_actor = se3.inverse(world_from_camera) @ pose
    pixels, _ = mounted.camera.project(se3.apply(camera_from_actor, model.surface.vertices))
    assert overlap(np.concatenate([pixels.min(axis=0), pixels.max(axis=0)]), edges) >= 0.93


def mask_of(
    oracle: Oracle, camera: PinholeCamera, pose: np.ndarray, poses: dict[str, np.ndarray]
) -> np.ndarray:
    """Instances at pixel centres, without the cost of light."""
    rays = camera.rays(camera.pixel_grid().reshape(-1, 2)) @ pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return oracle.scene.cast(pose[:3, 3], rays, poses).instance.reshape(camera.height, camera.width)


def inside(rectangle: np.ndarray, camera: PinholeCamera) -> bool:
    low, high = rectangle[:2].min(), rectangle[2:] - [camera.width, camera.height]
    return bool(low >= 0 and high.max() <= 0)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    common = np.prod(np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0))
    areas = [np.prod(r[2:] - r[:2]) for r in (a, b)]
    return float(common / (sum(areas) - common))


def test_the_truth_beside_the_log_is_that_of_its_images(
    small: World, small_log_folder: Path
) -> None:
    truth = read_truth(small_log_folder)
    assert truth.record.frames == dict.fromkeys(CAMERAS, FRAMES)
    assert truth.record.instances == {n: key for key, n in instances(small).items()}
    mounted = make_rig(48, 32).cameras["front"]
    time = int(small.ego.timestamps_us[2])
    frame = Oracle(small).render(
        mounted.camera, small.ego.at(time) @ mounted.rig_from_camera, timestamp_us=time
    )
    np.testing.assert_array_equal(truth.depth("front", 2), frame.depth)
    np.testing.assert_array_equal(truth.instance("front", 2), frame.instance)
    assert np.isinf(truth.depth("front", 2)[truth.instance("front", 2) == 65535]).all()
    for camera, number in (("front", FRAMES), ("back", 0)):
        with pytest.raises(InputError, match="choose one of front_left 0-5"):
            truth.depth(camera, number)


def test_no_truth_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--truth"):
        read_truth(tmp_path)


def test_same_seed_same_bytes_whatever_the_number_of_workers(
    small: World, small_log_folder: Path, tmp_path: Path
) -> None:
    seen: list[tuple[int, int]] = []
    synthesize_log(
        small_world(),
        tmp_path / "again",
        width=48,
        height=32,
        workers=2,
        truth=True,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert digests(tmp_path / "again") == digests(small_log_folder)
    assert seen == [(i, 4 * FRAMES) for i in range(1, 4 * FRAMES + 1)]


def test_a_log_of_every_third_moment_keeps_all_labels(small: World, tmp_path: Path) -> None:
    out = tmp_path / "log"
    synthesize_log(small, out, width=32, height=16, cameras=("front",), workers=1, every=3)
    log = read_log(out)
    times = small.ego.timestamps_us[:-1]
    np.testing.assert_array_equal(log.cameras["front"].timestamps_us, times[::3])
    assert len(log.lidars[LIDAR].sweeps) == len(times[::3])
    labels = log.tracks[small.target].trajectory.timestamps_us
    assert len(labels) > len(times[::3])
    with pytest.raises(InputError, match="every"):
        synthesize_log(small, tmp_path / "none", every=0)


def test_noise_moves_labels_and_nothing_else(small: World, tmp_path: Path) -> None:
    synthesize_log(
        small, tmp_path / "log", width=32, height=16, cameras=("front",), workers=1, label_noise=0.1
    )
    log = read_log(tmp_path / "log")
    assert list(log.cameras) == ["front"]
    track, true = log.tracks[small.target], small.vehicles[small.target]
    moved = track.trajectory.poses[:, :2, 3] - true.trajectory.poses[:, :2, 3]
    assert 0.03 < moved.std() < 0.25
    assert not np.allclose(track.size, true.model.size, atol=1e-3)
    np.testing.assert_allclose(log.world_from_rig.poses, small.ego.poses)


def test_label_noise_is_as_large_as_said() -> None:
    times = np.arange(4000, dtype=np.int64)
    size = np.array([4.0, 2.0, 1.5])
    track = Track("a", "car", size, Trajectory(times, np.tile(np.eye(4), (4000, 1, 1))))
    noisy = with_label_noise({"a": track}, 0.2, seed=1)["a"]
    np.testing.assert_allclose(noisy.trajectory.poses[:, :2, 3].std(axis=0), 0.2, rtol=0.05)
    assert se3.yaw(noisy.trajectory.poses).std() == pytest.approx(0.1, rel=0.05)
    assert with_label_noise({"a": track}, 0.0, seed=1) == {"a": track}
    again = with_label_noise({"a": track}, 0.2, seed=1)["a"]
    np.testing.assert_array_equal(again.trajectory.poses, noisy.trajectory.poses)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"width": 15}, "width: 15 pixels"),
        ({"height": 8193}, "height: 8193 pixels"),
        ({"cameras": ("rear",)}, "choose one of front_left, front, front_right"),
        ({"cameras": ()}, "names no camera"),
        ({"cameras": ("front", "front")}, "a camera twice"),
        ({"label_noise": -0.1}, "label noise"),
        ({"label_noise": float("nan")}, "label noise"),
        ({"workers": -1}, "workers"),
    ],
)
def test_what_cannot_be_written_is_refused_at_once(
    small: World, tmp_path: Path, arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        synthesize_log(small, tmp_path / "log", **arguments)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_an_output_that_exists_is_left_alone(small: World, tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    with pytest.raises(InputError, match="exists already"):
        synthesize_log(small, tmp_path / "log", workers=1)


def test_a_failure_leaves_nothing(small: World, tmp_path: Path) -> None:
    def fail(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        synthesize_log(small, tmp_path / "log", width=16, height=16, workers=1, progress=fail)
    assert not list(tmp_path.iterdir())
