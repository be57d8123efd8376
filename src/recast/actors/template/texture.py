"""Colours from the photographs: which patches they show, how, and both sides of the vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.observation import Observation
from recast.actors.template.cloud import MIRROR, SurfaceCloud, ramp
from recast.actors.template.proportions import TemplatePlacement
from recast.arrays import Array
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear, linear_to_gamma

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


def balanced(
    views: Sequence[SurfaceView], painted: NDArray[np.bool_] | None = None
) -> list[SurfaceView]:
    """The views at the exposure of the first, by the patches that each shares with those before.

    Cameras expose differently, and a vehicle drives through shade. A view that shares few patches
    keeps its brightness nearly.

    Args:
        painted: (N,) patches to compare, if enough of them are shared: panes and lamps mirror
            something else in every view.
    """
    done = [views[0]]
    for view in views[1:]:
        known = blended(done)
        shared = np.minimum(known.weight, view.weight) > 0.5
        if painted is not None and (shared & painted).sum() >= _FEW_PATCHES:
            shared &= painted
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

    @staticmethod
    def nothing(count: int) -> TemplateTexture:
        """That of a vehicle that no photograph shows."""
        ahead = np.tile([1.0, 0.0, 0.0], (count, 1))
        return TemplateTexture(np.zeros((count, 3)), np.zeros(count), ahead)


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
