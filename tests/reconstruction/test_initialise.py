from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.geometry import boxes, se3
from recast.logs import DrivingLog, GroundHeight, Trajectory
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.first_points import (
    Initialisation,
    initialise,
    sky_cells,
    unseen_surfaces,
)
from recast.reconstruction.points import OwnedSweep, PointCloud, depth_samples, read_sweeps
from recast.reconstruction.settings import INIT
from recast.reconstruction.views import TrainingView, choose_actors, modelled_tracks, read_views
from recast.scene.sky import SkyMap, direction_coordinates
from recast.scene.street_scene import pose_at, stands
from recast.splats.gaussians import C0
from support import tiny_world

CONFIG = SceneConfig(scale=1.0, voxel_m=0.3, sweep_points=1000)


@pytest.fixture(scope="module")
def views(tiny_log: DrivingLog) -> list[TrainingView]:
    return read_views(tiny_log, CONFIG)


@pytest.fixture(scope="module")
def start(tiny_log: DrivingLog, views: list[TrainingView]) -> Initialisation:
    actors = choose_actors(tiny_log, views, CONFIG)
    return initialise(tiny_log, views, actors, CONFIG, np.random.default_rng(0))


def test_no_background_point_in_a_moving_box(
    tiny_log: DrivingLog, views: list[TrainingView], start: Initialisation
) -> None:
    sweeps = read_sweeps(tiny_log, choose_actors(tiny_log, views, CONFIG), [])
    track = tiny_log.tracks["0"]
    inside_before = inside_after = 0
    raw = tiny_log.lidars["velodyne"].sweeps
    for index, sweep in enumerate(sweeps):
        pose = pose_at(track.trajectory, sweep.timestamp_us)
        assert pose is not None
        world = se3.apply(tiny_log.world_from_rig.at(sweep.timestamp_us), raw[index].points)
        inside_before += boxes.contains(world, track.size, pose).sum()
        inside_after += boxes.contains(sweep.background, track.size, pose).sum()
    assert inside_before > 300 and inside_after == 0
    # and no coloured smear along its way either: the lane it drives in holds only ground
    first = se3.inverse(track.trajectory.poses[0])
    x, y, z = se3.apply(first, start.background.means.numpy()).T
    lane = z[(np.abs(y) < 0.8) & (x > 0) & (x < 20)] + track.size[2] / 2
    assert len(lane) > 50 and ((lane > 0.3) & (lane < track.size[2])).mean() < 0.02


def test_actor_points_lie_on_the_cars_faces(start: Initialisation) -> None:
    half = tiny_world.CAR_SIZE / 2
    points = start.actors["0"].means.numpy()
    assert len(points) > 300
    gap = np.abs(np.abs(points) - half).min(axis=1)
    assert np.median(gap) < 0.08
    assert (np.abs(points) <= half + 0.2).all()
    rear = points[points[:, 0] < -half[0] + 0.1]
    colours = start.actors["0"].sh[:, 0].numpy() * 0.28209479177387814 + 0.5
    red = colours[points[:, 0] < -half[0] + 0.1].mean(0)
    assert len(rear) > 50 and red[0] > red[1] + 0.2 and red[0] > red[2] + 0.2


def test_plane_sweep_adds_points_above_the_lidars_reach(
    tiny_log: DrivingLog, views: list[TrainingView], start: Initialisation
) -> None:
    actors = choose_actors(tiny_log, views, CONFIG)
    config = CONFIG.model_copy(update={"sweep_points": 0})
    without = initialise(tiny_log, views, actors, config, np.random.default_rng(0))
    added = len(start.background) - len(without.background)
    assert 0 < added <= 1000


def test_held_out_frames_lend_nothing(tiny_log: DrivingLog, views: list[TrainingView]) -> None:
    actors = choose_actors(tiny_log, views, CONFIG)
    black = [
        replace(view, image=np.zeros_like(view.image)) if view.held_out else view for view in views
    ]
    first = initialise(tiny_log, views, actors, CONFIG, np.random.default_rng(0))
    second = initialise(tiny_log, black, actors, CONFIG, np.random.default_rng(0))
    assert np.array_equal(first.background.sh, second.background.sh)
    assert np.array_equal(first.sky.colours, second.sky.colours)


def test_depth_samples_agree_with_the_world(
    tiny_log: DrivingLog, views: list[TrainingView]
) -> None:
    actors = choose_actors(tiny_log, views, CONFIG)
    sweeps = read_sweeps(tiny_log, actors, [])
    view = views[5]  # an odd frame: no sweep of its own
    samples = depth_samples(view, sweeps, actors)
    assert len(samples.depths) > 300
    rays = view.camera.rays(samples.uv) @ view.world_from_camera[:3, :3].T
    seconds = 0.1 * 5
    from support.tiny_drive import BASELINE, RECTIFIED_FROM_RIG, street_from_rig

    camera_from_rig = se3.from_rotation_translation(np.eye(3), BASELINE) @ RECTIFIED_FROM_RIG
    pose = street_from_rig(np.array(seconds)) @ se3.inverse(camera_from_rig)
    directions = view.camera.rays(samples.uv) @ pose[:3, :3].T
    length = np.linalg.norm(directions, axis=1)
    distance, _ = tiny_world.cast(
        np.broadcast_to(pose[:3, 3], directions.shape),
        directions / length[:, None],
        np.full(len(rays), seconds),
    )
    true = distance / length
    assert np.median(np.abs(samples.depths / true - 1)) < 0.01
    assert (np.abs(samples.depths / true - 1) < 0.05).mean() > 0.9


def test_a_track_without_points_gets_a_grid_in_its_box(
    tiny_log: DrivingLog, views: list[TrainingView]
) -> None:
    ghost_poses = tiny_log.tracks["0"].trajectory.poses.copy()
    ghost_poses[:, 2, 3] += 3.0  # up in the air
    track = tiny_log.tracks["0"]
    ghost = replace(track, trajectory=Trajectory(track.trajectory.timestamps_us, ghost_poses))
    config = CONFIG.model_copy(update={"sweep_points": 0})
    start = initialise(tiny_log, views, {"0": ghost}, config, np.random.default_rng(0))
    points = start.actors["0"].means.numpy()
    assert len(points) > 500
    assert np.allclose(np.abs(points).max(axis=0), track.size / 2, atol=1e-5)


def test_forced_and_excluded_tracks(tiny_log: DrivingLog, views: list[TrainingView]) -> None:
    def ids(**fields: object) -> set[str]:
        return set(choose_actors(tiny_log, views, CONFIG.model_copy(update=fields)))

    assert ids() == {"0", "1"}
    assert ids(exclude_tracks=("0",)) == {"1"}
    assert ids(exclude_tracks=("0", "1")) == set()
    with pytest.raises(InputError, match="track 9"):
        ids(force_dynamic=("9",))
    with pytest.raises(InputError, match="track 8"):
        ids(exclude_tracks=("8",))


def test_a_parked_vehicle_stands_at_the_median_of_its_labels(
    tiny_log: DrivingLog, views: list[TrainingView]
) -> None:
    labels = tiny_log.tracks["1"].trajectory
    noisy = labels.poses.copy()
    noisy[:, 0, 3] += np.where(np.arange(len(noisy)) % 3 == 0, 0.3, 0.0)
    track = replace(tiny_log.tracks["1"], trajectory=Trajectory(labels.timestamps_us, noisy))
    log = replace(tiny_log, tracks={**tiny_log.tracks, "1": track})
    standing = choose_actors(log, views, CONFIG)["1"].trajectory
    assert stands(standing) and not stands(track.trajectory)
    assert standing.timestamps_us.tolist() == log.world_from_rig.timestamps_us[[0, -1]].tolist()
    assert np.allclose(standing.poses[0, :3, 3], np.median(noisy[:, :3, 3], axis=0))


@pytest.mark.parametrize("fault", ["brief", "far", "hidden", "walks"])
def test_what_was_not_seen_well_stays_background(
    tiny_log: DrivingLog, views: list[TrainingView], fault: str
) -> None:
    track, lidars = tiny_log.tracks["1"], tiny_log.lidars
    times, poses = track.trajectory.timestamps_us, track.trajectory.poses.copy()
    if fault == "brief":
        kept = times - times[0] < 900_000
        times, poses = times[kept], poses[kept]
    elif fault == "far":
        poses[:, 0, 3] += 400.0
    elif fault == "hidden":  # no LiDAR point in its box
        poses[:, 2, 3] += 2.5
    category = "pedestrian" if fault == "walks" else track.category
    changed = replace(track, category=category, trajectory=Trajectory(times, poses))
    log = replace(tiny_log, lidars=lidars, tracks={**tiny_log.tracks, "1": changed})
    assert set(choose_actors(log, views, CONFIG)) == {"0"}
    assert "1" not in modelled_tracks(log, CONFIG) and "1" in modelled_tracks(tiny_log, CONFIG)
    forced = CONFIG.model_copy(update={"force_dynamic": ("1",)})
    if fault != "far":
        assert set(choose_actors(log, views, forced)) == {"0", "1"}


def test_a_forced_track_that_is_never_visible(
    tiny_log: DrivingLog, views: list[TrainingView]
) -> None:
    track = tiny_log.tracks["1"]
    poses = track.trajectory.poses.copy()
    poses[:, 2, 3] += 500.0
    hidden = replace(track, trajectory=Trajectory(track.trajectory.timestamps_us, poses))
    log = replace(tiny_log, tracks={**tiny_log.tracks, "1": hidden})
    with pytest.raises(InputError, match="never visible"):
        choose_actors(log, views, CONFIG.model_copy(update={"force_dynamic": ("1",)}))


def test_a_log_without_sweeps_or_parallax(tiny_log: DrivingLog, views: list[TrainingView]) -> None:
    blind = replace(tiny_log, lidars={})
    config = CONFIG.model_copy(update={"sweep_points": 0})
    with pytest.raises(InputError, match="LiDAR: 0 points"):
        initialise(blind, views, {}, config, np.random.default_rng(0))


def test_what_no_image_shows_begins_opaque_in_colours_near_by(tiny_log: DrivingLog) -> None:
    """A wall behind the car: three sweeps hit its left half, two its right one."""
    start = tiny_log.world_from_rig.poses[0, :3, 3]
    y, z = np.meshgrid(np.arange(-4, 4, 0.15), np.arange(0, 2, 0.15))
    wall = np.stack([np.full(y.size, -6.0), y.ravel(), z.ravel()], axis=-1) + start
    left = (wall[wall[:, 1] > start[1] + 0.3]).astype(np.float32)
    whole = wall.astype(np.float32)
    sweeps = [OwnedSweep(time, points, {}) for time, points in enumerate([whole, whole, left])]
    near = left[:20] + np.float32([0.5, 0, 0])
    seen = PointCloud(near, np.tile(np.float32([0.8, 0.2, 0.1]), (20, 1)), np.ones(20, np.float32))
    ground = GroundHeight(start[:2] - 3, 0.3, np.full((20, 20), start[2]))
    config = CONFIG.model_copy(update={"max_gaussians": 100_000})
    rng = np.random.default_rng(0)
    surface, below = unseen_surfaces(tiny_log, sweeps, seen, ground, config, rng)
    assert 50 < len(surface) < len(left)
    assert (surface.means[:, 1] > start[1]).all()  # a voxel holds 0.3 m
    assert np.allclose(surface.means[:, 0], start[0] - 6, atol=1e-4)
    assert torch.allclose(surface.sh[:, 0] * C0 + 0.5, torch.tensor([0.8, 0.2, 0.1]), atol=1e-5)
    assert (surface.log_scales.exp() <= INIT.unseen_sigma_m + 1e-5).all()
    assert len(below) == 400
    assert np.allclose(below.means[:, 2], start[2] - INIT.unseen_below_m, atol=1e-5)
    for part in (surface, below):
        assert torch.allclose(part.logit_opacities.sigmoid(), torch.tensor(INIT.unseen_opacity))
    few = config.model_copy(update={"max_gaussians": 300})
    thin, coarse = unseen_surfaces(tiny_log, sweeps, seen, ground, few, rng)
    assert len(thin) == 50 and len(coarse) == 49
    (only,) = unseen_surfaces(tiny_log, sweeps[1:], seen, ground, config, rng)
    assert np.array_equal(only.means, below.means)


def test_cells_of_the_sky_that_images_show(views: list[TrainingView]) -> None:
    sky = SkyMap.constant(torch.full((3,), 0.5))
    view = views[0]
    pixels = np.flatnonzero(np.arange(view.camera.height * view.camera.width) < view.camera.width)
    cells = sky_cells([view], [pixels], sky)
    rays = view.camera.rays(view.camera.pixel_grid()) @ view.world_from_camera[:3, :3].T
    place = direction_coordinates(torch.from_numpy(rays).float()).view(*view.image.shape[:2], 2)
    height, width = cells.shape
    shown = cells[(place[..., 1] * height).long(), (place[..., 0] * width).long()]
    assert shown[0].all() and not shown[-1].any()
    assert cells.float().mean() < 0.05
