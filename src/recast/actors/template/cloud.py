"""The vehicle's surface as a dense cloud of small patches, and daylight baked into their colours.

Few Gaussians where nothing changes, many where colours do.

Diffuse light plus the sky mirrored in clear coat: a black car is read by what it mirrors. Bonnet
and roof show the sky, flanks the dark horizon. The mirrored light moves with the viewer, so colours
are computed for many view directions and fitted by harmonics of degree one, Gaussian by Gaussian.

One photograph cannot tell a white car in the shade from a grey one in the sun. The road beside it
says how much light there is; how bright the painted parts are is kept whatever the split.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors.observation import Observation
from recast.actors.template.body import TemplateBody, mirror, wheel
from recast.actors.template.materials import (
    GLASS,
    GLOSS,
    PAINTED,
    RIM,
    SRGB,
    TemplateMaterial,
    label_body,
)
from recast.arrays import Array, Int64Array
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from recast.scene.light.relight import COAT
from recast.splats.gaussians import Gaussians
from recast.splats.sh import C0, C1

if TYPE_CHECKING:
    from recast.actors.template.generator import SurfaceView


Distance = Callable[[Array], Array]
Labeller = Callable[[Array, Array], Int64Array]

MIRROR = np.array([1.0, -1.0, 1.0])
"""Factors that take a side of the vehicle to the other."""

_THICKNESS = 0.002
COVERAGE = (1.75, 2.1)
"""Standard deviation of a Gaussian over that of its patch, and of a group of patches."""


def gradient(distance: Distance, points: Array, value: Array, step: float = 1e-3) -> Array:
    """Forward-difference gradient (N, 3) of `distance` at points (N, 3) of known `value` (N,)."""
    return np.stack(
        [(distance(points + step * axis) - value) / step for axis in np.eye(3)], axis=-1
    )


def project(distance: Distance, points: Array, steps: int) -> Array:
    """Move points (N, 3) to the zero level by Newton steps of at most 5 cm."""
    for _ in range(steps):
        value = distance(points)
        slope = gradient(distance, points, value)
        move = slope * (value / np.maximum(np.sum(slope * slope, axis=1), 1e-3))[:, None]
        length = np.linalg.norm(move, axis=1, keepdims=True)
        points = points - move * np.minimum(1.0, 0.05 / np.maximum(length, 1e-12))
    return points


def voxel_ids(points: Array, spacing: float) -> NDArray[np.int64]:
    """One integer (N,) per voxel of edge `spacing` metres; equal ids share a voxel."""
    cells = np.floor(points / spacing).astype(np.int64)
    cells -= cells.min(axis=0)
    extent = cells.max(axis=0) + 1
    return (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]


def sample(
    distance: Distance, low: Array, high: Array, spacing: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Points (M, 3) about `spacing` metres apart on the zero level, with outward unit normals.

    A coarse grid of a box around the surface, `low` to `high` (3,), finds the cells the surface
    crosses; random points in them are projected to the surface and thinned to one mean a voxel.
    """
    cell = 0.08
    axes = [np.arange(a, b + cell, cell) + cell / 2 for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = centres[np.abs(distance(centres)) < 0.8 * cell]
    seeds_per_cell = max(4, int(np.ceil(1.5 * (cell / spacing) ** 2)))
    seeds = np.repeat(centres, seeds_per_cell, axis=0)
    seeds = seeds + rng.uniform(-cell / 2, cell / 2, seeds.shape)
    seeds = project(distance, seeds, steps=2)
    seeds = seeds[np.all((seeds >= low) & (seeds <= high), axis=1)]
    voxel = np.unique(voxel_ids(seeds, spacing), return_inverse=True)[1]
    points = project(distance, group_means(voxel, seeds)[0], steps=2)
    value = distance(points)
    points, value = points[np.abs(value) < 2e-3], value[np.abs(value) < 2e-3]
    normals = gradient(distance, points, value)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points, normals


@dataclass(frozen=True)
class SurfaceCloud:
    """N surface patches; x forward, y left, z up from the ground, metres."""

    # points, normals: (N, 3).
    points: Array
    normals: Array
    spacing: Array  # (N,) edge of the patch
    albedo: Array  # (N, 3) linear reflectance of what is not body paint, weighted by 1 - `paint`
    gloss: Array  # (N,) see `lighting.shade`
    # paint, glass, rim: (N,) share of body paint, of window, of the metal of wheels.
    paint: Array
    glass: Array
    rim: Array
    twin: Int64Array  # (N,) index of the patch mirrored at the xz plane
    # (N,) whether the patch belongs to the body, not to a wheel or mirror.
    on_body: NDArray[np.bool_]

    def painted(self, paint: Array) -> Array:
        """Albedo (N, 3) with the body paint, a linear reflectance (3,), filled in."""
        return self.albedo + self.paint[:, None] * paint


def tangents(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (N, 3) that span each surface patch with its normal (right-handed)."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)


def build_cloud(body: TemplateBody, spacing: float, rng: np.random.Generator) -> SurfaceCloud:
    """Cover body, wheels and mirrors with patches of edge `spacing`, finer where colours meet.

    The left half is sampled and mirrored, so that every patch has a twin; colours are decided for
    both halves, since number plates are not symmetric.
    """
    low = np.array([-body.length / 2 - 0.01, 0.0, 0.0])
    high = np.array([body.length / 2 + 0.01, body.width / 2 + 0.01, body.height + 0.02])
    points, normals = sample(body.distance, low, high, spacing, rng)
    left = _refined(points, normals, spacing, lambda p, n: label_body(body, p, n))
    other = left[0] * MIRROR, left[1] * MIRROR, left[2]
    right = (*other, *_appearance(*other, lambda p, n: label_body(body, p, n)))
    lefts, rights = [left], [right]
    fittings = [wheel(body, axle, spacing) for axle in body.axles]
    for points, normals, labels in (*fittings, mirror(body, spacing)):
        rest = (np.full(len(points), spacing), *_look(labels))
        lefts.append((points, normals, *rest))
        rights.append((points * MIRROR, normals * MIRROR, *rest))
    joined = [np.concatenate(parts) for parts in zip(*lefts, *rights, strict=True)]
    count = len(joined[0]) // 2
    twin, on_body = np.roll(np.arange(2 * count), count), np.arange(count) < len(left[0])
    return SurfaceCloud(*[*joined, twin, np.tile(on_body, 2)])


def _look(labels: Int64Array) -> tuple[Array, ...]:
    """Albedo, gloss, and the shares of paint, window and rim."""
    paint = PAINTED[labels]
    albedo: Array = gamma_to_linear(SRGB)[labels] * (1 - paint)[..., None]
    return albedo, GLOSS[labels], paint, GLASS[labels], RIM[labels]


def _children(points: Array, normals: Array, spacing: Array) -> Array:
    """Centres (4, N, 3) of the quarters of each patch."""
    first, second = tangents(normals)
    step = spacing[:, None] / 4
    return np.stack(
        [points + a * step * first + b * step * second for a in (-1, 1) for b in (-1, 1)]
    )


def _appearance(
    points: Array, normals: Array, spacing: Array, labeller: Labeller
) -> tuple[Array, ...]:
    """What `_look` gives, averaged over the quarters of each patch."""
    looks = [_look(labeller(quarter, normals)) for quarter in _children(points, normals, spacing)]
    return tuple(np.mean(values, axis=0) for values in zip(*looks, strict=True))


def _refined(
    points: Array, normals: Array, spacing: float, labeller: Labeller
) -> tuple[Array, ...]:
    """Points, normals, spacing and appearance; patches of several materials are quartered."""
    edge = np.full(len(points), spacing)
    quarters = _children(points, normals, edge)
    labels = np.stack([labeller(quarter, normals) for quarter in quarters])
    mixed = np.any(labels != labels[0], axis=0) & (labels[0] != TemplateMaterial.DARK)
    finer = quarters[:, mixed].reshape(-1, 3)
    points = np.concatenate([points[~mixed], finer])
    edge = np.concatenate([edge[~mixed], np.full(len(finer), spacing / 2)])
    normals = np.concatenate([normals[~mixed], np.tile(normals[mixed], (4, 1))])
    return (points, normals, edge, *_appearance(points, normals, edge, labeller))


def group_patches(
    points: Array, normals: Array, colours: Array, cells: tuple[float, ...], tolerance: float
) -> Int64Array:
    """Group (N,) of each patch: all patches of a voxel that look alike, else each one alone.

    Args:
        points, normals: (N, 3).
        colours: (N, C) display values that must agree within `tolerance` (standard deviation).
        cells: voxel edges in metres, coarsest first; what does not fit tries the next.
    """
    group = np.full(len(points), -1, np.int64)
    next_group = 0
    for cell in cells:
        open_ = np.flatnonzero(group < 0)
        if len(open_) == 0:
            break
        _, ids, count = np.unique(
            _directional_voxels(points[open_], normals[open_], cell),
            return_inverse=True,
            return_counts=True,
        )
        mean_normal = _means(ids, normals[open_], count)
        mean = _means(ids, colours[open_], count)
        spread = np.sqrt(np.maximum(_means(ids, colours[open_] ** 2, count) - mean**2, 0)).max(
            axis=1
        )
        flat = np.linalg.norm(mean_normal, axis=1) > 0.985
        good = flat & (spread < tolerance)
        numbers = np.cumsum(good) - 1 + next_group
        group[open_] = np.where(good[ids], numbers[ids], -1)
        next_group += int(good.sum())
    alone = group < 0
    group[alone] = next_group + np.arange(alone.sum())
    return group


def shell_groups(points: Array, normals: Array, cell: float) -> Int64Array:
    """Group (N,) of each patch by voxel and main direction alone, whatever they look like."""
    return np.unique(_directional_voxels(points, normals, cell), return_inverse=True)[1]


def _directional_voxels(points: Array, normals: Array, cell: float) -> Int64Array:
    """Voxel number times six plus the main direction of the normal: thin sheets stay apart."""
    axis = np.argmax(np.abs(normals), axis=1)
    sign = np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0
    return voxel_ids(points, cell) * 6 + 2 * axis + sign


def _means(group: Int64Array, values: Array, count: Int64Array) -> Array:
    return np.stack(
        [np.bincount(group, weights=column, minlength=len(count)) / count for column in values.T],
        -1,
    )


def group_means(group: Int64Array, *arrays: Array) -> list[Array]:
    """Mean of each array (N, ...) within each group, (G, ...)."""
    count = np.bincount(group)
    results = []
    for array in arrays:
        columns = array.reshape(len(array), -1)
        results.append(_means(group, columns, count).reshape(len(count), *array.shape[1:]))
    return results


def flat_gaussians(
    group: Int64Array, points: Array, normals: Array, spacing: Array, sh: Array, opacity: float
) -> Gaussians:
    """One Gaussian a group, as wide as its patches and flat along their mean normal.

    Args:
        group: (N,) from `group_patches`.
        points, normals: (N, 3).
        spacing: (N,) edges of the patches, metres.
        sh: (G, K, 3).
    """
    centre, normal, edge = group_means(group, points, normals, spacing)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    offset = points - centre[group]
    scatter = group_means(group, offset[:, :, None] * offset[:, None, :])[0]
    scatter += (edge**2 / 12)[:, None, None] * np.eye(3)
    # leave out the normal direction before the main axes are taken
    project = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    values, vectors = np.linalg.eigh(project @ scatter @ project)
    minor, major = np.sqrt(np.maximum(values[:, 1:], 1e-8)).T
    minor = np.maximum(minor, 0.35 * major)
    rotation = np.stack([vectors[:, :, 2], np.cross(normal, vectors[:, :, 2]), normal], axis=-1)
    cover = np.where(np.bincount(group) > 1, COVERAGE[1], COVERAGE[0])
    deviations = np.stack([major * cover, minor * cover, np.full_like(major, _THICKNESS)], -1)

    logits = np.full(len(centre), np.log(opacity / (1 - opacity)))
    parts = centre, se3.matrix_to_quat(rotation), np.log(deviations), logits, sh
    return Gaussians(*(torch.as_tensor(part, dtype=torch.float32) for part in parts))


# Linear light of what a car mirrors on a clear day in a street with trees.
_SKY = np.array([0.24, 0.44, 0.82])
_HAZE = np.array([0.50, 0.62, 0.76])
_TREES = np.array([0.045, 0.050, 0.045])
_ROAD = np.array([0.09, 0.09, 0.09])
_ASPHALT = 0.11  # linear reflectance of worn asphalt
_ROAD_TRUST = (
    0.6  # how far the road's brightness decides the level: roads differ by a factor of two
)
_LEVEL = (0.25, 1.4)
_WHITEST = 0.80  # reflectance of white paint: the light must explain at least that
_MIRROR_SPREAD = 0.35  # of the mirrored light's factors around the level
_MISFIT = 0.15  # the model's shading is off by this share of the paint's brightness
_EFFECTIVE = 40.0  # independent measurements among the patches, however many there are
_FEW = 50


@dataclass(frozen=True)
class Daylight:
    """How a photograph's light differs from the model's clear day."""

    level: float  # factor on the light that falls on the vehicle; about 0.4 in the shade of houses
    mirrored: Array  # (3,) factors on the light that it mirrors


CLEAR_DAY = Daylight(1.0, np.ones(3))


def environment(direction: Array) -> Array:
    """Linear light (..., 3) that arrives from directions (..., 3): road, trees, haze, sky."""
    elevation = np.degrees(np.arcsin(np.clip(direction[..., 2], -1, 1)))[..., None]
    sky = ramp(elevation, 7, 18)
    zenith = ramp(elevation, 20, 60)
    ground = ramp(-elevation, 0, 8)
    above = (1 - sky) * _TREES + sky * ((1 - zenith) * _HAZE + zenith * _SKY)
    return (1 - ground) * above + ground * _ROAD


def ramp(x: Array, low: float | Array, high: float | Array) -> Array:
    """From 0 at `low` to 1 at `high`, smoothly."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def diffuse(normals: Array, heights: Array) -> Array:
    """Diffuse light (N, 1) on normals (N, 3): 1 facing up, darker below and near the ground."""
    up = 0.5 + 0.5 * normals[:, 2]
    near_ground = np.clip(heights / 0.5, 0.0, 1.0)
    return (0.26 + 0.74 * up * (0.55 + 0.45 * near_ground))[:, None]


def mirrored(normals: Array, views: Array, gloss: Array) -> Array:
    """Mirrored light (N, 3) towards unit directions `views` (N, 3) from the surface to the eye."""
    cosine = np.sum(normals * views, axis=1, keepdims=True)
    reflected = 2 * cosine * normals - views
    fresnel = COAT + (1 - COAT) * (1 - np.clip(cosine, 0.05, 1.0)) ** 5
    return np.minimum(fresnel * gloss[:, None], 0.9) * environment(reflected)


def shade(
    albedo: Array,
    gloss: Array,
    normals: Array,
    heights: Array,
    views: Array,
    light: Daylight = CLEAR_DAY,
) -> Array:
    """Display colours (N, 3) seen from directions `views` (N, 3) from the surface to the eye.

    Args:
        albedo: (N, 3) linear diffuse reflectance.
        gloss: (N,) factor on the Fresnel reflection of a clear coat.
        heights: (N,) metres above the ground.
    """
    scattered = light.level * albedo * diffuse(normals, heights)
    return linear_to_gamma(scattered + light.mirrored * mirrored(normals, views, gloss))


def view_directions() -> Array:
    """(V, 3) unit directions to the eyes of road users: all around, 4 degrees below to 45 above."""
    azimuth = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    elevation = np.radians([-4.0, 8.0, 24.0, 45.0])
    a, e = np.meshgrid(azimuth, elevation)
    return se3.direction(a, e).reshape(-1, 3)


def sh_basis(directions: Array) -> Array:
    """Real harmonics (..., 4) up to degree one of unit directions (..., 3) from eye to surface."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([np.full_like(x, C0), -C1 * y, C1 * z, -C1 * x], axis=-1)


def fit_harmonics(
    albedo: Array, gloss: Array, normals: Array, heights: Array, light: Daylight = CLEAR_DAY
) -> Array:
    """SH coefficients (N, 4, 3) whose colour `basis . sh + 0.5` follows `shade` where visible.

    Weighted least squares over the view directions on the outer side, with a ridge on degree one
    so that what is seen only at a grazing angle does not steer the rest.
    """
    views = view_directions()
    basis = sh_basis(-views)
    facing = np.sqrt(np.clip(normals @ views.T, 0.0, None)) * (1.2 - views[:, 2])
    normal = np.einsum("nv,vi,vj->nij", facing, basis, basis)
    right = np.zeros((len(normals), 4, 3))
    for v, view in enumerate(views):
        seen = np.flatnonzero(facing[:, v] > 0)
        colour = shade(albedo[seen], gloss[seen], normals[seen], heights[seen], view[None], light)
        right[seen] += (facing[seen, v, None] * basis[v])[:, :, None] * (colour - 0.5)[:, None, :]
    # a Gaussian seen from nowhere takes this ridge's target: its diffuse colour in the shade
    ridge = np.array([1e-3, 0.15, 0.15, 0.15])
    right[:, 0] += ridge[0] * (linear_to_gamma(0.3 * light.level * albedo) - 0.5) / C0
    return np.linalg.solve(normal + np.diag(ridge), right)


def estimate_light(
    cloud: SurfaceCloud, seen: Sequence[SurfaceView], observation: Observation
) -> tuple[Daylight, Array]:
    """The photographs' light, and the linear reflectance (3,) of the body paint under it.

    Painted patches obey `found = radiance * diffuse + factor * mirrored`, per channel. The
    factors of the mirrored light are held at the level of the light as far as the paint's own
    brightness drowns them: on a white car nothing can be seen of them, on a black one nothing else.
    """
    level = road_level(observation, [view.gain for view in seen])
    painted, colour, views = _shown(seen, cloud.paint > 0.9)
    if len(painted) < _FEW:
        return Daylight(level, np.full(3, level)), gamma_to_linear(SRGB[TemplateMaterial.PAINT])
    normals, heights = cloud.normals[painted], cloud.points[painted, 2]
    found = gamma_to_linear(colour)
    across = diffuse(normals, heights)[:, 0]
    sky = mirrored(normals, views, cloud.gloss[painted])
    fits = [_split(found[:, c], across, sky[:, c], level) for c in range(3)]
    radiance, factors = np.array(fits).T
    level = max(level, float(radiance.mean()) / _WHITEST)
    return Daylight(level, factors), np.clip(radiance / level, 0.003, 0.85)


def _split(found: Array, across: Array, sky: Array, level: float) -> tuple[float, float]:
    """Paint radiance and mirror factor of one channel, by reweighted least squares (Huber)."""
    spread = _MISFIT * float(np.median(found)) + 0.004
    weight = np.ones(len(found))
    basis = np.stack([across, sky], axis=-1)
    prior = np.diag([0.0, (spread / (_MIRROR_SPREAD * level)) ** 2])
    answer = np.zeros(2)
    for _ in range(10):
        share = weight * min(_EFFECTIVE / len(found), 1.0)
        normal = basis.T @ (share[:, None] * basis) + prior
        answer = np.linalg.solve(normal, basis.T @ (share * found) + prior @ [0.0, level])
        error = np.abs(found - basis @ answer)
        weight = 1 / np.maximum(error / spread, 1.0)
    factor = float(np.clip(answer[1], 0.6 * level, 1.6 * level))
    rest = (weight * across) @ (found - factor * sky) / ((weight * across) @ across)
    return max(float(rest), 0.0), factor


def road_level(observation: Observation, gains: Sequence[float] = ()) -> float:
    """Level of the light by the brightness of the road around the vehicle, 1 on a clear day.

    Args:
        observation: observation with its further views.
        gains: gains on the linear light of each view, 1 if none are given.
    """
    gains = gains or [1.0] * len(observation.views)
    levels = [_road(view) * gain for view, gain in zip(observation.views, gains, strict=True)]
    bright = np.array([level for level in levels if np.isfinite(level)])
    if len(bright) == 0:
        return 1.0
    return float(np.clip((np.median(bright) / _ASPHALT) ** _ROAD_TRUST, *_LEVEL))


def _road(observation: Observation) -> float:
    """Linear light of the road around the vehicle in one view; nan where too little is seen."""
    half = observation.size / 2
    x, y = np.meshgrid(
        np.linspace(-half[0] - 3, half[0] + 3, 60), np.linspace(-half[1] - 3, half[1] + 3, 50)
    )
    apart = (np.abs(x) > half[0] + 0.5) | (np.abs(y) > half[1] + 0.5)  # outside its own shadow
    ground = np.stack([x[apart], y[apart], np.full(int(apart.sum()), -half[2])], axis=-1)
    pixels, depth = observation.camera.project(se3.apply(observation.camera_from_object, ground))
    height, width = observation.rgba.shape[:2]
    inside = (depth > 0.5) & np.all((pixels >= 0) & (pixels < [width, height]), axis=1)
    u, v = pixels[inside].astype(int).T
    road = observation.rgba[v, u]
    # where the background was cut out, black stands for nothing seen
    road = road[(road[:, 3] == 0) & road[:, :3].any(axis=1)]
    if len(road) < _FEW:
        return float("nan")
    return float(np.median(gamma_to_linear(road[:, :3] / 255.0).mean(axis=1)))


def estimate_windows(cloud: SurfaceCloud, seen: Sequence[SurfaceView], light: Daylight) -> float:
    """Brightness of the windows seen over the model's, 0.1 to 1; 0.3 where none is seen.

    The photographed panes are not quite where the model has its own, and paint is seldom darker
    than glass: the darkest quarter counts.
    """
    ratio = _ratio(cloud, seen, light, cloud.glass > 0.9, (0.25, 0.25), usual=0.3)
    return float(np.clip(ratio, 0.1, 1.0))


def estimate_rims(cloud: SurfaceCloud, seen: Sequence[SurfaceView], light: Daylight) -> float:
    """Brightness of the wheels' metal over the model's, 0.3 to 1.2; 0.4 where none is seen.

    The photographed spokes are not where the model has its own: the brightest fifth counts.
    """
    ratio = _ratio(cloud, seen, light, cloud.rim > 0.9, (0.8, 0.5), usual=0.4)
    return float(np.clip(ratio, 0.3, 1.2))


def _ratio(
    cloud: SurfaceCloud,
    seen: Sequence[SurfaceView],
    light: Daylight,
    where: NDArray[np.bool_],
    quantiles: tuple[float, float],
    usual: float,
) -> float:
    """First quantile of the found over the second of the modelled light, near the usual ratio where
    few patches are seen."""
    chosen, colour, views = _shown(seen, where)
    count = len(chosen)
    if count == 0:
        return usual
    modelled = gamma_to_linear(
        shade(
            cloud.albedo[chosen],
            cloud.gloss[chosen],
            cloud.normals[chosen],
            cloud.points[chosen, 2],
            views,
            light,
        )
    ).mean(axis=1)
    found = gamma_to_linear(colour).mean(axis=1)
    ratio = float(np.quantile(found, quantiles[0]))
    ratio /= max(float(np.quantile(modelled, quantiles[1])), 1e-3)
    return (count * ratio + _FEW * usual) / (count + _FEW)


def _shown(
    seen: Sequence[SurfaceView], where: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], Array, Array]:
    """Patches (M,) of `where` (N,) that a view shows, once a view; colours, view directions."""
    chosen = [np.flatnonzero(where & (view.weight > 0.5)) for view in seen]
    colours = [view.colour[one] for view, one in zip(seen, chosen, strict=True)]
    views = [view.views[one] for view, one in zip(seen, chosen, strict=True)]
    return np.concatenate(chosen), np.concatenate(colours), np.concatenate(views)
