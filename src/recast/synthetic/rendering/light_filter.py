"""Removes the noise of sampled light without blurring across edges.

An a-trous filter (Dammertz et al., "Edge-avoiding a-trous wavelet transform for fast global
illumination filtering", 2010) on the light alone, colours and textures left out of it; separable,
with weights from normals and from distance to one another's planes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.lighting import Light
from recast.synthetic.rendering.surface_points import SurfacePoints

SUN_STEPS = (1, 2)
"""Pixels between the taps of each pass over the sun's share."""
SKY_STEPS = (1, 2, 4, 8, 16)
"""The same over the light of the sky."""
PLANE_TOLERANCE = np.float32(0.02)
"""Metres off each other's plane at which neighbours 1 m away from the camera count a quarter."""
NORMAL_POWER = 16
"""Of the cosine between normals; a power of two."""
LEAST_SUPPORT = np.float32(0.9)
"""Sum of the weights of the four neighbours, each at most 1/2, below which a point is alone."""


class LightFilter:
    """The filter for one image.

    Args:
        points: what the pixels' centres show.
        pixels: (N,) row-major index of each point's pixel; the others are sky.
        height, width: of the image.
    """

    def __init__(
        self, points: SurfacePoints, pixels: NDArray[np.int64], height: int, width: int
    ) -> None:
        self._pixels, self._shape = pixels, (height, width)
        guide = np.zeros((7, height * width), np.float32)
        guide[:3, pixels] = points.position.T
        guide[3:6, pixels] = points.normal.T
        guide[6, pixels] = 1 / (PLANE_TOLERANCE * (1 + np.float32(0.1) * points.distance))
        self._guide = guide.reshape(7, height, width)

    def lonely(self) -> NDArray[np.int64]:
        """Indices of points with hardly a neighbour to share samples with: poles, leaves."""
        support = np.zeros(self._shape, np.float32)
        for axis in (1, 2):
            ahead, behind = _shifted(axis, 1)
            weight = _pair_weight(self._guide[behind], self._guide[ahead])
            support[ahead[1:]] += weight
            support[behind[1:]] += weight
        return np.flatnonzero(support.ravel()[self._pixels] < LEAST_SUPPORT)

    def smooth(self, noisy: Light) -> Light:
        """Smoothed light of the points."""
        rows = np.zeros((4, self._shape[0] * self._shape[1]), np.float32)
        rows[0, self._pixels] = noisy.sun
        rows[1:, self._pixels] = noisy.sky.T
        value = rows.reshape(4, *self._shape)
        for step in SKY_STEPS:
            channels = slice(0 if step in SUN_STEPS else 1, 4)
            for axis in (1, 2):
                value[channels] = _pass(value[channels], self._guide, step, axis)
        flat = value.reshape(4, -1)[:, self._pixels]
        return Light(flat[0], np.ascontiguousarray(flat[1:].T))


def _shifted(axis: int, step: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Index of (channels, H, W) without the first, and without the last `step` of an axis."""
    before = (slice(None),) * axis
    return (*before, slice(step, None)), (*before, slice(None, -step))


def _pass(value: Float32Array, guide: Float32Array, step: int, axis: int) -> Float32Array:
    """Three taps (1/4, 1/2, 1/4), `step` pixels apart, along one axis of (channels, H, W)."""
    if value.shape[axis] <= step:
        return value
    ahead, behind = _shifted(axis, step)
    # The weight between two pixels is the same both ways: computed once for each pair.
    weight = _pair_weight(guide[behind], guide[ahead])
    total = np.ones(value.shape[1:], np.float32)
    total[ahead[1:]] += weight
    total[behind[1:]] += weight
    sums = value.copy()
    sums[ahead] += weight * value[behind]
    sums[behind] += weight * value[ahead]
    sums /= total
    return sums


def _pair_weight(first: Float32Array, second: Float32Array) -> Float32Array:
    """Half the likeness (H, W) of pixels as surfaces: 0.5 on one plane, 0 beyond an edge."""
    parallel = first[3] * second[3]
    parallel += first[4] * second[4]
    parallel += first[5] * second[5]
    off = (second[0] - first[0]) * (first[3] + second[3])
    off += (second[1] - first[1]) * (first[4] + second[4])
    off += (second[2] - first[2]) * (first[5] + second[5])
    off *= np.minimum(first[6], second[6])
    off *= off
    np.maximum(parallel, 0, out=parallel)
    for _ in range(NORMAL_POWER.bit_length() - 1):
        parallel *= parallel
    off += 1
    off *= off
    parallel /= off
    parallel *= np.float32(0.5)
    return parallel
