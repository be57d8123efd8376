"""Made-up streets of flat Gaussians whose light is known."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from recast.geometry import se3
from recast.logs import Trajectory
from recast.scene import SceneActor, SkyMap, StreetScene
from recast.scene.light import SceneLight, SunBelief
from recast.scene.light.sun import Patches, directions
from recast.splats import Gaussians
from recast.splats.gaussians import C0

Array = NDArray[np.float64]

SIZE = np.array([4.0, 2.0, 1.5])
SKY = 0.8  # display value
LIT, SHADED = 0.45, 0.2  # display values of road, grey


def sheet(points: Array, normals: Array, display: Array, spacing: float = 0.5) -> Gaussians:
    """Flat Gaussians at (N, 3), facing (N, 3), of a grey (N,)."""
    normals = np.broadcast_to(normals, points.shape)
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frames = np.stack([first, np.cross(normals, first), normals], axis=-1)
    count = len(points)
    grey = np.broadcast_to(np.asarray(display, np.float64), (count,)).copy()
    return Gaussians(
        means=torch.from_numpy(points).float(),
        quats=torch.from_numpy(se3.matrix_to_quat(frames)).float(),
        log_scales=torch.log(torch.tensor([spacing / 2, spacing / 2, 0.01])).repeat(count, 1),
        logit_opacities=torch.full((count,), 3.0),
        sh=((torch.from_numpy(grey).float() - 0.5) / C0)[:, None, None].repeat(1, 1, 3),
    )


def grid(x: tuple[float, float], y: tuple[float, float], spacing: float = 0.5) -> Array:
    """(N, 3) places on the ground."""
    axes = [np.arange(low, high, spacing) + spacing / 2 for low, high in (x, y)]
    flat = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)


def pose(x: float, y: float = 0.0, heading: float = 0.0) -> Array:
    """`world_from_actor` of a vehicle of `SIZE` on the ground."""
    return se3.from_rotation_translation(se3.rotation_z(heading), [x, y, SIZE[2] / 2])


def street(background: Gaussians, actor: Gaussians | None = None) -> StreetScene:
    """A street whose vehicle drove from x = 0 to 40 along y = 0."""
    poses = np.array([pose(x) for x in np.linspace(0.0, 40.0, 41)])
    times = np.arange(len(poses), dtype=np.int64) * 100_000
    vehicle = sheet(np.zeros((1, 3)), np.array([0.0, 0.0, 1.0]), np.array([0.5]))
    driven = SceneActor("7", actor or vehicle, SIZE, Trajectory(times, poses))
    return StreetScene(background, {"7": driven}, SkyMap.constant(torch.full((3,), SKY)))


def half_shaded() -> StreetScene:
    """Road along x, in the sun up to x = 20 and in the shade beyond."""
    road = grid((-5, 45), (-4, 4))
    display = np.where(road[:, 0] < 20, LIT, SHADED)
    return street(sheet(road, np.array([0.0, 0.0, 1.0]), display))


def sun_at(azimuth: float, elevation: float) -> SunBelief:
    """Certain of the direction nearest to this, radians."""
    towards, _ = directions()
    wanted = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation)]
    nearest = int((towards @ np.array([*wanted, np.sin(elevation)])).argmax())
    return SunBelief(np.eye(len(towards))[nearest])


def light(sun: SunBelief) -> SceneLight:
    """A street without any road, under a sun."""
    nothing = Patches(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    return SceneLight(sun, SKY**2.2, None, nothing)
