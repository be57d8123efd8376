"""Any lens by pinhole images: one, or the sides of a cube for lenses wider than a pinhole."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from recast.arrays import Array, Image
from recast.cameras.lenses import LensCamera
from recast.cameras.pinhole import MOST_PIXELS, PinholeCamera

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
    """A pinhole camera at the lens's place.

    Attributes:
        camera: rectified, just large enough for what the lens sees through it.
        face_from_lens: (3, 3) rotation.
    """

    camera: PinholeCamera
    face_from_lens: Array


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
        """The rectified camera of a lens with one face.

        Raises:
            ValueError: it has none or several.
        """
        if len(self.faces) != 1 or self.faces[0].face_from_lens is not _TURNS[0]:
            raise ValueError(f"Lens.source: it has {len(self.faces)} faces")
        return self.faces[0].camera

    def bend(self, *images: Image) -> Image:
        """Images (h, w, 3) uint8 of the faces as `camera` sees them (height, width, 3), black
        beyond its limit.

        Raises:
            ValueError: an image does not have the size of its face, or is missing.
        """
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
    they are on the face (n, 2), its lower corner and its size (2,), all in pixels.

    Raises:
        ValueError: see `Lens`.
    """
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
