"""What the sensors measure: images of cameras and sweeps of a LiDAR."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Int64Array
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.synthetic.rendering import compiled
from recast.synthetic.rendering.lighting import (
    Light,
    LightFilter,
    SkyLight,
    add_light_samples,
    sample_light,
    sky_light,
)
from recast.synthetic.rendering.rays import (
    SKY,
    Float32Array,
    Hits,
    PosedScene,
    Poses,
    RayScene,
    dot,
    normalise,
    pixel_samples,
    scaled,
)
from recast.synthetic.rendering.shading import (
    CLIP,
    OFFSETS,
    WHITE_LEVEL,
    borrow_light,
    develop,
    edge_pixels,
    path_light,
    shade,
)
from recast.synthetic.rendering.surface_points import (
    LUMINANCE,
    TABLE,
    SurfacePoints,
    surface_points,
)
from recast.synthetic.world import Quality, Sky

LONELY_SAMPLES = 4
"""Further samples of light where the filter finds no neighbours to average with."""


@dataclass(frozen=True)
class CameraFrame:
    """One image and what is exactly known about it.

    Attributes:
        rgb: (H, W, 3) uint8 sRGB. In front of an empty or an unseen street: the colour of the
            vehicles alone, not mixed with anything behind them.
        depth: (H, W) float32 metres along the camera's z axis through the pixel centre, inf where
            the sky is.
        instance: (H, W) uint16 at the pixel centre: 0 the street, i + 1 the i-th of the scene's
            sorted model names, `SKY` where nothing is.
        alpha: (H, W) float32 share of the pixel that is not sky.
    """

    rgb: NDArray[np.uint8]
    depth: Float32Array
    instance: NDArray[np.uint16]
    alpha: Float32Array

    def within(self, width: int, height: int, left: int, top: int) -> CameraFrame:
        """The frame as part of a larger one (height, width), sky with no colour around it."""
        rows, columns = self.depth.shape
        around = ((top, height - top - rows), (left, width - left - columns))
        return CameraFrame(
            np.pad(self.rgb, (*around, (0, 0))),
            np.pad(self.depth, around, constant_values=np.inf),
            np.pad(self.instance, around, constant_values=SKY),
            np.pad(self.alpha, around),
        )


class LightSums:
    """Sums of the light of each pixel's rays.

    Args:
        light: what is seen where nothing is hit.
        exposure: factor on the light.
        transparent: rays that hit nothing leave no light and do not count.
    """

    def __init__(self, light: SkyLight, exposure: float, count: int, *, transparent: bool) -> None:
        self._light, self._exposure, self._transparent = light, exposure, transparent
        self._clip = np.float32(CLIP * light.white / (exposure * WHITE_LEVEL))
        self._sums = np.zeros((count, 3), np.float32)
        self._covered = np.zeros(count, np.float32)
        self._rays = np.zeros(count, np.float32)

    def add(
        self,
        pixels: Int64Array,
        directions: Float32Array,
        hits: Hits,
        at: Int64Array,
        shaded: Float32Array,
    ) -> None:
        """One ray each of `pixels`, each at most once; rays `at` brought the light `shaded`."""
        self._rays[pixels] += 1
        self._covered[pixels[at]] += 1
        self._expose(pixels[at], shaded)
        if not self._transparent:
            missed = np.flatnonzero(hits.instance == SKY)
            self._expose(pixels[missed], self._light.background(directions[missed]))

    def _expose(self, pixels: Int64Array, light: Float32Array) -> None:
        if not compiled.expose(self._sums, pixels, light, self._clip):
            self._sums[pixels] += np.minimum(light, self._clip)

    def develop(self) -> NDArray[np.uint8]:
        """(N, 3) uint8 sRGB."""
        weight = np.maximum(self._covered, 1) if self._transparent else self._rays
        mean = (self._sums / weight[:, None]).astype(np.float32, copy=False)
        return develop(mean, self._light.white, self._exposure)

    def alpha(self) -> Float32Array:
        """(N,) share of rays that hit something."""
        return self._covered / self._rays


@dataclass(frozen=True)
class Seen:
    """What the camera's own rays meet; light and reflections meet all of the scene."""

    posed: PosedScene  # the scene with the models that are seen
    street: bool  # whether what never moves is seen

    def cast(self, origins: Float32Array, directions: Float32Array) -> Hits:
        """First hits of the camera's rays."""
        return self.posed.cast(origins, directions, coherent=True, street=self.street)


def trace_image(
    posed: PosedScene,
    seen: Seen,
    light: SkyLight,
    camera: PinholeCamera,
    world_from_camera: Array,
    rng: np.random.Generator,
    exposure: float,
    quality: Quality,
) -> CameraFrame:
    """The image of what is seen of a scene; arguments as of `render_camera`, checked."""
    height, width = camera.height, camera.width
    pixel_angle = 1 / np.sqrt(camera.fx * camera.fy)
    film = LightSums(light, exposure, height * width, transparent=not seen.street)

    grid = camera.pixel_grid().reshape(-1, 2)
    origins, directions, stretch = camera_rays(camera, world_from_camera, grid)
    hits = seen.cast(origins, directions)
    pixels, points = surface_points(posed, origins, directions, hits)
    samples = [pixel_samples(height, width, rng).reshape(-1, 2)[pixels] for _ in range(2)]
    noisy = sample_light(light, points, *samples)
    light_filter = LightFilter(points, pixels, height, width)
    add_light_samples(light, points, noisy, light_filter.lonely(), LONELY_SAMPLES, rng)
    if quality == "mitsuba":
        noisy = Light(noisy.sun, path_light(light, points, rng))
    arriving = light_filter.smooth(noisy)
    shaded = shade(light, points, arriving, pixel_angle)
    film.add(np.arange(height * width), directions, hits, pixels, shaded)

    edges = edge_pixels(points, pixels, shaded, light.white, height, width)
    for offset in OFFSETS:
        origins, directions, _ = camera_rays(camera, world_from_camera, grid[edges] + offset)
        further = seen.cast(origins, directions)
        at, others = surface_points(posed, origins, directions, further)
        borrowed, alone = borrow_light(
            points, pixels, arriving, others, edges[at], offset, height, width
        )
        _light_alone(light, others, borrowed, alone, rng)
        shaded = shade(light, others, borrowed, pixel_angle)
        film.add(edges, directions, further, at, shaded)

    return CameraFrame(
        film.develop().reshape(height, width, 3),
        (hits.distance / stretch).reshape(height, width),
        hits.instance.reshape(height, width),
        film.alpha().reshape(height, width),
    )


def camera_rays(
    camera: PinholeCamera, world_from_camera: Array, pixels: Array
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Origins, unit directions, and the lengths of the directions at unit depth."""
    local = camera.rays(pixels)
    directions = (local @ world_from_camera[:3, :3].T).astype(np.float32)
    stretch = np.sqrt(dot(directions, directions))
    origins = np.empty_like(directions)
    origins[:] = world_from_camera[:3, 3]
    return origins, normalise(directions), stretch


def _light_alone(
    light: SkyLight, points: SurfacePoints, borrowed: Light, alone: Int64Array, rng: Generator
) -> None:
    """Sample the light of points that none could be borrowed for, in place."""
    lonely = points.take(alone)
    samples = rng.random((2, len(alone), 2), np.float32)
    own = sample_light(light, lonely, samples[0], samples[1])
    borrowed.sun[alone] = own.sun
    borrowed.sky[alone] = own.sky


def render_camera(
    scene: RayScene,
    sky: Sky,
    camera: PinholeCamera,
    world_from_camera: ArrayLike,
    poses: Poses,
    *,
    rng: np.random.Generator,
    exposure: float = 1.0,
    quality: Quality = "standard",
    hidden: Collection[str] = (),
    street: bool = True,
) -> CameraFrame:
    """Take one image.

    Args:
        scene: scene to look at; its street may be empty.
        sky: daylight.
        camera: camera of the image; it may have distortion.
        world_from_camera: (4, 4) rigid.
        poses: `world_from_actor` (4, 4) by model name; models not named are absent.
        rng: random generator of the samples of light.
        exposure: factor on the light, 1 is right for the day.
        quality: "mitsuba" path traces the light of the sky, with four bounces instead of two, at
            several times the cost; needs the extra `mitsuba` and LLVM.
        hidden: names of models that the camera looks through. They still cast shadows and are
            mirrored.
        street: False lets the camera look through what never moves: the other models alone, in the
            light that they have in the street.

    Raises:
        InputError: mitsuba is asked for and does not run here.
        ValueError: a size or a pose that cannot be, an exposure that is not positive, or a name
            that is not among the models.
    """
    camera.validate()
    pose = np.asarray(world_from_camera, np.float64)
    if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
        raise ValueError(f"world_from_camera: expected a finite (4, 4), got {pose.shape}")
    if not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"exposure: must be positive, got {exposure}")
    if quality not in get_args(Quality):
        raise ValueError(f"quality: {quality!r} is not one of {get_args(Quality)}")
    posed, light = scene.posed(poses), sky_light(sky)
    shown = {name: place for name, place in poses.items() if name not in hidden}
    seen = Seen(scene.posed(shown) if len(shown) < len(poses) else posed, street)
    if street and len(scene.static):
        return trace_image(posed, seen, light, camera, pose, rng, exposure, quality)
    # Nothing but vehicles: trace only the part of the image that they can cover.
    left, top, right, bottom = _covered(scene, camera, pose, shown)
    part = camera.cropped(left, top, right - left, bottom - top)
    alone = Seen(seen.posed, street=False)
    return trace_image(posed, alone, light, part, pose, rng, exposure, quality).within(
        camera.width, camera.height, left, top
    )


def _covered(
    scene: RayScene, camera: PinholeCamera, world_from_camera: Array, poses: Poses
) -> tuple[int, int, int, int]:
    """Pixels left, top, right, bottom, at least one, around the boxes of all posed models."""
    everything = 0, 0, camera.width, camera.height
    camera_from_world = se3.inverse(world_from_camera)
    corners = []
    for bounds, name in zip(scene.bounds[1:], scene.names, strict=True):
        if name in poses:
            box = np.stack(np.meshgrid(*bounds.T), axis=-1).reshape(-1, 3)
            corners.append(se3.apply(camera_from_world @ poses[name], box))
    if not corners:
        return 0, 0, 1, 1
    points = np.concatenate(corners)
    # Behind the camera, or through a lens that bends lines, corners do not bound what is inside.
    if points[:, 2].min() < 0.05 or not camera.is_rectified:
        return everything
    pixels, _ = camera.project(points)
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(pixels.min(axis=0)) - 2, 0, size - 1).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 2, low + 1, size).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


MID_GREY = np.float32(0.18)
"""Luminance of the face for which `Material.lidar` is given."""
GLASS_RETURN = np.float32(0.15)
"""Share of pulses on glass that come back; the others go through or are mirrored away."""


@dataclass(frozen=True)
class LidarSpec:
    """What a LiDAR does in one turn.

    Attributes:
        elevations: (B,) radians of the beams above the sensor's xy plane.
        azimuths: rays a turn of each beam, from x towards y.
        minimum_range, maximum_range: metres; nothing is returned beyond.
        range_noise: standard deviation in metres.
        noise_floor: returned energy, as a share of a white wall's at 10 m, that is lost half of the
            time.
        steepness: how sharply returns set in about that floor, per decade of energy.
    """

    elevations: Array
    azimuths: int = 937
    minimum_range: float = 0.8
    maximum_range: float = 75.0
    range_noise: float = 0.02
    noise_floor: float = 2.5e-4
    steepness: float = 8.0

    def validate(self) -> None:
        """Raise ValueError naming the field at fault."""
        elevations = np.asarray(self.elevations)
        if elevations.ndim != 1 or not len(elevations) or np.any(np.abs(elevations) > np.pi / 2):
            raise ValueError("LidarSpec.elevations: expected (B,) radians within +-pi/2, B > 0")
        if self.azimuths < 1:
            raise ValueError(f"LidarSpec.azimuths: must be positive, got {self.azimuths}")
        if not 0 <= self.minimum_range < self.maximum_range:
            raise ValueError(
                f"LidarSpec: ranges must increase, got {self.minimum_range}, {self.maximum_range}"
            )
        if self.range_noise < 0 or self.noise_floor < 0 or self.steepness <= 0:
            raise ValueError("LidarSpec: noise must not be negative, steepness must be positive")

    def directions(self) -> Float32Array:
        """Unit directions (B * azimuths, 3) in the LiDAR frame, beam by beam."""
        azimuth = np.arange(self.azimuths) * (2 * np.pi / self.azimuths)
        elevation = np.asarray(self.elevations, np.float64)[:, None]
        return se3.direction(azimuth, elevation).reshape(-1, 3).astype(np.float32)


def _waymo_elevations() -> Array:
    """64 beams from +2.4 to -17.6 degrees, twice as dense at the horizon as at the bottom."""
    step = np.linspace(0.65, 1.35, 63)
    down = np.concatenate([[0.0], np.cumsum(step)])
    return np.deg2rad(2.4 - 20.0 * down / down[-1])


WAYMO_TOP = LidarSpec(_waymo_elevations())
"""Like the top LiDAR of the Waymo Open Dataset, at a third of its azimuths."""


@dataclass(frozen=True)
class LidarScan:
    """The returns of one turn.

    Attributes:
        points: (N, 3) float32 in the LiDAR frame, exactly along their rays.
        intensity: (N,) float32 in [0, 1].
        instance: (N,) uint16 as in `CameraFrame`.
        ranges: (N,) float32 metres as measured: the length of `points`.
        true_ranges: (N,) float32 metres without noise.
        ray: (N,) int32 row of `LidarSpec.directions`.
    """

    points: Float32Array
    intensity: Float32Array
    instance: NDArray[np.uint16]
    ranges: Float32Array
    true_ranges: Float32Array
    ray: NDArray[np.int32]


def scan_lidar(
    scene: RayScene,
    spec: LidarSpec,
    world_from_lidar: ArrayLike,
    poses: Poses,
    rng: np.random.Generator,
) -> LidarScan:
    """One turn, taken in an instant.

    Args:
        scene: what is there.
        spec: specification of the sensor.
        world_from_lidar: (4, 4) rigid.
        poses: `world_from_actor` (4, 4) by model name; models not named are absent.
        rng: random generator of noise and drop-out; the same number of draws whatever is hit.

    Raises:
        ValueError: the spec or the pose cannot be, or a name is not among the models.
    """
    spec.validate()
    pose = np.asarray(world_from_lidar, np.float64)
    if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
        raise ValueError(f"world_from_lidar: expected a finite (4, 4), got {pose.shape}")
    local = spec.directions()
    directions = local @ pose[:3, :3].T.astype(np.float32)
    origins = np.empty_like(directions)
    origins[:] = pose[:3, 3]
    noise = rng.standard_normal(len(local), np.float32) * np.float32(spec.range_noise)
    draw = rng.random(len(local), np.float32)

    posed = scene.posed(poses)
    hits = posed.cast(origins, directions, coherent=True)
    within = (hits.distance >= spec.minimum_range) & (hits.distance <= spec.maximum_range)
    rays = np.flatnonzero(within & (hits.instance != SKY))
    _, points = surface_points(posed, origins, directions, hits, rays, smooth=False)

    facing = np.maximum(-dot(points.view, points.flat), 0)
    luminance = points.colour @ LUMINANCE
    mirror_like = TABLE.retroreflective[points.material]
    # A dark face absorbs at 905 nm too, though less than to the eye.
    reflectivity = TABLE.lidar[points.material] * np.sqrt(luminance / MID_GREY)
    reflectivity = np.where(mirror_like, 8 * TABLE.lidar[points.material], reflectivity)
    lobe = np.where(mirror_like, np.sqrt(facing), facing)
    brightness = np.clip(reflectivity, 0, 8) * lobe
    energy = brightness * (10 / np.maximum(points.distance, 10)) ** 2
    glass = ((TABLE.specular > 0) & (TABLE.lidar <= 0.05))[points.material]
    # Returned energy against the detector's floor: a logistic curve in decades.
    floor = max(spec.noise_floor, 1e-12)
    decades = np.log10(np.maximum(energy, 1e-9) / np.float32(floor))
    seen = np.where(glass, GLASS_RETURN, np.float32(1))
    kept = draw[rays] < seen / (1 + np.exp(-np.float32(spec.steepness) * decades))
    true = points.distance[kept]
    rays = rays[kept]
    measured = np.maximum(true + noise[rays], np.float32(0.01))
    # Real sensors correct for range, so that intensity speaks of the surface alone.
    intensity = np.clip(brightness[kept], 0, 1).astype(np.float32)
    return LidarScan(
        points=scaled(local[rays], measured),
        intensity=intensity,
        instance=points.instance[kept],
        ranges=measured,
        true_ranges=true,
        ray=rays.astype(np.int32),
    )
