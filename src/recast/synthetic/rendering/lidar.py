"""A spinning LiDAR by ray casting: range noise, drop-out, intensity by material and angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.synthetic.rendering.ray_scene import SKY, Poses, RayScene
from recast.synthetic.rendering.rays import Float32Array, dot, scaled
from recast.synthetic.rendering.surface_points import LUMINANCE, TABLE, surface_points

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
        parts = (
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation) + 0 * azimuth,
        )
        return np.stack(parts, axis=-1).reshape(-1, 3).astype(np.float32)


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
