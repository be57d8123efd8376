"""Pinhole cameras with OpenCV distortion. Camera frame: x right, y down, z forward.

Pixel centres lie at +0.5: the top left pixel covers [0, 1) x [0, 1) and its centre is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.geometry import boxes

MOST_PIXELS = 1 << 26
"""Pixels of an image, at most: 8192 x 8192."""
LONGEST = 1e7
"""Pixels: longest focal length, and farthest principal point."""


@dataclass(frozen=True)
class PinholeCamera:
    """Intrinsics of one camera.

    Attributes:
        width, height: image size in pixels.
        fx, fy, cx, cy: focal lengths and principal point in pixels, pixel centres at +0.5.
        distortion: OpenCV order (k1, k2, p1, p2, k3); all zero for a rectified image.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def validate(self) -> None:
        """Raise ValueError, naming the field, where a value cannot be a camera's."""
        if self.width <= 0 or self.height <= 0 or self.width * self.height > MOST_PIXELS:
            raise ValueError(f"PinholeCamera.width, height: {self.width} x {self.height}")
        if not (0 < self.fx <= LONGEST and 0 < self.fy <= LONGEST):
            raise ValueError(
                f"PinholeCamera.fx, fy: must be above 0 and at most {LONGEST:g}, got "
                f"{self.fx}, {self.fy}"
            )
        if not (abs(self.cx) <= LONGEST and abs(self.cy) <= LONGEST):
            raise ValueError(f"PinholeCamera.cx, cy: no point near an image, {self.cx}, {self.cy}")
        if len(self.distortion) != 5 or not np.all(np.isfinite(self.distortion)):
            raise ValueError(f"PinholeCamera.distortion: five numbers, got {self.distortion}")

    @property
    def matrix(self) -> Array:
        """The 3x3 intrinsic matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def is_rectified(self) -> bool:
        """Whether there is no distortion."""
        return not any(self.distortion)

    def rectified(self) -> PinholeCamera:
        """The same camera without distortion: what an undistorted image has."""
        return replace(self, distortion=(0.0,) * 5)

    def resized(self, width: int, height: int) -> PinholeCamera:
        """The camera of the image resampled to width x height."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=self.cx * sx,
            cy=self.cy * sy,
        )

    def cropped(self, left: int, top: int, width: int, height: int) -> PinholeCamera:
        """The camera of a crop whose top left pixel is (left, top)."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def project(self, points: ArrayLike) -> tuple[Array, Array]:
        """Project camera-frame points (..., 3) in metres.

        Returns:
            pixels (..., 2), meaningful where depth is positive, and depth (...) along z.
        """
        points = np.asarray(points, np.float64)
        depth = points[..., 2]
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        normalised = points[..., :2] / safe[..., None]
        distorted = distort(normalised, self.distortion)
        pixels = distorted * [self.fx, self.fy] + [self.cx, self.cy]
        return pixels, depth

    def rays(self, pixels: ArrayLike) -> Array:
        """Unit-depth directions (..., 3), z = 1, through pixels (..., 2), distortion undone."""
        pixels = np.asarray(pixels, np.float64)
        normalised = undistort((pixels - [self.cx, self.cy]) / [self.fx, self.fy], self.distortion)
        return np.concatenate([normalised, np.ones((*normalised.shape[:-1], 1))], axis=-1)

    def unproject(self, pixels: ArrayLike, depth: ArrayLike) -> Array:
        """Camera-frame points (..., 3) at pixels (..., 2) and depth (...) along z, metres."""
        return self.rays(pixels) * np.asarray(depth, np.float64)[..., None]

    def pixel_grid(self) -> Array:
        """Pixel centres (height, width, 2)."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1)


def distort(normalised: ArrayLike, distortion: ArrayLike) -> Array:
    """OpenCV's radial-tangential model on normalised coordinates (..., 2).

    The polynomial is fitted within the image; further out it turns back and would fold points from
    beside the camera into the picture. Beyond the radius where it stops growing it is continued in
    proportion to the radius instead.
    """
    xy = np.asarray(normalised, np.float64)
    k1, k2, p1, p2, k3 = np.asarray(distortion, np.float64)
    r2 = np.sum(xy * xy, axis=-1)
    shrink = np.sqrt(np.minimum(1.0, _fold_radius2(k1, k2, k3) / np.maximum(r2, 1e-300)))
    x, y, r2 = xy[..., 0] * shrink, xy[..., 1] * shrink, r2 * shrink**2
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    tangential_x = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    tangential_y = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack(
        [(x * radial + tangential_x) / shrink, (y * radial + tangential_y) / shrink], axis=-1
    )


def _fold_radius2(k1: float, k2: float, k3: float) -> float:
    """Squared radius at which r (1 + k1 r^2 + k2 r^4 + k3 r^6) stops growing, or infinity."""
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    turning = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(turning.min(initial=np.inf))


def undistort(distorted: ArrayLike, distortion: ArrayLike) -> Array:
    """Invert `distort` on normalised coordinates (..., 2) by Newton steps.

    Converges for the fields of view of driving cameras; a fixed-point iteration would not at the
    corners of wide lenses.
    """
    target = np.asarray(distorted, np.float64)
    if not np.any(distortion):
        return target.copy()
    xy = target.copy()
    step = 1e-6
    x_step, y_step = np.array([step, 0.0]), np.array([0.0, step])
    for _ in range(20):
        residual = distort(xy, distortion) - target
        if np.max(np.abs(residual), initial=0.0) < 1e-12:
            break
        ddx = distort(xy + x_step, distortion) - distort(xy - x_step, distortion)
        ddy = distort(xy + y_step, distortion) - distort(xy - y_step, distortion)
        jacobian = np.stack([ddx, ddy], axis=-1) / (2 * step)
        xy = xy - np.linalg.solve(jacobian, residual[..., None])[..., 0]
    return xy


def box_outline(
    size: ArrayLike, camera_from_box: ArrayLike, camera: PinholeCamera, near: float = 0.1
) -> Array:
    """Pixels (N, 2) whose convex hull is the image of a box; none where it is all behind `near`.

    Edges that cross the near plane are cut there, so a box beside the camera keeps a finite,
    correct outline.
    """
    points = boxes.corners(size, camera_from_box)
    visible = [p for p in points if p[2] >= near]
    for i, j in boxes.EDGES:
        a, b = points[i], points[j]
        if (a[2] < near) != (b[2] < near):
            t = (near - a[2]) / (b[2] - a[2])
            visible.append(a + t * (b - a))
    if not visible:
        return np.zeros((0, 2))
    pixels, _ = camera.rectified().project(np.array(visible))
    return pixels


def box_rectangle(
    size: ArrayLike, camera_from_box: ArrayLike, camera: PinholeCamera, near: float = 0.1
) -> Array | None:
    """Image rectangle (left, top, right, bottom) in pixels around a projected box, not clipped.

    Returns:
        (4,) or None where the whole box lies behind the near plane; see `box_outline`.
    """
    pixels = box_outline(size, camera_from_box, camera, near)
    if len(pixels) == 0:
        return None
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
