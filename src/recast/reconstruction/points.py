"""Points of a street: LiDAR split by owner, plane sweeps, and clouds that become Gaussians.

Where the LiDAR does not reach, several views are compared: every depth hypothesis warps images
beside the reference view onto it by the homography of a fronto-parallel plane; the hypothesis under
which they agree best with the reference wins (Collins 1996). Costs are sums of absolute differences
over a window, and the best two neighbours count, so that a neighbour that is occluded there does no
harm (Kang et al. 2001).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.arrays import Array, Float32Array, Mask
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import DrivingLog, LidarSweep, Track
from recast.reconstruction.settings import INIT
from recast.reconstruction.views import DepthSamples, TrainingView
from recast.scene.street_scene import pose_at
from recast.splats import Gaussians, morton_order
from recast.splats.gaussians import C0


@dataclass(frozen=True)
class OwnedSweep:
    """A sweep divided by what its points lie on.

    Attributes:
        timestamp_us: time of the sweep.
        background: (N, 3) float32, world frame. The ground at a moving object's feet is in neither
            part: its shadow darkens it.
        actors: (M, 3) float32 by track id, actor-local frame.
    """

    timestamp_us: int
    background: Float32Array
    actors: Mapping[str, Float32Array]


def read_sweeps(
    log: DrivingLog, actors: Mapping[str, Track], held_out_us: Sequence[int]
) -> list[OwnedSweep]:
    """All sweeps but those taken together with a held-out image."""
    sweeps = []
    held_out = np.asarray(held_out_us, np.int64)
    for stream in log.lidars.values():
        for index, timestamp in enumerate(stream.timestamps_us.tolist()):
            if held_out.size and np.min(np.abs(held_out - timestamp)) < INIT.held_out_us:
                continue
            sweeps.append(_divide(stream.sweeps[index], log.world_from_rig.at(timestamp), actors))
    return sorted(sweeps, key=lambda sweep: sweep.timestamp_us)


def _divide(sweep: LidarSweep, world_from_rig: Array, actors: Mapping[str, Track]) -> OwnedSweep:
    world = se3.apply(world_from_rig, sweep.points)
    free = np.ones(len(world), bool)
    local_points = {}
    for track_id, track in actors.items():
        rough = pose_at(track.trajectory, sweep.timestamp_us)
        if rough is None:
            continue
        reach = np.linalg.norm(track.size) / 2 + 2.5
        near = np.flatnonzero(np.linalg.norm(world - rough[:3, 3], axis=1) < reach)
        if len(near) == 0:
            continue
        pose = rough
        if sweep.point_timestamps_us is not None:
            # The laser crosses an object within a few milliseconds: one pose serves all its points.
            moment = int(np.median(sweep.point_timestamps_us[near]))
            exact = pose_at(track.trajectory, moment)
            pose = rough if exact is None else exact
        local = se3.apply(se3.inverse(pose), world[near])
        half = track.size / 2
        inside = np.all(np.abs(local) <= half + INIT.box_margin_m, axis=1)
        free[near[inside]] = False
        above = local[:, 2] >= INIT.box_ground_m - half[2]
        local_points[track_id] = local[inside & above].astype(np.float32)
    return OwnedSweep(sweep.timestamp_us, world[free].astype(np.float32), local_points)


def depth_samples(
    view: TrainingView,
    sweeps: Sequence[OwnedSweep],
    actors: Mapping[str, Track],
    window_us: int = INIT.depth_window_us,
) -> DepthSamples:
    """Depths of one view from the sweeps around its time, moving objects carried along.

    Background points are taken where they lie in the world; points of an actor are moved with its
    box from the sweep's time to the view's. Points hidden behind nearer ones are dropped (the
    sweeps were taken from other places than the view).
    """
    clouds = []
    for sweep in sweeps:
        if abs(sweep.timestamp_us - view.timestamp_us) > window_us:
            continue
        clouds.append(sweep.background)
        for track_id, local in sweep.actors.items():
            pose = pose_at(actors[track_id].trajectory, view.timestamp_us)
            if pose is not None:
                clouds.append(se3.apply(pose, local).astype(np.float32))
    if not clouds:
        clouds.append(np.zeros((0, 3), np.float32))
    _, uv, depth = project_visible(np.concatenate(clouds), view)
    return DepthSamples(depth, uv)


def project_visible(
    points: Float32Array, view: TrainingView
) -> tuple[NDArray[np.int64], Float32Array, Float32Array]:
    """Points (N, 3) of the world that a view sees: (index, uv (M, 2), depth (M,)).

    A point counts as hidden where one in the pixels around it, up to `hiding_px` away, is nearer by
    more than 5 % and 0.3 m.
    """
    camera = view.camera
    camera_from_world = view.camera_from_world.astype(np.float32)
    local = points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    index = np.flatnonzero((local[:, 2] > INIT.nearest_m) & (local[:, 2] < INIT.farthest_m))
    local = local[index]
    u = local[:, 0] / local[:, 2] * np.float32(camera.fx) + np.float32(camera.cx)
    v = local[:, 1] / local[:, 2] * np.float32(camera.fy) + np.float32(camera.cy)
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    index, u, v, depth = index[inside], u[inside], v[inside], local[inside, 2]
    buffer = np.full((camera.height, camera.width), INIT.farthest_m, np.float32)
    rows, columns = v.astype(np.int64), u.astype(np.int64)
    np.minimum.at(buffer, (rows, columns), depth)
    around = np.ones((2 * INIT.hiding_px + 1, 2 * INIT.hiding_px + 1), np.uint8)
    nearest = cv2.erode(buffer, around)[rows, columns]
    seen = depth < np.maximum(1.05 * nearest, nearest + 0.3)
    return index[seen], np.stack([u, v], -1)[seen], depth[seen]


@dataclass(frozen=True)
class PointCloud:
    """Coloured points.

    Attributes:
        points: (N, 3) float32 metres.
        colours: (N, 3) float32 in [0, 1].
        distances: (N,) float32 metres to the camera that gave the colour.
    """

    points: Float32Array
    colours: Float32Array
    distances: Float32Array

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def empty(cls) -> PointCloud:
        """No points."""
        return cls(*(np.zeros(shape, np.float32) for shape in ((0, 3), (0, 3), (0,))))

    def select(self, index: NDArray[np.generic]) -> PointCloud:
        """The points at an index or mask."""
        return PointCloud(self.points[index], self.colours[index], self.distances[index])


def concatenate(clouds: list[PointCloud]) -> PointCloud:
    """One cloud of several; none gives an empty one."""
    members = zip(*(vars(cloud).values() for cloud in [PointCloud.empty(), *clouds]), strict=True)
    return PointCloud(*(np.concatenate(parts) for parts in members))


def voxel_downsample(cloud: PointCloud, voxel_m: float) -> PointCloud:
    """One point a voxel: the one that a camera saw from nearest, for the sharpest colour."""
    if len(cloud) == 0:
        return cloud
    cells = np.floor(cloud.points / voxel_m).astype(np.int64)
    cells -= cells.min(axis=0)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    order = np.lexsort((cloud.distances, keys))
    first = np.ones(len(order), bool)
    first[1:] = np.diff(keys[order]) != 0
    return cloud.select(order[first])


def thinned(cloud: PointCloud, share: float, rng: np.random.Generator) -> PointCloud:
    """A share of the points, at least one and in their order; all of them from a share of 1 on."""
    if share >= 1 or len(cloud) == 0:
        return cloud
    count = max(1, int(share * len(cloud)))
    return cloud.select(np.sort(rng.choice(len(cloud), count, replace=False)))


def neighbour_distance(points: Float32Array) -> Float32Array:
    """Root mean square distance (N,) to the nearest three other points, metres."""
    if len(points) <= 3:
        return np.full(len(points), 0.1, np.float32)
    distance, _ = cKDTree(points).query(points, k=4)
    return np.sqrt((distance[:, 1:] ** 2).mean(axis=1)).astype(np.float32)


def surface_frames(points: Float32Array) -> tuple[Array, Array]:
    """Principal axes of every point and its nearest ten others.

    Returns:
        rotations (N, 3, 3), columns the axes from the thinnest on, right-handed, and the spread
        (N, 3) along them in metres. Identity and equal spreads where there are too few points.
    """
    n, neighbours = len(points), 10
    if n <= neighbours:
        return np.broadcast_to(np.eye(3), (n, 3, 3)).copy(), np.ones((n, 3))
    _, index = cKDTree(points).query(points, k=neighbours + 1)
    offsets = points[index] - points[index].mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets).astype(np.float64))
    axes[np.linalg.det(axes) < 0, :, 2] *= -1
    return axes, np.sqrt(np.maximum(values, 0) / (neighbours + 1))


def gaussians_from_points(
    cloud: PointCloud, sh_degree: int, sigma_range: tuple[float, float] = INIT.background_sigma_m
) -> Gaussians:
    """Gaussians in Morton order, sigma = `width` x rms distance to three neighbours.

    Where the neighbourhood is flat, they are discs in its plane, `flatness` as thick as wide, so
    that a road seen from another lane is still one surface; elsewhere they are balls.

    Args:
        sigma_range: least and largest standard deviation along the surface, metres.
    """
    cloud = cloud.select(morton_order(torch.from_numpy(cloud.points)).numpy())
    n = len(cloud)
    sigma = np.clip(INIT.width * neighbour_distance(cloud.points), *sigma_range)
    axes, spread = surface_frames(cloud.points)
    flat = spread[:, 0] < INIT.flatness * spread[:, 1]
    axes[~flat] = np.eye(3)
    scales = np.repeat(sigma[:, None], 3, axis=1)
    scales[flat, 0] = np.maximum(INIT.flatness * sigma[flat], sigma_range[0])
    sh = torch.zeros(n, (sh_degree + 1) ** 2, 3)
    sh[:, 0] = (torch.from_numpy(cloud.colours) - 0.5) / C0
    return Gaussians(
        means=torch.from_numpy(cloud.points.astype(np.float32)),
        quats=torch.from_numpy(se3.matrix_to_quat(axes).astype(np.float32)),
        log_scales=torch.from_numpy(np.log(scales).astype(np.float32)),
        logit_opacities=torch.full((n,), float(np.log(INIT.opacity / (1 - INIT.opacity)))),
        sh=sh,
    )


def sweep_depths(
    views: Sequence[TrainingView],
    references: Sequence[int],
    wanted: Sequence[Mask],
    threads: int = 1,
    range_m: tuple[float, float] = INIT.sweep_range_m,
) -> list[Float32Array]:
    """Depth maps (H, W) of reference views, metres along the camera axis, 0 where unknown.

    Args:
        views: views of one camera in order of time; neighbours are taken from these alone.
        references: indices into `views`.
        wanted: (H, W) mask per reference: pixels outside are not asked for.
        range_m: nearest and farthest depth that is tried, metres.
    """
    near, far = range_m
    inverse = np.linspace(1 / far, 1 / near, INIT.sweep_hypotheses)

    def run(task: tuple[int, Mask]) -> Float32Array:
        reference, mask = task
        beside = [reference + step for step in INIT.sweep_neighbours]
        neighbours = [views[number] for number in beside if 0 <= number < len(views)]
        return _sweep(views[reference], neighbours, mask, inverse)

    tasks = list(zip(references, wanted, strict=True))
    if threads <= 1:
        return [run(task) for task in tasks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(run, tasks))


def _sweep(
    reference: TrainingView, neighbours: Sequence[TrainingView], wanted: Mask, inverse: Array
) -> Float32Array:
    result = np.zeros(wanted.shape, np.float32)
    rows = np.flatnonzero(wanted.any(axis=1))
    if len(rows) == 0 or len(neighbours) < 2:
        return result
    half = INIT.sweep_window_px // 2
    top, bottom = max(0, rows[0] - half), min(len(wanted), rows[-1] + half + 1)
    image = _grey(reference)[top:bottom]
    camera = reference.camera.cropped(0, int(top), reference.camera.width, int(bottom - top))
    greys = [_grey(other) for other in neighbours]
    volume = np.empty((len(inverse), *image.shape[:2]), np.float32)
    for i, value in enumerate(inverse):
        costs = [
            _cost(image, camera, reference, other, grey, value)
            for other, grey in zip(neighbours, greys, strict=True)
        ]
        volume[i] = _mean_of_best_two(costs)
    index, accepted = _winner(volume)
    grey = image.astype(np.float32) / 255
    size = (INIT.sweep_window_px, INIT.sweep_window_px)
    variance = cv2.blur(grey * grey, size) - cv2.blur(grey, size) ** 2
    accepted &= variance > INIT.sweep_least_texture**2
    accepted &= wanted[top:bottom]
    step = inverse[1] - inverse[0]
    depth = 1 / (inverse[0] + index * step)
    result[top:bottom][accepted] = depth[accepted]
    return result


def _cost(
    image: NDArray[np.uint8],
    camera: PinholeCamera,
    reference: TrainingView,
    other: TrainingView,
    other_grey: NDArray[np.uint8],
    inverse_depth: float,
) -> Float32Array:
    """Mean absolute difference (H, W) in [0, 1] over windows; high where one is not seen."""
    other_from_reference = other.camera_from_world @ reference.world_from_camera
    plane = other_from_reference[:3, :3].copy()
    plane[:, 2] += other_from_reference[:3, 3] * inverse_depth  # R + t n^T / d with n = z
    homography = other.camera.matrix @ plane @ np.linalg.inv(camera.matrix)
    shift = np.array([[1.0, 0, -0.5], [0, 1.0, -0.5], [0, 0, 1.0]])  # OpenCV's pixel centres
    homography = shift @ homography @ np.linalg.inv(shift)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (image.shape[1], image.shape[0])
    warped = cv2.warpPerspective(other_grey, homography, size, flags=flags)
    difference = cv2.absdiff(image, warped)
    difference[warped == 0] = 255  # `_grey` keeps 0 for what lies outside the image
    cost = cv2.boxFilter(difference, cv2.CV_32F, (INIT.sweep_window_px, INIT.sweep_window_px))
    return np.asarray(cost, np.float32) * np.float32(1 / 255)


def _grey(view: TrainingView) -> NDArray[np.uint8]:
    return np.maximum(cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY), 1)


def _mean_of_best_two(costs: Sequence[Float32Array]) -> Float32Array:
    best = np.minimum(costs[0], costs[1])
    second = np.maximum(costs[0], costs[1])
    for cost in costs[2:]:
        second = np.minimum(second, np.maximum(best, cost))
        best = np.minimum(best, cost)
    return (best + second) * np.float32(0.5)


def _winner(volume: Float32Array) -> tuple[Array, Mask]:
    """Best hypothesis at every pixel, refined by a parabola, and whether it is to be trusted."""
    count = len(volume)
    best = volume.argmin(axis=0)
    cost = np.take_along_axis(volume, best[None], 0)[0]
    interior = (best > 0) & (best < count - 1)
    middle = np.clip(best, 1, count - 2)
    before = np.take_along_axis(volume, middle[None] - 1, 0)[0]
    centre = np.take_along_axis(volume, middle[None], 0)[0]
    after = np.take_along_axis(volume, middle[None] + 1, 0)[0]
    curvature = before - 2 * centre + after
    offset = np.where(curvature > 1e-6, 0.5 * (before - after) / np.maximum(curvature, 1e-6), 0.0)
    index = best + np.where(interior, np.clip(offset, -0.5, 0.5), 0.0)
    rival = np.full(cost.shape, np.inf, np.float32)
    for i in range(count):
        far_off = np.abs(best - i) > 3
        np.minimum(rival, np.where(far_off, volume[i], np.inf), out=rival)
    # The nearest hypothesis is where all that is nearer still ends up; the farthest is honest.
    better = (cost < INIT.sweep_most_cost) & (rival > INIT.sweep_least_ratio * cost)
    return index, better & (best < count - 1)
