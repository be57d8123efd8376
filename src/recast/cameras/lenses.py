"""Lenses that `PinholeCamera` cannot describe: OpenCV's rational model, fisheye and f-theta.

Camera frame and pixels as in `recast.cameras.pinhole`. A lens gives rays of pixels and pixels of
rays; beyond its limit, where its polynomial turns back or its largest angle ends, both are NaN.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, Protocol, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, Image
from recast.cameras.pinhole import LONGEST, MOST_PIXELS, PinholeCamera

_KNOTS = 2049
_STEPS = 20
_EDGE = np.deg2rad(89.9)
"""Widest angle from the axis of a lens that projects onto a plane."""


class LensCamera(Protocol):
    """What draws and asks lenses; `PinholeCamera` is one, but its rays have z = 1.

    Attributes:
        width, height: image size in pixels.
        fx, fy: pixels per radian near the axis, along x and y.
    """

    @property
    def width(self) -> int: ...  # noqa: D102

    @property
    def height(self) -> int: ...  # noqa: D102

    @property
    def fx(self) -> float: ...  # noqa: D102

    @property
    def fy(self) -> float: ...  # noqa: D102

    def rays(self, pixels: ArrayLike) -> Array:
        """Directions (..., 3) through pixels (..., 2); NaN beyond the limit."""


@dataclass(frozen=True)
class RationalLens:
    """A lens with OpenCV's rational model.

    Attributes:
        width, height: image size in pixels.
        fx, fy, cx, cy: focal lengths and principal point in pixels, pixel centres at +0.5.
        radial: coefficients k1 .. k6.
        tangential: coefficients p1, p2.
        thin_prism: coefficients s1 .. s4.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    radial: tuple[float, ...]
    tangential: tuple[float, ...] = (0.0, 0.0)
    thin_prism: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def validate(self) -> None:
        """Raise ValueError, naming the field, where a value cannot be a lens's."""
        _check_image("RationalLens", self.width, self.height, (self.cx, self.cy))
        if not (0 < self.fx <= LONGEST and 0 < self.fy <= LONGEST):
            raise ValueError(f"RationalLens.fx, fy: not above 0, or too long: {self.fx}, {self.fy}")
        for name, count in (("radial", 6), ("tangential", 2), ("thin_prism", 4)):
            _check_numbers(f"RationalLens.{name}", getattr(self, name), count)

    def resized(self, width: int, height: int) -> Self:
        """The lens of the image resampled to width x height."""
        sx, sy = width / self.width, height / self.height
        fx, fy, cx, cy = self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy
        return replace(self, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)

    def project(self, directions: ArrayLike) -> Array:
        """Pixels (..., 2) of directions (..., 3) of any length."""
        x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            xy = np.stack([x / z, y / z], axis=-1)
            bent, a, b, c, d = self._distort(xy)
            r2 = np.sum(xy * xy, axis=-1)
            seen = (z > 0) & (r2 < self._limit2) & (a * d - b * c > 0)
        return np.where(seen[..., None], bent * [self.fx, self.fy] + [self.cx, self.cy], np.nan)

    def rays(self, pixels: ArrayLike) -> Array:
        """Unit directions (..., 3) through pixels (..., 2)."""
        target = (np.asarray(pixels, np.float64) - [self.cx, self.cy]) / [self.fx, self.fy]
        far, limit2 = np.linalg.norm(target, axis=-1), self._limit2
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            knots = np.tan(np.linspace(0.0, min(np.arctan(np.sqrt(limit2)), _EDGE), _KNOTS))
            bent = knots * self._radial(knots * knots)[0]
            xy = target * (np.interp(far, bent, knots) / np.maximum(far, 1e-300))[..., None]
            for _ in range(_STEPS):
                found, a, b, c, d = self._distort(xy)
                u, v = np.moveaxis(target - found, -1, 0)
                if not np.any(np.hypot(u, v) >= 1e-13):  # nor NaN
                    break
                det = a * d - b * c
                xy = xy + np.stack([(d * u - b * v) / det, (a * v - c * u) / det], axis=-1)
            found, a, b, c, d = self._distort(xy)
            close = np.linalg.norm(found - target, axis=-1) <= 1e-9 * np.maximum(far, 1.0)
            seen = close & (np.sum(xy * xy, axis=-1) < limit2) & (a * d - b * c > 0)
            rays = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.where(seen[..., None], rays, np.nan)

    def _radial(self, r2: Array) -> tuple[Array, Array]:
        """The radial factor and its derivative with respect to r2."""
        k1, k2, k3, k4, k5, k6 = self.radial
        above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        rises = (k1 + r2 * (2 * k2 + r2 * 3 * k3)) * below
        rises -= (k4 + r2 * (2 * k5 + r2 * 3 * k6)) * above
        return above / below, rises / (below * below)

    def _distort(self, xy: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Distorted coordinates (..., 2) and their derivatives: x by x, x by y, y by x, y by y."""
        p1, p2 = self.tangential
        s1, s2, s3, s4 = self.thin_prism
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial, rise = self._radial(r2)
        bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2)
        bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4)
        prism_x, prism_y = 2 * (s1 + 2 * s2 * r2), 2 * (s3 + 2 * s4 * r2)
        both = 2 * x * y * rise + 2 * p1 * x + 2 * p2 * y
        return (
            np.stack([bent_x, bent_y], axis=-1),
            radial + 2 * x * x * rise + 2 * p1 * y + 6 * p2 * x + prism_x * x,
            both + prism_x * y,
            both + prism_y * x,
            radial + 2 * y * y * rise + 6 * p1 * y + 2 * p2 * x + prism_y * y,
        )

    @property
    def _limit2(self) -> float:
        """Squared radius at which the radial part stops growing or has a pole, or infinity."""
        k1, k2, k3, k4, k5, k6 = self.radial
        above, below = np.array([1, k1, k2, k3]), np.array([1, k4, k5, k6])
        powers = np.arange(4)
        grows = np.convolve(above * (1 + 2 * powers), below) - np.convolve(
            above, 2 * powers * below
        )
        return min(_first_root(grows), _first_root(below))


@dataclass(frozen=True)
class RadialLens:
    """A lens whose distance from the centre is a polynomial of the angle from the axis, or the
    angle one of the distance: fisheye and f-theta.

    Attributes:
        width, height: image size in pixels.
        cx, cy: principal point in pixels, pixel centres at +0.5.
        matrix: ((a, b), (c, d)), pixels from the distance's own unit.
        polynomial: coefficients in rising powers.
        gives: what the polynomial gives: the "distance" of an angle in radians, or the "angle".
        max_angle: largest angle from the axis, radians, at most pi.
    """

    width: int
    height: int
    cx: float
    cy: float
    matrix: tuple[tuple[float, float], tuple[float, float]]
    polynomial: tuple[float, ...]
    gives: Literal["distance", "angle"]
    max_angle: float

    def validate(self) -> None:
        """Raise ValueError, naming the field, where a value cannot be a lens's."""
        _check_image("RadialLens", self.width, self.height, (self.cx, self.cy))
        _check_numbers("RadialLens.matrix", np.ravel(self.matrix), 4)
        if not np.linalg.det(self.matrix) > 0:
            raise ValueError(f"RadialLens.matrix: has no inverse, or mirrors: {self.matrix}")
        _check_numbers("RadialLens.polynomial", self.polynomial, None)
        if not 2 <= len(self.polynomial) <= 32 or not self.polynomial[1] > 0:
            raise ValueError(
                "RadialLens.polynomial: does not grow at 0, or has over 32 coefficients"
            )
        if not 0 < self.max_angle <= np.pi + 1e-6:
            raise ValueError(f"RadialLens.max_angle: not within 0 and pi: {self.max_angle}")
        if not (self.fx <= LONGEST and self.fy <= LONGEST):
            raise ValueError(f"RadialLens: focal lengths are too long: {self.fx}, {self.fy}")

    @property
    def fx(self) -> float:
        """Pixels per radian near the axis, along x."""
        return self._focal(0)

    @property
    def fy(self) -> float:
        """Pixels per radian near the axis, along y."""
        return self._focal(1)

    def resized(self, width: int, height: int) -> Self:
        """The lens of the image resampled to width x height."""
        sx, sy = width / self.width, height / self.height
        (a, b), (c, d) = self.matrix
        matrix = ((a * sx, b * sx), (c * sy, d * sy))
        return replace(
            self, width=width, height=height, cx=self.cx * sx, cy=self.cy * sy, matrix=matrix
        )

    def project(self, directions: ArrayLike) -> Array:
        """Pixels (..., 2) of directions (..., 3) of any length."""
        directions = np.asarray(directions, np.float64)
        xy = directions[..., :2]
        across = np.linalg.norm(xy, axis=-1)
        angle = np.arctan2(across, directions[..., 2])
        limit = self._limit
        if self.gives == "distance":
            seen, distance = _within(angle, limit), self._value(angle)
        else:
            seen, distance = _within(angle, self._value(np.array(limit))), self._inverse(angle)
        flat = xy * (distance / np.maximum(across, 1e-300))[..., None]
        pixels = flat @ np.transpose(self.matrix) + [self.cx, self.cy]
        return np.where(seen[..., None], pixels, np.nan)

    def rays(self, pixels: ArrayLike) -> Array:
        """Unit directions (..., 3) through pixels (..., 2)."""
        flat = (np.asarray(pixels, np.float64) - [self.cx, self.cy]) @ np.linalg.inv(self.matrix).T
        distance = np.linalg.norm(flat, axis=-1)
        limit = self._limit
        if self.gives == "distance":
            seen, angle = _within(distance, self._value(np.array(limit))), self._inverse(distance)
        else:
            seen, angle = _within(distance, limit), self._value(np.minimum(distance, limit))
        xy = flat * (np.sin(angle) / np.maximum(distance, 1e-300))[..., None]
        rays = np.concatenate([xy, np.cos(angle)[..., None]], axis=-1)
        return np.where(seen[..., None], rays, np.nan)

    def _focal(self, axis: int) -> float:
        slope = self.polynomial[1] if self.gives == "distance" else 1 / self.polynomial[1]
        return float(np.linalg.norm(self.matrix[axis]) * slope)

    def _value(self, where: Array) -> Array:
        return np.asarray(np.polynomial.polynomial.polyval(where, self.polynomial))

    @property
    def _limit(self) -> float:
        """Largest angle, or distance, up to which the polynomial grows and the lens sees."""
        derivative = np.polynomial.polynomial.polyder(self.polynomial)
        turns = _first_root(derivative)
        if self.gives == "distance":
            return min(turns, self.max_angle)
        widest = np.array(self.polynomial)
        widest[0] -= self.max_angle
        return min(turns, _first_root(widest), LONGEST)

    def _inverse(self, values: Array) -> Array:
        """Where the polynomial has these values, within 0 and the limit."""
        limit = self._limit
        knots = np.linspace(0.0, limit, _KNOTS)
        table = self._value(knots)
        cell = np.clip(np.searchsorted(table, values), 1, _KNOTS - 1)
        low, high = knots[cell - 1], knots[cell]
        found = np.interp(values, table, knots)
        derivative = np.polynomial.polynomial.polyder(self.polynomial)
        for _ in range(_STEPS):
            slope = np.polynomial.polynomial.polyval(found, derivative)
            step = (values - self._value(found)) / np.maximum(slope, 1e-12)
            found = np.clip(found + step, low, high)
            if np.max(np.abs(step), initial=0.0) < 1e-15 * limit:
                break
        return np.asarray(found)


def _within(values: Array, limit: float | Array) -> Array:
    """Whether values do not exceed the limit, up to their own rounding.

    What lies on the limit comes back from pixel or ray a few units in the last place beside it.
    """
    return np.asarray(values <= limit * (1 + 1e-12))


def fisheye_lens(
    width: int,
    height: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    radial: tuple[float, ...],
    max_angle: float,
) -> RadialLens:
    """OpenCV's fisheye model: distance = angle (1 + k1 angle^2 + k2 angle^4 + ...).

    Args:
        radial: coefficients k1 to at most k4.
    """
    _check_numbers("fisheye_lens.radial", radial, None)
    if len(radial) > 4:
        raise ValueError(f"fisheye_lens.radial: {len(radial)} coefficients, at most 4 are known")
    odd = (number for k in radial for number in (0.0, k))
    polynomial = (0.0, 1.0, *odd)
    matrix = ((fx, 0.0), (0.0, fy))
    return RadialLens(width, height, cx, cy, matrix, polynomial, "distance", max_angle)


def ftheta_lens(
    width: int,
    height: int,
    cx: float,
    cy: float,
    polynomial: tuple[float, ...],
    gives: Literal["distance", "angle"],
    max_angle: float,
    linear_cde: tuple[float, float, float] = (1.0, 0.0, 0.0),
) -> RadialLens:
    """The f-theta model: a polynomial between angles and pixels, then the matrix ((c, d), (e, 1)).

    Args:
        polynomial: the reference polynomial; its inverse is worked out.
    """
    c, d, e = linear_cde
    return RadialLens(width, height, cx, cy, ((c, d), (e, 1.0)), polynomial, gives, max_angle)


def _first_root(coefficients: ArrayLike) -> float:
    """The first positive root of a polynomial in rising powers that is not 0 at 0, or infinity."""
    # Of the polynomial in 1/x, the largest: tiny last coefficients do no harm there.
    with np.errstate(over="ignore"):
        roots = np.roots(np.asarray(coefficients, np.float64))
        real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)]
        return float(1.0 / real.max()) if len(real) else np.inf


def _check_image(where: str, width: int, height: int, centre: tuple[float, float]) -> None:
    if width <= 0 or height <= 0 or width * height > MOST_PIXELS:
        raise ValueError(f"{where}.width, height: {width} x {height}")
    if not np.all(np.abs(centre) <= LONGEST):  # also NaN
        raise ValueError(f"{where}.cx, cy: no point near an image: {centre}")


def _check_numbers(where: str, values: ArrayLike, count: int | None) -> None:
    numbers = np.asarray(values, np.float64)
    if count is not None and numbers.shape != (count,):
        raise ValueError(f"{where}: expected {count} numbers, got {numbers.shape}")
    if not np.all(np.abs(numbers) <= 1e12):  # also NaN
        raise ValueError(f"{where}: a number is not finite, or too large: {numbers}")


WIDEST = float(np.tan(np.deg2rad(60.0)))
"""Farthest that one pinhole looks to a side: 120 degrees in all. Splats smear further out."""
_LONGEST_SIDE = 32_000
"""Pixels of a picture that OpenCV can remap."""
_ROWS = 256
_FEW = 65
"""Rows and columns by which a lens that needs too large faces is refused at once."""

_TURNS = tuple(
    np.array(turn, np.float64)
    for turn in (
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    )
)
"""`face_from_lens` of the sides of a cube: ahead, right, left, below, above, behind."""


@dataclass(frozen=True)
class Face:
    """A pinhole camera at the lens's place."""

    camera: PinholeCamera  # rectified, just large enough for what the lens sees through it
    face_from_lens: Array  # (3, 3) rotation


class Lens:
    """Bends pinhole images to those of a camera with distortion.

    Render the faces, then call `bend`. The map is computed once.

    Args:
        camera: camera of the images to be made: any lens, also a `PinholeCamera` with distortion.
        most_pixels: largest number of pixels of all faces together.

    Attributes:
        faces: one up to a field of view of about 120 degrees; else up to six, the sides of a cube.
            They have the lens's focal lengths. None if the lens sees nothing.

    Raises:
        ValueError: the faces would have more pixels, or longer sides, than can be drawn.
    """

    def __init__(self, camera: LensCamera, most_pixels: int = MOST_PIXELS) -> None:
        self.camera = camera
        shape = camera.height, camera.width
        # The faces of a few pixels are no larger than those of all, which take seconds to find.
        for _ in _extents(camera, _rays(camera, *(_spread(side) for side in shape)), most_pixels):
            pass
        rows, columns = (np.arange(float(side)) for side in shape)
        blocks = np.split(rows, range(_ROWS, shape[0], _ROWS))
        rays = np.concatenate([_rays(camera, block, columns) for block in blocks])
        seen = np.isfinite(rays[..., 2])
        self._dark = None if seen.all() else ~seen
        self._x, self._y = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        faces: list[Face] = []
        top = 0
        for turn, there, flat, low, size in _extents(camera, rays, most_pixels):
            width, height = size.astype(int).tolist()
            pinhole = PinholeCamera(width, height, camera.fx, camera.fy, *(-low).tolist())
            faces.append(Face(pinhole, turn))
            # OpenCV counts from the centre of the first pixel.
            x, y = (flat - low - 0.5).T
            self._x[there], self._y[there] = x, y + top
            top += height
        self.faces = tuple(faces)

    @property
    def source(self) -> PinholeCamera:
        """The rectified camera of a lens with one face. Raises ValueError: it has none or
        several."""
        if len(self.faces) != 1 or self.faces[0].face_from_lens is not _TURNS[0]:
            raise ValueError(f"Lens.source: it has {len(self.faces)} faces")
        return self.faces[0].camera

    def bend(self, *images: Image) -> Image:
        """Images (h, w, 3) uint8 of the faces as `camera` sees them (height, width, 3), black
        beyond its limit. Raises ValueError: an image does not have the size of its face, or is
        missing."""
        if len(images) != len(self.faces):
            raise ValueError(f"Lens.bend: expected {len(self.faces)} images, got {len(images)}")
        for image, face in zip(images, self.faces, strict=True):
            expected = (face.camera.height, face.camera.width)
            if image.shape[:2] != expected:
                raise ValueError(f"Lens.bend: expected {expected} pixels, got {image.shape[:2]}")
        if not images:
            return np.zeros((self.camera.height, self.camera.width, 3), np.uint8)
        source = images[0] if len(images) == 1 else _stacked(images)
        maps = self._x, self._y
        remapped = cv2.remap(source, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        bent = np.asarray(remapped, np.uint8)
        if self._dark is not None:
            bent[self._dark] = 0
        return bent


def _spread(side: int) -> Array:
    """Some indices of rows or columns, the first and the last among them."""
    return np.unique(np.linspace(0, side - 1, _FEW).round())


def _rays(camera: LensCamera, rows: Array, columns: Array) -> Array:
    """Rays of some pixels: those of all at once would need several times the memory."""
    u, v = np.meshgrid(columns + 0.5, rows + 0.5)
    return camera.rays(np.stack([u, v], axis=-1))


def _extents(
    camera: LensCamera, rays: Array, most_pixels: int
) -> Iterator[tuple[Array, Array, Array, Array, Array]]:
    """The faces of some pixels: `face_from_lens` (3, 3), mask of the pixels (height, width), where
    they are on the face (n, 2), its lower corner and its size (2,), all in pixels. Raises
    ValueError: see `Lens`."""
    below, pixels = 0.0, 0.0
    for turn, there in _split(rays, np.isfinite(rays[..., 2])):
        here = rays[there] @ turn.T
        flat = here[:, :2] / here[:, 2:] * [camera.fx, camera.fy]
        # Half a pixel beyond the outermost centres is what the outermost pixels cover.
        low = np.floor(flat.min(0) - 0.5 + 1e-6)
        size = np.ceil(flat.max(0) + 0.5 - 1e-6 - low)
        pixels += float(size.prod())
        below += float(size[1])
        if pixels > most_pixels or max(float(size[0]), below) > _LONGEST_SIDE:
            raise ValueError(f"Lens: needs pinhole images of over {pixels:.0f} pixels")
        yield turn, there, flat, low, size


def _split(rays: Array, seen: Array) -> list[tuple[Array, Array]]:
    """`face_from_lens` (3, 3) and the pixels (height, width) of each face that shows any."""
    if not seen.any():
        return []
    with np.errstate(invalid="ignore"):
        ahead = np.where(seen, rays[..., 2], 1.0)
        aside = np.where(seen, np.abs(rays[..., :2]).max(-1), 0.0)
        if (ahead > 0).all() and (aside <= WIDEST * ahead).all():
            return [(_TURNS[0], seen)]
        nearest = np.argmax(rays @ np.stack([turn[2] for turn in _TURNS]).T, axis=-1)
    split = [(turn, seen & (nearest == index)) for index, turn in enumerate(_TURNS)]
    return [(turn, there) for turn, there in split if there.any()]


def _stacked(images: tuple[Image, ...]) -> Image:
    """One below the other."""
    width = max(image.shape[1] for image in images)
    padded = [np.pad(image, ((0, 0), (0, width - image.shape[1]), (0, 0))) for image in images]
    return np.asarray(np.concatenate(padded), np.uint8)
