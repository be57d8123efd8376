"""Daylight on a vehicle: how its surface looks in it, and what photographs tell of light and paint.

Diffuse light plus the sky mirrored in clear coat: a black car is read by what it mirrors. Bonnet
and roof show the sky, flanks the dark horizon. The mirrored light moves with the viewer, so colours
are computed for many view directions and fitted by harmonics of degree one, Gaussian by Gaussian.

A blue sky on grey paint and a grey sky on blue-grey paint look alike in one place, but not all over
a vehicle: roof and bonnet mirror the sky, flanks and bumpers do not. One photograph cannot tell a
white car in the shade from a grey one in the sun. The road beside it says how much light there is,
and of which hue; how bright the painted parts are is kept whatever the split.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from recast.actors.observation import Observation
from recast.actors.template.cloud import SurfaceCloud, ramp
from recast.actors.template.materials import SRGB, TemplateMaterial
from recast.actors.template.texture import SurfaceView
from recast.arrays import Array
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from recast.scene.light.relight import COAT
from recast.splats.gaussians import C0, C1

# Linear light of what a car mirrors in a street with trees, on a clear day and under clouds.
_ZENITH = np.array([[0.24, 0.44, 0.82], [0.78, 0.79, 0.80]])
_HAZE = np.array([[0.50, 0.62, 0.76], [0.62, 0.63, 0.64]])
_TREES = np.array([0.045, 0.050, 0.045])
_ROAD = np.array([0.09, 0.09, 0.09])
_ASPHALT = 0.11  # linear reflectance of worn asphalt
_ROAD_TRUST = (
    0.6  # how far the road's brightness decides the level: roads differ by a factor of two
)
_HUES = 0.85, 1.18  # of daylight, from shade to a low sun
_HUE_TRUST = 0.5  # how far the road's hue decides that of the light: concrete is a little warm
_LEVEL = (0.2, 1.6)
_BRIGHTEST_ROAD = 0.6  # linear light
_WHITEST = 0.80  # reflectance of white paint: the light must explain at least that
_BLACKEST = 0.008  # reflectance of black paint, mirrored light left out
_LEAST_MIRROR = 0.5  # of the level; less is the shading's misfit, not a coat without gloss
_MIRROR_SPREAD = 0.35  # of the mirrored light's factor around the level
_CONTRAST, _CONTRAST_SPREAD, _CONTRAST_ROUNDS = (0.0, 1.3), 0.4, 4
_CHROMA_SPREAD = 0.06  # of the paint's channels: four in five cars are white, grey or black
_CLIPPED = 0.97  # display value from which a channel may be saturated
_MISFIT = 0.15  # the model's shading is off by this share of the paint's brightness
_EFFECTIVE = 40.0  # independent measurements among the patches, however many there are
_FEW = 50
_PANES = (0.6, 0.55), (0.4, 0.25)  # usual factors of panes and their spread
_PANE_LIMITS = (0.1, 0.15), (1.5, 1.3)
_PANE_NOISE = 0.03  # linear light: what shows through a pane


@dataclass(frozen=True)
class Daylight:
    """The light on a vehicle.

    Attributes:
        level: factor on the diffuse light of a clear day; about 0.4 in the shade of houses.
        mirror: factor on the light that the vehicle mirrors.
        clouds: hue of the mirrored sky, 0 (clear) to 1 (overcast).
        tint: (3,) colour of all light, mean 1.
        contrast: how much brighter roofs are than flanks: 1 under a sky, 0 between studio lamps.
    """

    level: float = 1.0
    mirror: float = 1.0
    clouds: float = 0.0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    contrast: float = 1.0


CLEAR_DAY = Daylight()


def environment(direction: Array, clouds: float = 0.0) -> Array:
    """Linear light (..., 3) that arrives from directions (..., 3): road, trees, haze, sky."""
    elevation = np.degrees(np.arcsin(np.clip(direction[..., 2], -1, 1)))[..., None]
    sky = ramp(elevation, 7, 18)
    zenith = ramp(elevation, 20, 60)
    ground = ramp(-elevation, 0, 8)
    low, high = ((1 - clouds) * ends[0] + clouds * ends[1] for ends in (_HAZE, _ZENITH))
    above = (1 - sky) * _TREES + sky * ((1 - zenith) * low + zenith * high)
    return (1 - ground) * above + ground * _ROAD


def diffuse(normals: Array, heights: Array, contrast: float = 1.0) -> Array:
    """Diffuse light (N, 1) on normals (N, 3): 1 facing up, darker below and near the ground."""
    up = 0.5 + 0.5 * contrast * normals[:, 2]
    near_ground = np.clip(heights / 0.5, 0.0, 1.0)
    return (0.26 + 0.74 * up * (0.55 + 0.45 * near_ground))[:, None]


def mirrored(normals: Array, views: Array, gloss: Array, clouds: float = 0.0) -> Array:
    """Mirrored light (N, 3) towards unit directions `views` (N, 3) from the surface to the eye."""
    cosine = np.sum(normals * views, axis=1, keepdims=True)
    reflected = 2 * cosine * normals - views
    fresnel = COAT + (1 - COAT) * (1 - np.clip(cosine, 0.05, 1.0)) ** 5
    return np.minimum(fresnel * gloss[:, None], 0.9) * environment(reflected, clouds)


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
    scattered = light.level * albedo * diffuse(normals, heights, light.contrast)
    shine = light.mirror * mirrored(normals, views, gloss, light.clouds)
    return linear_to_gamma(np.asarray(light.tint) * (scattered + shine))


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
    squares = np.einsum("vi,vj->vij", basis, basis).reshape(len(views), 16)
    normal = (facing @ squares).reshape(-1, 4, 4)
    colours = np.zeros((len(views), 3, len(normals)), np.float32)
    paint, coat, way, height, eyes = (
        _single(value) for value in (albedo, gloss, normals, heights, views)
    )
    for v in range(len(views)):
        seen = np.flatnonzero(facing[:, v] > 0)
        colour = shade(paint[seen], coat[seen], way[seen], height[seen], eyes[v][None], light)
        colours[v][:, seen] = (facing[seen, v, None] * (colour - 0.5)).T
    right = np.tensordot(colours, basis, (0, 0)).transpose(1, 2, 0)
    # a Gaussian seen from nowhere takes this ridge's target: its diffuse colour in the shade
    ridge = np.array([1e-3, 0.15, 0.15, 0.15])
    right[:, 0] += ridge[0] * (linear_to_gamma(0.3 * light.level * albedo) - 0.5) / C0
    return np.linalg.solve(normal + np.diag(ridge), right)


def _single(value: Array) -> Any:
    return np.asarray(value, np.float32)  # half the time, and a hundredth of a grey level


def estimate_light(
    cloud: SurfaceCloud, seen: Sequence[SurfaceView], observation: Observation
) -> tuple[Daylight, Array]:
    """The photographs' light, and the linear reflectance (3,) of the body paint under it.

    Painted patches obey `found = paint * diffuse + clear * mirrored(0) + cloudy * mirrored(1)`,
    with one pair of factors for all channels, so that the sky's hue is that of a sky. Clear or
    overcast, and how much of either, is what explains the patches best (reweighted least squares,
    Huber); the factors' sum is held at the level of the light as far as the paint's own brightness
    drowns them, and the paint near grey.
    """
    road = road_light(observation, [view.gain for view in seen])
    level = road_level(road)
    tint = road_tint(road)
    painted, colour, views = shown_patches(seen, cloud.paint > 0.9)
    lively = colour.max(axis=1) < _CLIPPED  # a sunlit white says only that it is white
    if lively.mean() > 0.3:
        painted, colour, views = painted[lively], colour[lively], views[lively]
    if len(painted) < _FEW:
        return Daylight(level, level, 0.5, tint), gamma_to_linear(SRGB[TemplateMaterial.PAINT])
    count = len(painted)
    panes, pane_colour, pane_views = shown_patches(seen, cloud.glass > 0.9)
    both = np.concatenate([painted, panes])
    normals, heights = cloud.normals[both], cloud.points[both, 2]
    found = gamma_to_linear(np.concatenate([colour, pane_colour])) / np.asarray(tint)
    gloss = cloud.gloss[both] * np.where(np.arange(len(both)) < count, 1.0, _PANES[0][1])
    eyes = np.concatenate([views, pane_views])
    flanks, full = (diffuse(normals, heights, one)[:, 0] for one in (0.0, 1.0))
    skies = [mirrored(normals, eyes, gloss, clouds) for clouds in (0.0, 1.0)]
    contrast = 1.0
    for _ in range(_CONTRAST_ROUNDS):
        across = flanks + contrast * (full - flanks)
        radiance, (clear, cloudy), share = _split(found, count, across, skies[0], skies[1], level)
        # how much of the step from flank to roof the paint shows, drawn to all of it
        step = (full - flanks)[:count, None] * radiance
        rest = (found - clear * skies[0] - cloudy * skies[1])[:count]
        rest -= flanks[:count, None] * radiance
        pull = 1 / _CONTRAST_SPREAD**2
        contrast = (np.sum(share * step * rest) + pull) / (np.sum(share * step**2) + pull)
        contrast = float(np.clip(contrast, *_CONTRAST))
    level = max(level, float(radiance.mean()) / _WHITEST)
    total = float(clear + cloudy)
    mirror = float(np.clip(total, _LEAST_MIRROR * level, 2 * level))
    # mirrored light that nothing on the vehicle showed is grey: a blue pane would be invented
    clouds = float(np.clip(1.0 - clear / mirror, 0.0, 1.0))
    light = Daylight(level, mirror, clouds, tint, contrast)
    return light, np.clip(radiance / level, _BLACKEST, 0.9)


def _split(
    found: Array, count: int, across: Array, clear: Array, cloudy: Array, level: float
) -> tuple[Array, Array, Array]:
    """Radiance (3,) of the paint, factors (2,) of both skies, weights of the paint's patches.

    Args:
        found: (N, 3) linear colours; the first `count` are of paint, the others of panes, behind
            which lies a grey interior of unknown brightness.
        across: (N,) diffuse light; `clear`, `cloudy`: (N, 3) mirrored light of both skies.
    """
    middle = np.median(found[:count], axis=0)
    spread = np.broadcast_to(_MISFIT * middle + 0.004, found.shape).copy()
    spread[count:] = _PANE_NOISE
    rows = np.zeros((len(found), 3, 6))
    rows[:count, [0, 1, 2], [0, 1, 2]] = across[:count, None]
    rows[:, :, 3], rows[:, :, 4] = clear, cloudy
    rows[count:, :, 5] = across[count:, None]
    prior = np.array(
        [
            [0, 0, 0, 1 / (_MIRROR_SPREAD * level), 1 / (_MIRROR_SPREAD * level), 0],
            [0, 0, 0, 0.5, -0.5, 0],  # half clear, half overcast where nothing tells
            [1, -1, 0, 0, 0, 0],
            [0, 1, -1, 0, 0, 0],
            [0, 0, 0, 0, 0, 20.0],
        ]
    )
    prior[2:4] /= _CHROMA_SPREAD * (float(middle.mean()) + 0.02)
    target = np.array([1 / _MIRROR_SPREAD, 0.0, 0.0, 0.0, 0.3])
    independent = np.minimum(_EFFECTIVE / np.array([count, max(len(found) - count, 1)]), 1.0)
    base = np.repeat(independent, [count, len(found) - count])[:, None] / spread**2
    share, answer = base, np.zeros(6)
    trust = np.ones(len(prior))
    for _ in range(15):
        pulled = trust[:, None] * prior
        weighted = (rows * share[..., None]).reshape(-1, 6)
        normal = weighted.T @ rows.reshape(-1, 6) + pulled.T @ prior
        right = weighted.T @ found.ravel() + pulled.T @ target
        root = np.linalg.cholesky(normal + 1e-9 * np.eye(6))
        answer = nnls(root.T, np.linalg.solve(root, right))[0]
        share = base / np.maximum(np.abs(found - rows @ answer) / spread, 1.0)
        # bright colours are rare, but once seen they are no accident: the pull does not grow
        trust[2:4] = 1 / np.maximum(np.abs(prior[2:4] @ answer), 1.0)
    return answer[:3], answer[3:5], share[:count]


def road_light(observation: Observation, gains: Sequence[float] = ()) -> Array:
    """Linear light (3,) of the road around the vehicle; nan if no road is seen.

    Args:
        observation: observation with its further views.
        gains: gains on the linear light of each view, 1 if none are given.
    """
    gains = gains or [1.0] * len(observation.views)
    found = [_road(view) * gain for view, gain in zip(observation.views, gains, strict=True)]
    known = [light for light in found if np.isfinite(light).all()]
    return np.median(known, axis=0) if known else np.full(3, np.nan)


def road_level(road: Array) -> float:
    """Level of the light by the linear light (3,) of the road, 1 on a clear day or if unknown."""
    if not np.isfinite(road).all():
        return 1.0
    return float(np.clip((road.mean() / _ASPHALT) ** _ROAD_TRUST, *_LEVEL))


def road_tint(road: Array) -> tuple[float, float, float]:
    """Colour of the light, mean 1, by the linear light (3,) of the road, which is nearly grey."""
    if not np.isfinite(road).all() or road.min() <= 0:
        return (1.0, 1.0, 1.0)
    red, green, blue = np.clip((road / road.mean()) ** _HUE_TRUST, *_HUES)  # a verge is green
    mean = (red + green + blue) / 3
    return float(red / mean), float(green / mean), float(blue / mean)


def _road(observation: Observation) -> Array:
    """Linear light (3,) of the road around the vehicle in one view; nan where it is not told."""
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
        return np.full(3, np.nan)
    light = np.median(gamma_to_linear(road[:, :3] / 255.0), axis=0)
    # a studio's white floor, or paper, is no road
    return light if light.mean() < _BRIGHTEST_ROAD else np.full(3, np.nan)


def estimate_windows(
    cloud: SurfaceCloud, seen: Sequence[SurfaceView], light: Daylight
) -> tuple[float, float]:
    """How bright panes are: factors on the model's diffuse and on its mirrored light.

    Behind a pane lies the interior, and on it the sky: a windscreen, which leans, is bright where
    the side windows beside it are dark. Both factors are fitted to the panes seen (Huber), near
    what is usual where few are.
    """
    chosen, colour, views = shown_patches(seen, cloud.glass > 0.9)
    usual, spread = _PANES
    if len(chosen) == 0:
        return usual
    normals, heights = cloud.normals[chosen], cloud.points[chosen, 2]
    args = cloud.gloss[chosen], normals, heights, views
    inside = shade(cloud.albedo[chosen], np.zeros(len(chosen)), *args[1:], light)
    sky = shade(np.zeros((len(chosen), 3)), *args, light)
    basis = np.stack([gamma_to_linear(one).mean(axis=1) for one in (inside, sky)], axis=-1)
    found = gamma_to_linear(colour).mean(axis=1)
    answer, weight = np.array(usual), np.ones(len(found))
    prior = np.diag(1 / np.square(spread))
    for _ in range(8):
        share = weight * min(_EFFECTIVE / len(found), 1.0) / _PANE_NOISE**2
        normal = basis.T @ (share[:, None] * basis) + prior
        answer = np.linalg.solve(normal, basis.T @ (share * found) + prior @ usual)
        weight = 1 / np.maximum(np.abs(found - basis @ answer) / _PANE_NOISE, 1.0)
    inside_factor, sky_factor = np.clip(answer, *_PANE_LIMITS)
    return float(inside_factor), float(sky_factor)


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
    chosen, colour, views = shown_patches(seen, where)
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


def shown_patches(
    seen: Sequence[SurfaceView], where: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], Array, Array]:
    """Patches (M,) of `where` (N,) that a view shows, once a view; colours, view directions."""
    chosen = [np.flatnonzero(where & (view.weight > 0.5)) for view in seen]
    colours = [view.colour[one] for view, one in zip(seen, chosen, strict=True)]
    views = [view.views[one] for view, one in zip(seen, chosen, strict=True)]
    return np.concatenate(chosen), np.concatenate(colours), np.concatenate(views)
