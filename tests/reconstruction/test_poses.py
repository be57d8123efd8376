from __future__ import annotations

import numpy as np
import pytest
import torch

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import Track, Trajectory
from recast.reconstruction.tables import CameraPoses, TrackPoses
from recast.reconstruction.views import TrainingView
from recast.scene.street_scene import corrected, moves, pose_at, twist_matrix
from recast.splats import Gaussians, rasterize

CAMERA = PinholeCamera(64, 40, 50.0, 50.0, 32.0, 20.0)
OPENCV = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # world from camera axes


def view(
    frame: int, held_out: bool = False, at: tuple[float, float, float] = (0, 0, 0)
) -> TrainingView:
    pose = se3.from_rotation_translation(OPENCV, np.array(at, float))
    image = np.zeros((40, 64, 3), np.uint8)
    return TrainingView("front", frame, 100_000 * frame, CAMERA, pose, image, None, held_out)


def track(count: int = 6) -> Track:
    times = 100_000 * np.arange(count)
    place = np.stack([8 + 1.0 * np.arange(count), np.zeros(count), np.zeros(count)], -1)
    poses = se3.from_rotation_translation(np.eye(3), place)
    return Track("7", "car", np.array([4.0, 2.0, 1.5]), Trajectory(times, poses))


def test_twist_matrix_is_rigid_and_identity_at_zero() -> None:
    assert torch.equal(twist_matrix(torch.zeros(6)), torch.eye(4))
    matrix = twist_matrix(torch.tensor([1.0, 2.0, 3.0, 0.2, -0.1, 0.4]).double())
    rotation = matrix[:3, :3]
    assert torch.allclose(rotation @ rotation.T, torch.eye(3).double(), atol=1e-12)
    expected = se3.exp(np.array([0, 0, 0, 0.2, -0.1, 0.4]))[:3, :3]
    assert np.allclose(rotation.numpy(), expected)


def test_held_out_views_get_the_correction_of_their_neighbours() -> None:
    views = [view(0), view(2)]
    poses = CameraPoses(views)
    with torch.no_grad():
        poses.table.value[0, 0], poses.table.value[1, 0] = 0.1, 0.3
    learned = poses.corrections(views)
    logged = view(1).camera_from_world
    assert corrected(logged, learned, "front", 100_000)[0, 3] == pytest.approx(
        logged[0, 3] + 0.2, abs=1e-6
    )
    assert np.array_equal(corrected(logged, learned, "other", 100_000), logged)


def test_true_yaw_about_the_box_centre() -> None:
    poses = TrackPoses({"7": track()}, [view(i) for i in range(6)])
    with torch.no_grad():
        poses.table.value[:] = torch.tensor([0.5, -0.25, 0.1, 0.3])
    pose = poses.world_from_actors(250_000)["7"]
    assert pose is not None
    assert se3.yaw(pose.detach().numpy()) == pytest.approx(0.3, abs=1e-6)
    assert np.allclose(pose.detach().numpy()[:3, 3], [10.5 + 0.5, -0.25, 0.1], atol=1e-5)
    refined = poses.refined("7")
    assert np.allclose(se3.yaw(refined.poses), 0.3, atol=1e-6)


def test_labels_only_a_held_out_view_could_correct_are_dropped() -> None:
    noisy = track()
    noisy.trajectory.poses[3, 1, 3] = 0.3  # label noise that training cannot see
    views = [view(i, held_out=i == 3) for i in range(6)]
    poses = TrackPoses({"7": noisy}, views)
    with torch.no_grad():
        poses.table.value[:, 1] = 0.2
    refined = poses.refined("7")
    assert len(refined.timestamps_us) == poses.table.value.shape[0] == 5
    assert refined.at(300_000)[1, 3] == pytest.approx(0.2, abs=1e-6)
    assert refined.at(300_000)[0, 3] == pytest.approx(11.0, abs=1e-6)


def test_first_and_last_label_stay_and_follow_their_neighbour() -> None:
    views = [view(i, held_out=i in (0, 5)) for i in range(6)]
    poses = TrackPoses({"7": track()}, views)
    with torch.no_grad():
        poses.table.value[:, 1] = 0.2
    refined = poses.refined("7")
    assert refined.timestamps_us[[0, -1]].tolist() == [0, 500_000]
    assert np.allclose(refined.poses[:, 1, 3], 0.2, atol=1e-6)


def test_absent_outside_the_labels_but_held_within_the_clock_tolerance() -> None:
    trajectory = track().trajectory
    assert pose_at(trajectory, -20_000) is not None
    assert pose_at(trajectory, 700_000) is None
    assert moves(trajectory) and not moves(
        Trajectory(trajectory.timestamps_us, np.repeat(trajectory.poses[:1], 6, axis=0))
    )


def body(seed: int = 0) -> Gaussians:
    """A coloured blob of Gaussians filling the track's box."""
    rng = np.random.default_rng(seed)
    n = 300
    means = rng.uniform(-1, 1, (n, 3)) * [1.8, 0.9, 0.7]
    sh = torch.from_numpy(rng.uniform(-1.5, 1.5, (n, 1, 3))).float()
    quats = torch.zeros(n, 4)
    quats[:, 0] = 1
    return Gaussians(
        torch.from_numpy(means).float(), quats, torch.full((n, 3), -2.0), torch.full((n,), 2.0), sh
    )


def draw(gaussians: Gaussians, camera_from_world: torch.Tensor) -> torch.Tensor:
    K = torch.from_numpy(CAMERA.matrix).float()
    return rasterize(gaussians, camera_from_world, K, CAMERA.width, CAMERA.height).rgb


def test_track_refinement_undoes_a_planted_error() -> None:
    true = track()
    wrong_poses = true.trajectory.poses.copy()
    wrong_poses[:, :3, :3] = se3.rotation_z(0.08) @ wrong_poses[:, :3, :3]
    wrong_poses[:, 1, 3] += 0.15
    wrong = Track("7", "car", true.size, Trajectory(true.trajectory.timestamps_us, wrong_poses))
    views = [view(i, at=(0.5 * i, 1.5, 1.0)) for i in range(6)]
    poses = TrackPoses({"7": wrong}, views)
    gaussians = body()
    targets = []
    for seen in views:
        pose = torch.from_numpy(true.trajectory.at(seen.timestamp_us)).float()
        camera = torch.from_numpy(seen.camera_from_world).float()
        targets.append(draw(gaussians.transformed(pose), camera))
    for step in range(120):
        seen, target = views[step % 6], targets[step % 6]
        moved = poses.world_from_actors(seen.timestamp_us)["7"]
        assert moved is not None
        camera = torch.from_numpy(seen.camera_from_world).float()
        (draw(gaussians.transformed(moved), camera) - target).abs().mean().backward()
        poses.table.step(3e-2 * (1 - step / 125))
    refined = poses.refined("7")
    assert np.abs(se3.yaw(refined.poses)).mean() < 0.02
    assert np.abs(refined.poses[:, 1, 3]).mean() < 0.04


def test_camera_refinement_undoes_a_planted_error() -> None:
    seen = view(0, at=(0.0, 0.3, 0.2))
    pose = torch.from_numpy(track().trajectory.at(0)).float()
    world = body().transformed(pose)
    logged = torch.from_numpy(seen.camera_from_world).float()
    planted = torch.tensor([0.03, -0.02, 0.05, 0.01, -0.015, 0.01])
    target = draw(world, twist_matrix(planted) @ logged)
    poses = CameraPoses([seen])
    for step in range(80):
        (draw(world, poses.camera_from_world(seen)) - target).abs().mean().backward()
        poses.table.step(4e-3 * (1 - step / 82))
    left = draw(world, poses.camera_from_world(seen)) - target
    before = draw(world, logged) - target
    assert left.abs().mean() < 0.15 * before.abs().mean()
    assert (poses.table.value - planted)[0, 3:].abs().max() < 0.008


def test_all_present_tracks_are_posed_as_each_alone() -> None:
    moving, late = track(), track(4)
    late.trajectory.poses[:, 1, 3] += 3.0
    still = Trajectory(moving.trajectory.timestamps_us, moving.trajectory.poses[[0] * 6].copy())
    tracks = {
        "moving": moving,
        "still": Track("still", "car", moving.size, still),  # has no knots
        "late": late,
    }
    poses = TrackPoses(tracks, [view(i) for i in range(6)])
    with torch.no_grad():
        poses.table.value[:] = 0.1 * torch.arange(40.0).view(10, 4)
    for time in (0, 130_000, 250_000, 500_000):
        found = poses.world_from_actors(time)
        assert list(found) == (["moving", "still"] if time == 500_000 else list(tracks))
        for name, pose in found.items():
            if name != "still" and time % 100_000:
                continue  # between labels offsets are interpolated, not what they make of a pose
            expected = poses.refined(name).at(time)
            assert np.allclose(pose.detach().numpy(), expected, atol=1e-5), (name, time)
    poses.world_from_actors(250_000)["moving"][0, 3].backward()
    gradient = poses.table.value.grad
    assert gradient is not None and gradient[:, 0].nonzero()[:, 0].tolist() == [2, 3]
    alone = TrackPoses({"still": tracks["still"]}, [view(i) for i in range(6)])
    assert np.allclose(alone.world_from_actors(0)["still"].detach().numpy(), still.poses[0])
