"""The template generator; colours from the photographs: which patches they show, and how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.generate import VEHICLE, Asset, BaseGenerator
from recast.actors.observation import Observation
from recast.actors.template.body import TemplateBody
from recast.actors.template.cloud import (
    CLEAR_DAY,
    MIRROR,
    Daylight,
    SurfaceCloud,
    build_cloud,
    estimate_light,
    estimate_rims,
    estimate_windows,
    fit_harmonics,
    flat_gaussians,
    group_means,
    group_patches,
    ramp,
    sh_basis,
    shell_groups,
    tangents,
)
from recast.actors.template.proportions import (
    ShapeFit,
    TemplatePlacement,
    contour,
    find_axles,
    fit_shape,
    place,
)
from recast.arrays import Array, Int64Array
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from recast.splats import MIP, Gaussians, concatenate
from recast.splats.sh import C0

_FEW_PATCHES = 50  # patches
_GAIN = (0.4, 2.5)
_DISAGREEMENT = 0.15  # display values
_STEEPNESS = 4
_COARSE = (0.010, 0.028)  # metres per pixel: from fine enough for slanted sides, to too coarse


@dataclass(frozen=True)
class SurfaceView:
    """What the crop says about each of N patches."""

    colour: Array  # (N, 3) display values; meaningless where `weight` is 0
    weight: Array  # (N,) 0 unseen to 1 seen squarely and well inside the mask
    views: Array  # (N, 3) unit directions from the patch to the camera, vehicle frame
    sharpness: Array  # (N,) pixels a metre on the patch, foreshortened
    gain: float = 1.0  # gain that `colour` was given, on linear light


def view_surface(
    cloud: SurfaceCloud, observation: Observation, placement: TemplatePlacement
) -> SurfaceView:
    """Sample the crop at every patch that it shows.

    Args:
        cloud: the vehicle, z up from the ground.
        observation: crop, camera and mask.
        placement: placement of the vehicle in the logged box.
    """
    placed = placement.points(cloud.points)
    normals = placement.normals(cloud.normals)
    rays = observation.eye - placed
    views = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    facing = np.sum(normals * views, axis=1)
    pixels, depth = observation.camera.project(se3.apply(observation.camera_from_object, placed))
    front = _frontmost(pixels, depth, facing, observation)
    alpha = observation.rgba[..., 3] > 127
    margin = cv2.distanceTransform(alpha.astype(np.uint8), cv2.DIST_L2, 5)
    inside = _sample(margin[..., None].astype(np.float32), pixels)[:, 0]
    # far away, a slanted side is a few columns of pixels: its windows and pillars are one smear
    coarse = ramp(depth / observation.camera.fx, *_COARSE)
    slant = ramp(facing, 0.12 + 0.20 * coarse, 0.35 + 0.25 * coarse)
    weight = slant * ramp(inside, 1.0, 3.5) * front
    colour = _sample(_calm_chroma(observation.rgba[..., :3]).astype(np.float32) / 255, pixels)
    sharpness = observation.camera.fx / np.maximum(depth, 0.1) * np.clip(facing, 0.0, 1.0)
    return SurfaceView(colour, weight, views, sharpness)


def _frontmost(
    pixels: Array, depth: Array, facing: Array, observation: Observation
) -> NDArray[np.bool_]:
    """Patches not hidden behind nearer ones, by a depth buffer of cells a few pixels wide."""
    height, width = observation.rgba.shape[:2]
    # a cell must hold several patches, or far sides show through the gaps
    metres_per_pixel = np.median(depth) / observation.camera.fx
    cell = max(1.0, 0.045 / metres_per_pixel)
    columns, rows = int(width / cell) + 1, int(height / cell) + 1
    u, v = np.floor(pixels / cell).astype(int).T
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows) & (depth > 0.1)
    nearest = np.full((rows, columns), np.inf)
    facing_in = inside & (facing > 0.05)
    np.minimum.at(nearest, (v[facing_in], u[facing_in]), depth[facing_in])
    # slanted surfaces span depth within one cell
    slack = 0.05 + cell * metres_per_pixel / np.clip(facing, 0.1, 1.0)
    front = np.zeros(len(depth), bool)
    front[inside] = depth[inside] < nearest[v[inside], u[inside]] + slack[inside]
    return front & (facing > 0.05)


def _calm_chroma(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The image without the colour fringes that demosaicing leaves on plates and lamps."""
    channels = cv2.cvtColor(rgb, cv2.COLOR_RGB2YCrCb)
    for c in (1, 2):
        channels[..., c] = cv2.medianBlur(np.ascontiguousarray(channels[..., c]), 5)
    return np.asarray(cv2.cvtColor(channels, cv2.COLOR_YCrCb2RGB), np.uint8)


def _sample(image: NDArray[np.floating], pixels: Array) -> Array:
    """Bilinear values (N, C) at pixels (N, 2), pixel centres at +0.5, clamped at the border."""
    height, width, channels = image.shape
    x = np.clip(pixels[:, 0] - 0.5, 0, width - 1.001)
    y = np.clip(pixels[:, 1] - 0.5, 0, height - 1.001)
    u, v = x.astype(int), y.astype(int)
    a, b = (x - u)[:, None], (y - v)[:, None]
    values = image[v, u] * (1 - a) * (1 - b) + image[v, u + 1] * a * (1 - b)
    values = values + image[v + 1, u] * (1 - a) * b + image[v + 1, u + 1] * a * b
    return values.astype(np.float64).reshape(-1, channels)


def balanced(views: Sequence[SurfaceView]) -> list[SurfaceView]:
    """The views at the exposure of the first, by the patches that each shares with those before.

    Cameras expose differently, and a vehicle drives through shade. A view that shares few patches
    keeps its brightness nearly.
    """
    done = [views[0]]
    for view in views[1:]:
        known = blended(done)
        shared = np.minimum(known.weight, view.weight) > 0.5
        here, there = (
            gamma_to_linear(v.colour[shared]).mean(axis=1) + 0.002 for v in (view, known)
        )
        count = int(shared.sum())
        ratio = float(np.median(np.log(there / here))) if count else 0.0
        gain = float(np.exp(np.clip(ratio * count / (count + _FEW_PATCHES), *np.log(_GAIN))))
        done.append(
            replace(view, colour=linear_to_gamma(gain * gamma_to_linear(view.colour)), gain=gain)
        )
    return done


def blended(views: Sequence[SurfaceView]) -> SurfaceView:
    """One view of all that was seen: each patch mostly as it looks where it was seen best.

    Weights rise steeply with facing, resolution and distance from the mask's border, so that a
    sharp picture is not blurred by a coarse one. A colour far from the others' mean counts less.
    """
    if len(views) == 1:
        return views[0]
    colour, weight, towards, sharpness = (
        np.stack([getattr(view, name) for view in views])
        for name in ("colour", "weight", "views", "sharpness")
    )
    merit = weight * sharpness
    mean = _mix(merit, colour)
    apart = np.linalg.norm(colour - mean, axis=-1) / _DISAGREEMENT
    merit = (merit / np.maximum(merit.max(axis=0), 1e-9)) ** _STEEPNESS / (1 + apart**2)
    direction = _mix(merit, towards)
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    return SurfaceView(
        _mix(merit, colour),
        1 - np.prod(1 - weight, axis=0),
        direction,
        _mix(merit, sharpness[..., None])[:, 0],
    )


def _mix(weights: Array, values: Array) -> Array:
    """Weighted means (N, C) of values (V, N, C) over the views, the first's where none counts."""
    total = weights.sum(axis=0)
    weights = np.where(total > 1e-9, weights, np.arange(len(weights))[:, None] == 0)
    return np.einsum("vn,vnc->nc", weights / weights.sum(axis=0), values)


@dataclass(frozen=True)
class TemplateTexture:
    """Observed colours spread over both sides of the vehicle."""

    colour: Array  # (N, 3) display values
    weight: Array  # (N,) how far `colour` replaces the model's own
    views: Array  # (N, 3) unit directions to the camera that saw `colour`, mirrored with it


def mirrored_texture(cloud: SurfaceCloud, seen: SurfaceView) -> TemplateTexture:
    """Fill what the view did not see from its mirror image; wheels and recesses keep the model's.

    A side seen poorly yields to its twin seen well.
    """
    textured = cloud.on_body & (cloud.gloss > 0)
    own = np.where(textured, seen.weight, 0.0)
    twin = own[cloud.twin]
    borrowed = twin * (1 - own)
    total = np.maximum(own + borrowed, 1e-9)
    share = (own / total)[:, None]
    return TemplateTexture(
        colour=share * seen.colour + (1 - share) * seen.colour[cloud.twin],
        weight=np.where(textured, np.minimum(own + borrowed, 1.0), 0.0),
        views=np.where(share > 0.5, seen.views, seen.views[cloud.twin] * MIRROR),
    )


_OPACITY = 0.99
_STYLES = 3  # offered to choose from
_SKETCH_SPACING = 0.024  # metres: enough for a silhouette
_CELLS = (0.055, 0.03)  # metres: patches that look alike are merged in voxels of these edges
_TOLERANCE = 0.03  # display values
_BACKING_DEPTH = 0.05  # metres behind the surface
_BACKING_CELL = 0.10
_VIEW_DEPENDENCE = 0.3  # of the model's changing reflections, how much a photographed patch keeps


class TemplateGenerator(BaseGenerator):
    """Parametric vehicle in the style of AutoSplat's template: class shape, symmetry, photographs.

    A body of the class, bent to the LiDAR points and the outlines of the masks, with wheels,
    windows, lamps and plates, covered with flat Gaussians. Colours come from the crop that shows
    the surface best, from the mirror image if only the other side is shown, else from the template
    with the observed paint.

    Args:
        spacing: metres between surface patches before merging; larger is coarser and faster.
        style: body style to use instead of the fitted one.
    """

    name = "template"

    def __init__(self, spacing: float = 0.016, style: str | None = None) -> None:
        self.spacing = spacing
        self.style = style

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """The body styles that fit LiDAR and outlines best, best first.

        Of several views, also what the best one gives alone.
        """
        if observation.further:
            alone = partial(self.generate, replace(observation, further=()), seed)
            return [*self._styles(observation, seed), alone]
        return self._styles(observation, seed)

    def _styles(self, observation: Observation, seed: int) -> list[Callable[[], Asset]]:
        if self.style is not None:
            return [partial(self.generate, observation, seed)]
        costs = _fit(observation, np.random.default_rng(seed), None).costs
        return [
            partial(TemplateGenerator(self.spacing, style).generate, observation, seed)
            for style in sorted(costs, key=lambda style: costs[style])[:_STYLES]
        ]

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Build the vehicle; it fills the logged box. See `ActorGenerator.generate`."""
        rng = np.random.default_rng(seed)
        size = observation.size
        fit = _fit(observation, rng, self.style)
        body = TemplateBody(size, fit.design)
        coarse = max(self.spacing, _SKETCH_SPACING)
        sketch = build_cloud(body, coarse, rng).points
        lidar = np.asarray(observation.points, np.float64)
        placements = place(body, sketch, coarse, observation, lidar[:: max(1, len(lidar) // 1200)])
        body = TemplateBody(size, find_axles(body, observation, placements))
        cloud = build_cloud(body, self.spacing, rng)
        views = balanced(
            [
                view_surface(cloud, view, placement)
                for view, placement in zip(observation.views, placements, strict=True)
            ]
        )
        seen = blended(views)
        light, paint = estimate_light(cloud, views, observation)
        windows, rims = estimate_windows(cloud, views, light), estimate_rims(cloud, views, light)
        dyed = cloud.albedo * (1 - cloud.glass * (1 - windows) - cloud.rim * (1 - rims))[:, None]
        cloud = replace(cloud, albedo=dyed, gloss=cloud.gloss * (1 - cloud.glass * (1 - windows)))
        gaussians = _gaussians(body, cloud, paint, mirrored_texture(cloud, seen), light)
        shift = gaussians.means.new_tensor([0.0, 0.0, -size[2] / 2])
        distance = fit.median_distance
        measured = {"median_lidar_distance_m": round(distance, 4)} if np.isfinite(distance) else {}
        return Asset(
            gaussians=replace(gaussians, means=gaussians.means + shift),
            axes=VEHICLE,
            generator=self.name,
            seed=seed,
            details={
                "style": fit.style,
                "views": len(views),
                "paint_srgb": " ".join(f"{v:.3f}" for v in linear_to_gamma(paint)),
                "light": round(light.level, 3),
                "mirrored": " ".join(f"{v:.3f}" for v in light.mirrored),
                "windows": round(windows, 3),
                "rims": round(rims, 3),
                **measured,
                "silhouette_overlap": round(float(np.mean([one.overlap for one in placements])), 4),
                "seen_share": round(float((seen.weight > 0.5).mean()), 4),
            },
            low_pass=MIP,  # far away, thousands of small discs would grow by the filter of 3DGS
        )


def _fit(observation: Observation, rng: np.random.Generator, style: str | None) -> ShapeFit:
    outlines = [contour(view) for view in observation.views]
    return fit_shape(
        observation.category, observation.size, observation.points, rng, style, outlines
    )


def _gaussians(
    body: TemplateBody,
    cloud: SurfaceCloud,
    paint: Array,
    texture: TemplateTexture,
    light: Daylight = CLEAR_DAY,
) -> Gaussians:
    """Merge the patches, bake light and photograph into harmonics, and back them with a shell."""
    albedo = cloud.painted(paint)
    weight = texture.weight[:, None]
    look = (1 - weight) * linear_to_gamma(light.level * albedo) + weight * texture.colour
    group = group_patches(
        cloud.points, cloud.normals, np.c_[look, 0.1 * cloud.gloss], _CELLS, _TOLERANCE
    )
    sh = _harmonics(group, cloud, albedo, texture, light)
    outside = flat_gaussians(group, cloud.points, cloud.normals, cloud.spacing, sh, _OPACITY)
    return concatenate([outside, _backing(body, cloud, sh[group])])


def _backing(body: TemplateBody, cloud: SurfaceCloud, sh: Array) -> Gaussians:
    """A coarse shell behind the surface, so that the far side does not shine through its gaps."""
    inner = cloud.points - _BACKING_DEPTH * cloud.normals
    first, second = tangents(cloud.normals)
    covered = cloud.on_body.copy()
    for direction in (first, -first, second, -second):
        # a wide Gaussian must not stick out at sills and wheel arches
        covered &= body.distance(inner + 1.3 * _BACKING_CELL * direction) < -0.01
    kept = np.flatnonzero(covered)
    shell = shell_groups(cloud.points[kept], cloud.normals[kept], _BACKING_CELL)
    return flat_gaussians(
        shell,
        inner[kept],
        cloud.normals[kept],
        cloud.spacing[kept],
        group_means(shell, sh[kept])[0],
        _OPACITY,
    )


def _harmonics(
    group: Int64Array, cloud: SurfaceCloud, albedo: Array, texture: TemplateTexture, light: Daylight
) -> Array:
    """Harmonics (G, 4, 3) of each group: the lit model, moved onto the photograph where seen."""
    points, normals, albedo, gloss, colour, weight, views = group_means(
        group,
        cloud.points,
        cloud.normals,
        albedo,
        cloud.gloss,
        texture.colour,
        texture.weight,
        texture.views,
    )
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    views = views / np.maximum(np.linalg.norm(views, axis=1, keepdims=True), 1e-9)
    sh = fit_harmonics(albedo, gloss, normals, points[:, 2], light)
    sh[:, 1:] *= (1 - (1 - _VIEW_DEPENDENCE) * weight)[:, None, None]
    modelled = 0.5 + np.einsum("nk,nkc->nc", sh_basis(-views), sh)
    sh[:, 0] += weight[:, None] * (colour - modelled) / C0
    return sh
