"""Small checkpoints in the layouts of Street Gaussians and DriveStudio, and a log beside them.

The ego drives straight, the car `CAR` curves ahead of it. What each trainer would draw is composed
here from the layouts' own rules, not with the importers' code.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import DrivingLog, LidarStream, Track, Trajectory
from recast.splats import Gaussians, Rasterization, concatenate, rasterize
from recast.splats.gaussians import matrix_to_quat, quat_multiply

CAR, PARKED = "car-a", "car-b"
FRAMES, START_US, STEP_US = 11, 1_000_000_000, 100_000
OFFSET = np.array([3000.0, -500.0, 20.0])
CAMERA = PinholeCamera(64, 40, 45.0, 45.0, 32.0, 20.0)
RIG_FROM_CAMERA = se3.from_rotation_translation(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [1.5, 0.0, 1.5]
)
TIMES = START_US + STEP_US * np.arange(FRAMES)
MIDDLE = FRAMES // 2


def world_from_rig(frame: float) -> np.ndarray:
    """True ego pose (4, 4)."""
    return se3.from_rotation_translation(se3.rotation_z(0.3), [0.8 * frame, 0.25 * frame, 0.0])


def world_from_car(frame: float) -> np.ndarray:
    """True pose of the moving car (4, 4)."""
    place = se3.apply(world_from_rig(0.8 * frame), np.array([[10.0, 0.5, 0.8]]))[0]
    return se3.from_rotation_translation(se3.rotation_z(0.3 + 0.08 * frame), place)


def world_from_parked(frame: float) -> np.ndarray:
    """True pose of the parked car (4, 4)."""
    return se3.from_rotation_translation(se3.rotation_z(-1.0), [14.0, 8.0, 0.8])


def make_log() -> DrivingLog:
    """The drive without images; its LiDAR gives the frames' times."""
    size = np.array([4.2, 1.8, 1.6])
    tracks = {
        name: Track(name, "car", size, Trajectory(TIMES, np.stack([f(i) for i in range(FRAMES)])))
        for name, f in ((CAR, world_from_car), (PARKED, world_from_parked))
    }
    # Poses also lie between frames and beyond them, as camera times do.
    frames = np.arange(-1, FRAMES + 1)
    ego = Trajectory(
        START_US + STEP_US * frames, np.stack([world_from_rig(float(i)) for i in frames])
    )
    lidar = LidarStream("lidar", np.eye(4), TIMES, [None] * FRAMES)  # type: ignore[arg-type]
    return DrivingLog("drive", {}, {"lidar": lidar}, ego, tracks, world_offset=OFFSET)


def make_gaussians(
    count: int, centre: np.ndarray, spread: np.ndarray, degree: int, seed: int
) -> Gaussians:
    """Random Gaussians whose colours stay within (0, 1) from all sides."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    place = torch.rand(count, 3, generator=generator) - 0.5
    constant = 0.3 * normal(count, 1, 3).clamp(-1, 1)
    return Gaussians(
        means=place * torch.tensor(spread).float() + torch.tensor(centre).float(),
        quats=normal(count, 4),
        log_scales=0.3 * normal(count, 3) - 1.6,
        logit_opacities=normal(count),
        sh=torch.cat([constant, 0.05 * normal(count, (degree + 1) ** 2 - 1, 3)], dim=1),
    )


def make_background(degree: int) -> Gaussians:
    """Along the drive, in the log's world."""
    return make_gaussians(300, np.array([12.0, 4.0, 1.0]), np.array([34.0, 16.0, 4.0]), degree, 1)


def make_car(degree: int, seed: int = 2) -> Gaussians:
    """In the box frame; harmonics in the axes that the layout says."""
    return make_gaussians(80, np.zeros(3), np.array([4.0, 1.6, 1.4]), degree, seed)


def sky_colour(directions: torch.Tensor) -> torch.Tensor:
    """A smooth sky (M, 3) by direction (M, 3) in the cube's axes."""
    unit = directions / directions.norm(dim=-1, keepdim=True)
    return 0.5 + 0.35 * unit


def make_cubemap(resolution: int = 48) -> torch.Tensor:
    """`sky_colour` on the faces (6, R, R, 3), at the texels' centres."""
    steps = (torch.arange(resolution) + 0.5) / resolution * 2 - 1
    gy, gx = torch.meshgrid(steps, steps, indexing="ij")
    one = torch.ones_like(gx)
    faces = [
        (one, -gy, -gx),
        (-one, -gy, gx),
        (gx, one, gy),
        (gx, -one, -gy),
        (gx, -gy, one),
        (-gx, -gy, -one),
    ]
    return torch.stack([sky_colour(torch.stack(face, dim=-1)) for face in faces])


def moved(gaussians: Gaussians, pose: np.ndarray, keep_colours: bool) -> Gaussians:
    """Placed at a pose; harmonics stay as they are, in scene axes, or turn along."""
    turned = gaussians.transformed(torch.from_numpy(pose))
    if not keep_colours:
        return turned
    turn = matrix_to_quat(torch.from_numpy(pose[:3, :3]).float())
    quats = quat_multiply(turn.expand_as(gaussians.quats), gaussians.quats)
    return replace(turned, quats=quats, sh=gaussians.sh)


def rasterized(parts: Sequence[Gaussians], camera_from_scene: np.ndarray) -> Rasterization:
    """All parts at once through `CAMERA`, on black."""
    return rasterize(
        concatenate(parts),
        torch.from_numpy(camera_from_scene).float(),
        torch.from_numpy(CAMERA.matrix).float(),
        CAMERA.width,
        CAMERA.height,
    )


def draw(
    parts: list[Gaussians], camera_from_scene: np.ndarray, cube_from_scene: np.ndarray
) -> np.ndarray:
    """What a trainer draws (H, W, 3), not clamped: all parts at once, then the sky."""
    result = rasterized(parts, camera_from_scene)
    rays = CAMERA.rays(CAMERA.pixel_grid()) @ camera_from_scene[:3, :3]
    sky = sky_colour(torch.from_numpy(rays @ cube_from_scene.T).float())
    return (result.rgb + (1 - result.alpha)[..., None] * sky.view_as(result.rgb)).numpy()


def camera_from_world(frame: float) -> np.ndarray:
    """(4, 4), OpenCV axes, on the ego."""
    return se3.inverse(world_from_rig(frame) @ RIG_FROM_CAMERA)


def street_gaussians_part(gaussians: Gaussians, fourier: torch.Tensor | None = None) -> dict:
    """One model's table; `fourier` (N, F, 3) stands for the constant harmonic."""
    constant = gaussians.sh[:, :1] if fourier is None else fourier
    return {
        "xyz": torch.nn.Parameter(gaussians.means),
        "feature_dc": torch.nn.Parameter(constant.contiguous()),
        "feature_rest": torch.nn.Parameter(gaussians.sh[:, 1:].contiguous()),
        "scaling": torch.nn.Parameter(gaussians.log_scales),
        "rotation": torch.nn.Parameter(gaussians.quats),
        "opacity": torch.nn.Parameter(gaussians.logit_opacities[:, None]),
        "semantic": torch.zeros(len(gaussians), 0),
    }


def drivestudio_part(gaussians: Gaussians) -> dict:
    """One model's state dict."""
    return {
        "_means": gaussians.means,
        "_scales": gaussians.log_scales,
        "_quats": gaussians.quats,
        "_features_dc": gaussians.sh[:, 0].clone(),
        "_features_rest": gaussians.sh[:, 1:].clone(),
        "_opacities": gaussians.logit_opacities[:, None],
    }


def write_street_gaussians_folder(folder: Path, tracks: list[tuple[int, int]]) -> None:
    """The processed folder: rows (frame, track) of the label file in this order.

    Tracks are 3, the moving car, and 8, the parked one; 5 is seen by a side camera only, 6 a sign.
    """
    (folder / "ego_pose").mkdir(parents=True)
    (folder / "track").mkdir()
    stamps: dict[str, dict[str, float]] = {"FRAME": {}, "FRONT": {}}
    for frame in range(FRAMES):
        for name, delay in (("", 0.0), ("_0", 0.4)):
            pose = world_from_rig(frame + delay)
            pose[:3, 3] += OFFSET
            np.savetxt(folder / "ego_pose" / f"{frame:06d}{name}.txt", pose)
        stamps["FRAME"][f"{frame:06d}"] = TIMES[frame] / 1e6
        stamps["FRONT"][f"{frame:06d}"] = (TIMES[frame] + 0.4 * STEP_US) / 1e6
    (folder / "timestamps.json").write_text(json.dumps(stamps))
    lines = ["frame_id track_id object_class alpha h w l x y z heading speed"]
    true = {3: world_from_car, 8: world_from_parked}
    for frame, track in tracks:
        pose = se3.inverse(world_from_rig(frame)) @ true.get(track, world_from_car)(frame)
        x, y, z = pose[:3, 3]
        kind = "sign" if track == 6 else "vehicle"
        lines.append(
            f"{frame} {track} {kind} -10 1.6 1.8 4.2 {x:.9f} {y:.9f} {z:.9f} "
            f"{se3.yaw(pose):.9f} 1.0"
        )
    (folder / "track" / "track_info.txt").write_text("\n".join(lines) + "\n")
    seen = {
        str(track): {str(frame): [3 if track == 5 else 0] for frame in range(FRAMES)}
        for track in (3, 5, 6, 8)
    }
    (folder / "track" / "track_camera_vis.json").write_text(json.dumps(seen))
    ids = {CAR: 3, "side": 5, "sign": 6, PARKED: 8}
    (folder / "track" / "track_ids.json").write_text(json.dumps(ids))
