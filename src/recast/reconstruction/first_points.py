"""First Gaussians of a scene: coloured LiDAR, plane sweep, actors, sky and the masks of the sky."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from recast.arrays import Array, Float32Array, Mask
from recast.core.errors import InputError
from recast.core.images import decode_mask
from recast.geometry import boxes, se3
from recast.logs import DrivingLog, GroundHeight, Track, ego_path, even_ground
from recast.logs.importers.waymo_proto import CAMERA_NAME
from recast.pretrained import PretrainedFolder
from recast.reconstruction.bodies import Body
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.points import (
    OwnedSweep,
    PointCloud,
    concatenate,
    depth_samples,
    gaussians_from_points,
    project_visible,
    read_sweeps,
    sweep_depths,
    thinned,
    voxel_downsample,
)
from recast.reconstruction.settings import INIT
from recast.reconstruction.views import (
    DepthSamples,
    TrainingView,
    deforms,
    fit_mask,
    near_samples,
    nearest_views,
    visible_rectangle,
)
from recast.scene.actor import with_other_side
from recast.scene.sky import SkyMap, direction_coordinates, sky_from_pixels
from recast.scene.street_scene import DEFORMABLE, pose_at
from recast.splats import Gaussians
from recast.splats import concatenate as joined
from recast.splats.gaussians import C0

OPAQUE_LOGIT = math.log(INIT.unseen_opacity / (1 - INIT.unseen_opacity))
"""Logit of the opacity of what no image shows."""
_WAYMO = tuple(CAMERA_NAME.names.values())
"""Waymo's cameras by their number in names of files."""
_FILE = re.compile(r"(\d+)_(.+)\.png", re.IGNORECASE)
_NAMES = "name them FRAME_CAMERA.png, with the log's name of the camera or Waymo's number of it"


def sky_masks(
    log: DrivingLog,
    views: Sequence[TrainingView],
    depths: Sequence[DepthSamples],
    config: SceneConfig,
) -> list[Mask]:
    """Sky of each view (H, W) bool, by the method that the configuration names.

    Args:
        depths: LiDAR depths of the views; the guess takes no pixel near a LiDAR return.

    Raises:
        InputError: files or network are missing, or are not what is needed.
    """
    if config.sky_mask == "heuristic":
        return [
            sky_mask(view.image, near_samples(view, samples))
            for view, samples in zip(views, depths, strict=True)
        ]
    if not config.sky_mask_path:
        kind = "a folder of PNG files" if config.sky_mask == "files" else "a SegFormer folder"
        raise InputError("configuration", "sky_mask_path", "is not given", f"name {kind}")
    folder = Path(config.sky_mask_path)
    if config.sky_mask == "files":
        return list(_from_files(log, views, config.scale, folder))
    return list(_from_network(views, folder))


def _from_files(
    log: DrivingLog, views: Sequence[TrainingView], scale: float, folder: Path
) -> Iterator[Mask]:
    """Masks as the processed folders of DriveStudio and Street Gaussians hold them: white is sky.

    The files of a camera, in order of their frame numbers, belong to its images in order.
    """
    if not folder.is_dir():
        raise InputError(folder, "sky masks", "is not a folder", "check sky_mask_path")
    by_camera: dict[str, dict[int, Path]] = {}
    for path in sorted(folder.iterdir()):
        found = _FILE.fullmatch(path.name)
        if found is not None:
            by_camera.setdefault(_camera(log, found[2]), {})[int(found[1])] = path
    ordered = {}
    for name in dict.fromkeys(view.camera_name for view in views):
        files, images = by_camera.get(name, {}), len(log.cameras[name].timestamps_us)
        if len(files) != images:
            raise InputError(
                folder, f"camera {name}", f"has {len(files)} masks, the log {images} images", _NAMES
            )
        ordered[name] = [files[frame] for frame in sorted(files)]
    for view in views:
        camera = log.cameras[view.camera_name].camera
        mask = _read_mask(ordered[view.camera_name][view.frame], camera.width, camera.height)
        yield fit_mask(camera, mask, scale)


def _camera(log: DrivingLog, name: str) -> str:
    """The log's camera that a file name means: by its name, or by Waymo's number."""
    numbered = _WAYMO[int(name)] if name.isdigit() and int(name) < len(_WAYMO) else name
    return name if name in log.cameras else numbered


def _read_mask(path: Path, width: int, height: int) -> Mask:
    return decode_mask(path, path, (width, height), "the image", what="sky mask") > 127


def _from_network(views: Sequence[TrainingView], folder: Path) -> Iterator[Mask]:
    """Masks of a SegFormer that knows a class called sky; no code of the folder runs."""
    published = PretrainedFolder(
        folder,
        "segformer",
        "SegformerForSemanticSegmentation",
        "SegformerImageProcessor",
        "nvidia/segformer-b5-finetuned-cityscapes-1024-1024",
    )
    processor, network = published.read("cpu")
    labels = {str(name).lower(): int(index) for index, name in network.config.id2label.items()}
    if "sky" not in labels:
        known = ", ".join(sorted(labels)[:8])
        raise InputError(
            folder,
            "config.json",
            f"has no class `sky` (its classes are {known})",
            "use a network trained on Cityscapes or ADE20K",
        )
    for view in views:
        with torch.inference_mode():
            outputs = network(**processor(images=view.image, return_tensors="pt"))
        size = (view.camera.height, view.camera.width)
        classes = processor.post_process_semantic_segmentation(outputs, target_sizes=[size])[0]
        found: NDArray[np.bool_] = (classes == labels["sky"]).numpy()
        yield found


def sky_mask(image: NDArray[np.uint8], occupied: Mask) -> Mask:
    """Guess the sky (H, W) of one image.

    A pixel is taken for sky where it is bright or clearly blue, its surroundings are smooth, no
    LiDAR point is near, and a chain of such pixels leads to the top edge. Errs on the small side:
    the sky loss only needs pixels that are surely sky.

    Args:
        image: (H, W, 3) RGB.
        occupied: (H, W) pixels on or near a LiDAR return, hence not sky.
    """
    rgb = image.astype(np.float32) / 255
    brightest = rgb.max(-1)
    blue = rgb[..., 2] - rgb[..., 0]
    grey = rgb @ np.array([0.299, 0.587, 0.114], np.float32)
    dx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3, scale=0.25)
    dy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3, scale=0.25)
    smooth = np.hypot(dx, dy) < INIT.sky_largest_step
    # Foliage and walls lit by the sun are bright too, but warm: red above blue.
    bright = (brightest > INIT.sky_least_bright) & (blue > INIT.sky_least_blue)
    candidate = bright & smooth & ~occupied

    # Thin bright strips (frames of signs, lamps) touch the top edge too; the sky is wide.
    square = np.ones((5, 5), np.uint8)
    opened = cv2.dilate(cv2.erode(candidate.astype(np.uint8), square, borderValue=1), square)
    wide = candidate & (opened > 0)
    _, labels = cv2.connectedComponents(wide.astype(np.uint8), connectivity=4)
    from_top = np.unique(labels[0])
    mask = np.isin(labels, from_top[from_top > 0])
    # One pixel less at the border.
    return cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1).astype(bool)


@dataclass(frozen=True)
class Initialisation:
    """Where training starts.

    Attributes:
        background: world-frame Gaussians.
        actors: actor-local Gaussians by track id.
        sky: first sky map.
        sky_pixels: (S,) int64 flat indices of sure sky pixels, for each training view.
        depths: measured depths of each training view.
        ground: heights of even ground; None without such ground, or where it is left free.
        found: Gaussians that there would have been without `max_gaussians`; of what no image shows,
            those that there are.
    """

    background: Gaussians
    actors: dict[str, Gaussians]
    sky: SkyMap
    sky_pixels: list[NDArray[np.int64]]
    depths: list[DepthSamples]
    ground: GroundHeight | None = None
    found: int = 0

    def __len__(self) -> int:
        return len(self.background) + sum(len(part) for part in self.actors.values())


def initialise(
    log: DrivingLog,
    views: Sequence[TrainingView],
    actors: Mapping[str, Track],
    config: SceneConfig,
    rng: np.random.Generator,
    threads: int = 1,
    bodies: Mapping[str, Body] | None = None,
) -> Initialisation:
    """Build the first scene from the training views and the sweeps not taken with held-out ones.

    Args:
        views: all views; held-out ones lend their timestamps only.
        rng: thins the plane-sweep points, and all points where they are too many for
            `max_gaussians`.
        bodies: actors that begin as the vertices of a body, all of them.

    Raises:
        InputError: LiDAR and images together give next to no points.
    """
    training = [view for view in views if not view.held_out]
    sweeps = read_sweeps(log, actors, [view.timestamp_us for view in views if view.held_out])
    depths = [depth_samples(view, sweeps, actors) for view in training]
    skies = sky_masks(log, training, depths, config)
    clouds = [coloured_background(sweep, training, actors) for sweep in sweeps]
    lidar = voxel_downsample(concatenate(clouds), config.voxel_m)
    far = PointCloud.empty()
    if config.sweep_points:
        swept = plane_sweep_points(training, depths, skies, actors, threads)
        far = voxel_downsample(swept, config.voxel_m)
    if len(far) > config.sweep_points:
        far = far.select(np.sort(rng.choice(len(far), config.sweep_points, replace=False)))
    cloud = without_points_in_sky(concatenate([lidar, far]), training, skies)
    if len(cloud) < INIT.fewest_points:
        raise InputError(
            log.name,
            "LiDAR",
            f"{len(cloud)} points in view of the cameras, at least {INIT.fewest_points} are needed",
            "check the calibration, or import the sweeps",
        )
    clouds_of = {
        name: actor_cloud(track, sweeps, training, config) for name, track in actors.items()
    }
    bodies = bodies or {}
    found = len(cloud) + sum(
        len(own) * (1 + has_other_side(actors[name], config))
        for name, own in clouds_of.items()
        if name not in bodies
    )
    even = _even_ground(log, sweeps)
    unseen: list[Gaussians] = []
    if config.unseen_surfaces and len(lidar):
        unseen = unseen_surfaces(log, sweeps, lidar, even, config, rng)
    filled = sum(len(part) for part in unseen)
    share = 1.0
    if config.max_gaussians is not None:
        share = (INIT.first_share * config.max_gaussians - filled) / found
    found += filled + sum(len(body.vertices) for body in bodies.values())
    seen = gaussians_from_points(thinned(cloud, share, rng), config.sh_degree)
    return Initialisation(
        background=joined([seen, *unseen]),
        actors={
            name: body_gaussians(actors[name], bodies[name], own, config)
            if name in bodies
            else actor_gaussians(actors[name], thinned(own, share, rng), config)
            for name, own in clouds_of.items()
        },
        sky=_first_sky(training, skies),
        sky_pixels=[np.flatnonzero(sky) for sky in skies],
        depths=depths,
        ground=even if config.ground_tolerance_m > 0 else None,
        found=found,
    )


def _even_ground(log: DrivingLog, sweeps: Sequence[OwnedSweep]) -> GroundHeight | None:
    path = ego_path(log.world_from_rig)
    if path is None or not sweeps:
        return None
    found = even_ground((sweep.background.astype(np.float64) for sweep in sweeps), path)
    return found if np.isfinite(found.height).any() else None


def unseen_surfaces(
    log: DrivingLog,
    sweeps: Sequence[OwnedSweep],
    seen: PointCloud,
    even: GroundHeight | None,
    config: SceneConfig,
    rng: np.random.Generator,
) -> list[Gaussians]:
    """Opaque Gaussians where the LiDAR met something that no image shows, and below even ground.

    Without them the sky shows there, to a car that leaves the recorded line. Colours are those of
    the coloured points near by. What a training view does show is then learned as all else is.

    Args:
        seen: coloured LiDAR points.
        even: heights of even ground, if there is any.
        rng: thins the points where they are too many.
    """
    metric = np.array([1, 1, INIT.unseen_upright], np.float32)
    tree = cKDTree(seen.points * metric)
    count = min(INIT.unseen_colours, len(seen))

    def coloured(points: Float32Array) -> PointCloud:
        distance, index = tree.query(points * metric, k=range(1, count + 1))
        weight = 1 / (distance + 0.1)
        colours = (seen.colours[index] * weight[..., None]).sum(1) / weight.sum(1, keepdims=True)
        never = np.full(len(points), np.inf, np.float32)
        return PointCloud(points, colours.astype(np.float32), never)

    most = math.inf
    if config.max_gaussians is not None:
        most = INIT.unseen_share * config.max_gaussians
    found = []
    points = _uncoloured(log, sweeps, seen, config.voxel_m)
    if len(points):
        cloud = thinned(coloured(points), most / len(points), rng)
        sizes = (INIT.background_sigma_m[0], INIT.unseen_sigma_m)
        found.append(_opaque(gaussians_from_points(cloud, config.sh_degree, sizes)))
    if even is not None:
        step = 1
        while np.isfinite(even.height[::step, ::step]).sum() > most:
            step += 1
        heights = even.height[::step, ::step]
        rows, columns = np.nonzero(np.isfinite(heights))
        level = even.origin + even.cell * step * np.stack([columns, rows], axis=-1)
        below = heights[rows, columns] - INIT.unseen_below_m
        grid = np.column_stack([level, below]).astype(np.float32)
        found.append(_opaque(gaussians_from_points(coloured(grid), config.sh_degree)))
    return found


def _uncoloured(
    log: DrivingLog, sweeps: Sequence[OwnedSweep], seen: PointCloud, voxel_m: float
) -> Float32Array:
    """Points (N, 3) near the drive, one a voxel, that several sweeps hit and no coloured one is
    near: what moves without a label is hit in one place by few."""
    path = cKDTree(log.world_from_rig.poses[:, :2, 3])
    corner = log.world_from_rig.poses[:, :3, 3].min(axis=0) - 2 * INIT.street_reach_m
    bits = np.array([1 << 42, 1 << 21, 1], np.int64)
    found, voxels = [np.zeros((0, 3), np.float32)], [np.zeros(0, np.int64)]
    for sweep in sweeps:
        away, _ = path.query(sweep.background[:, :2], distance_upper_bound=INIT.street_reach_m)
        points = sweep.background[np.isfinite(away)]
        cells = np.floor((points - corner) / voxel_m).astype(np.int64).clip(0, (1 << 21) - 1)
        own, first = np.unique(cells @ bits, return_index=True)
        found.append(points[first])
        voxels.append(own)
    _, first, hits = np.unique(np.concatenate(voxels), return_index=True, return_counts=True)
    points = np.concatenate(found)[first[hits >= INIT.unseen_sweeps]]
    if len(points) == 0:
        return points
    away, _ = cKDTree(seen.points).query(points)
    return np.asarray(points[away > voxel_m], np.float32)


def _opaque(gaussians: Gaussians) -> Gaussians:
    return replace(gaussians, logit_opacities=torch.full((len(gaussians),), OPAQUE_LOGIT))


def _first_sky(views: Sequence[TrainingView], skies: Sequence[Mask]) -> SkyMap:
    directions, colours = [], []
    for view, sky in zip(views, skies, strict=True):
        rows, columns = np.nonzero(sky)
        directions.append(_directions(view, rows, columns))
        colours.append(view.image[rows, columns].astype(np.float32) / 255)
    return sky_from_pixels(np.concatenate(directions), np.concatenate(colours))


def _directions(view: TrainingView, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Array:
    rays = view.camera.rays(np.stack([columns, rows], axis=-1) + 0.5)
    directions: Array = (rays @ view.world_from_camera[:3, :3].T).astype(np.float32)
    return directions


def sky_cells(
    views: Sequence[TrainingView], sky_pixels: Sequence[NDArray[np.int64]], sky: SkyMap
) -> Tensor:
    """Cells (h, w) bool of a sky map that training images show, and those beside them.

    Args:
        sky_pixels: flat indices of sure sky pixels of each view.
    """
    height, width = sky.colours.shape[:2]
    seen = np.zeros((height, width), np.uint8)
    for view, pixels in zip(views, sky_pixels, strict=True):
        directions = _directions(view, *np.divmod(pixels, view.camera.width))
        place = direction_coordinates(torch.from_numpy(directions)).numpy()
        column, row = (place * [width, height]).astype(np.int64).T
        seen[row.clip(max=height - 1), column.clip(max=width - 1)] = 1
    # The guess errs on the small side, and pixels may lie farther apart than cells.
    return torch.from_numpy(cv2.dilate(seen, np.ones((5, 5), np.uint8)) > 0)


def pixel_colours(view: TrainingView, uv: Float32Array) -> Float32Array:
    """Image colours (M, 3) in [0, 1] at pixel coordinates (M, 2)."""
    rows, columns = uv[:, 1].astype(np.int64), uv[:, 0].astype(np.int64)
    return (view.image[rows, columns] / 255.0).astype(np.float32)


def usable_pixels(view: TrainingView, uv: Float32Array) -> Mask:
    """Which pixel coordinates (M, 2) the view's mask lets count."""
    if view.mask is None:
        return np.ones(len(uv), bool)
    return view.mask[uv[:, 1].astype(np.int64), uv[:, 0].astype(np.int64)]


def coloured_background(
    sweep: OwnedSweep, views: Sequence[TrainingView], actors: Mapping[str, Track]
) -> PointCloud:
    """A sweep's background points with colours from the views nearest in time, one a camera."""
    points = sweep.background
    clouds = []
    for view in nearest_views(views, sweep.timestamp_us, INIT.colour_us):
        index, uv, depth = project_visible(points, view)
        keep = usable_pixels(view, uv) & ~_behind_actors(view, uv, depth, actors)
        clouds.append(PointCloud(points[index[keep]], pixel_colours(view, uv[keep]), depth[keep]))
    return concatenate(clouds)


def _seen(view: TrainingView, actors: Mapping[str, Track]) -> Iterator[tuple[Track, Array, Array]]:
    """Tracks in a view with their pose (4, 4) and the rectangle (4,) of their box in the image."""
    for track in actors.values():
        pose = pose_at(track.trajectory, view.timestamp_us)
        rectangle = None if pose is None else visible_rectangle(track.size, pose, view)
        if pose is not None and rectangle is not None:
            yield track, pose, rectangle


def _behind_actors(
    view: TrainingView, uv: Float32Array, depth: Float32Array, actors: Mapping[str, Track]
) -> Mask:
    """Points whose pixel may show a moving object in front of them at the view's own time."""
    hidden = np.zeros(len(uv), bool)
    for track, pose, (left, top, right, bottom) in _seen(view, actors):
        inside = (uv[:, 0] >= left) & (uv[:, 0] < right) & (uv[:, 1] >= top) & (uv[:, 1] < bottom)
        nearest = se3.apply(view.camera_from_world, boxes.corners(track.size, pose))[:, 2].min()
        hidden |= inside & (depth > nearest)
    return hidden


def plane_sweep_points(
    views: Sequence[TrainingView],
    depths: Sequence[DepthSamples],
    skies: Sequence[Mask],
    actors: Mapping[str, Track],
    threads: int,
) -> PointCloud:
    """Points at pixels without LiDAR near by, from every third view of each camera.

    Sky, moving objects and unusable pixels are left out.

    Args:
        views: views in order of time within a camera; depths and skies are those of each view.
    """
    clouds = []
    for name in dict.fromkeys(view.camera_name for view in views):
        own = [i for i, view in enumerate(views) if view.camera_name == name]
        references = range(1, len(own) - 1, INIT.sweep_stride)
        wanted = []
        for reference in references:
            i = own[reference]
            sky = cv2.dilate(skies[i].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
            mask = ~sky & ~near_samples(views[i], depths[i])
            wanted.append(mask & ~_actor_pixels(views[i], actors))
        maps = sweep_depths([views[i] for i in own], references, wanted, threads=threads)
        clouds += [
            _unproject(views[own[reference]], depth)
            for reference, depth in zip(references, maps, strict=True)
        ]
    return concatenate(clouds)


def _actor_pixels(view: TrainingView, actors: Mapping[str, Track]) -> Mask:
    covered = np.zeros((view.camera.height, view.camera.width), bool)
    if view.mask is not None:
        covered |= ~view.mask
    for _, _, rectangle in _seen(view, actors):
        left, top = np.floor(rectangle[:2]).astype(int) - 3
        right, bottom = np.ceil(rectangle[2:]).astype(int) + 3
        covered[max(top, 0) : bottom, max(left, 0) : right] = True
    return covered


def _unproject(view: TrainingView, depth: Float32Array) -> PointCloud:
    rows, columns = np.nonzero(depth)
    distance = depth[rows, columns]
    pixels = np.stack([columns, rows], axis=-1) + 0.5
    points = se3.apply(view.world_from_camera, view.camera.unproject(pixels, distance))
    colours = (view.image[rows, columns] / 255.0).astype(np.float32)
    return PointCloud(points.astype(np.float32), colours, distance)


def without_points_in_sky(
    cloud: PointCloud, views: Sequence[TrainingView], skies: Sequence[Mask]
) -> PointCloud:
    """Drop points that two views see in front of plain sky: wrong matches, stray returns."""
    hits = np.zeros(len(cloud), np.int64)
    for view, sky in zip(views, skies, strict=True):
        local = cloud.points @ view.camera_from_world[:3, :3].T.astype(np.float32)
        local += view.camera_from_world[:3, 3].astype(np.float32)
        front = np.flatnonzero(local[:, 2] > 1.0)
        uv = local[front, :2] / local[front, 2:]
        columns = np.floor(uv[:, 0] * view.camera.fx + view.camera.cx).astype(np.int64)
        rows = np.floor(uv[:, 1] * view.camera.fy + view.camera.cy).astype(np.int64)
        inside = (columns >= 0) & (rows >= 0) & (columns < sky.shape[1]) & (rows < sky.shape[0])
        hits[front[inside]] += sky[rows[inside], columns[inside]]
    return cloud.select(hits < 2)


def actor_cloud(
    track: Track, sweeps: Sequence[OwnedSweep], views: Sequence[TrainingView], config: SceneConfig
) -> PointCloud:
    """Points in the box frame: the track's LiDAR points, or a grid where they are too few."""
    clouds = []
    for sweep in sweeps:
        local = sweep.actors.get(track.track_id)
        if local is None or len(local) == 0:
            continue
        for view in nearest_views(views, sweep.timestamp_us, INIT.colour_us):
            now = pose_at(track.trajectory, view.timestamp_us)
            if now is None:
                continue
            seen, uv, depth = project_visible(se3.apply(now, local).astype(np.float32), view)
            keep = usable_pixels(view, uv)
            clouds.append(PointCloud(local[seen[keep]], pixel_colours(view, uv[keep]), depth[keep]))
    cloud = voxel_downsample(concatenate(clouds), config.actor_voxel_m)
    if len(cloud) < INIT.fewest_actor_points:
        return concatenate([cloud, _box_grid(track, cloud)])
    return cloud


def actor_gaussians(track: Track, cloud: PointCloud, config: SceneConfig) -> Gaussians:
    """First Gaussians of an actor's points; with its other side, where steps see it mirrored."""
    gaussians = gaussians_from_points(cloud, config.sh_degree, sigma_range=INIT.actor_sigma_m)
    return with_other_side(gaussians) if has_other_side(track, config) else gaussians


def body_gaussians(track: Track, body: Body, cloud: PointCloud, config: SceneConfig) -> Gaussians:
    """First Gaussians of a body at rest, one a vertex and in their order.

    Their colours are those of the points nearest to where they are in the middle of their time.
    """
    vertices = body.vertices.astype(np.float32)
    never = np.full(len(vertices), np.inf, np.float32)
    grey = PointCloud(vertices, np.full((len(vertices), 3), 0.5, np.float32), never)
    gaussians = gaussians_from_points(grey, config.sh_degree, sigma_range=INIT.actor_sigma_m)
    times = body.skinning.timestamps_us
    middle = int(times[0] + times[-1]) // 2
    placed = body.skinning.at(gaussians, track.trajectory, middle).means.numpy()
    _, nearest = cKDTree(cloud.points).query(placed)
    gaussians.sh[:, 0] = (torch.from_numpy(cloud.colours[nearest]) - 0.5) / C0
    return gaussians


def has_other_side(track: Track, config: SceneConfig) -> bool:
    """Whether an actor begins with twice as many Gaussians as points."""
    symmetric = track.category not in DEFORMABLE and not deforms(track, config)
    return config.flip_probability > 0 and symmetric


def _box_grid(track: Track, cloud: PointCloud) -> PointCloud:
    """A grid on the faces of the box in the mean colour of the known points (grey without any)."""
    axes = [
        np.linspace(-size / 2, size / 2, max(2, round(size / INIT.grid_m) + 1))
        for size in track.size
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    on_face = np.any(np.isclose(np.abs(grid), track.size / 2), axis=1)
    points = grid[on_face].astype(np.float32)
    mean = cloud.colours.mean(axis=0) if len(cloud) else np.full(3, 0.5, np.float32)
    colours = np.broadcast_to(mean.astype(np.float32), points.shape).copy()
    return PointCloud(points, colours, np.full(len(points), np.inf, np.float32))
