"""What all drawings of the report share: one colour for one thing, and a canvas in metres.

Colours are RGB, 0..255. The map is dark and arms are of middle lightness: both read alike on light
and dark pages. A canvas shows the ground plane from above.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Image
from recast.core.images import draw_text

Colour = tuple[int, int, int]

EGO: Colour = (86, 164, 255)
ACTOR: Colour = (255, 159, 67)
PLAN: Colour = (94, 226, 160)
LOGGED: Colour = (150, 160, 176)
COLLISION: Colour = (255, 82, 82)
TEXT: Colour = (232, 236, 242)
GROUND: Colour = (22, 25, 31)
GRID: Colour = (32, 36, 44)
DRIVABLE: Colour = (46, 52, 62)
BOUNDARY: Colour = (104, 114, 130)
CENTRELINE: Colour = (78, 88, 104)
ROUTE: Colour = (70, 96, 130)
SHARES: Mapping[str, Colour] = {
    "seen": (40, 130, 220),
    "mirrored": (245, 205, 60),
    "invented": (214, 60, 90),
}
"""Where a vehicle's looks come from; told apart by people who cannot tell red, green or blue."""
ARMS: tuple[Colour, ...] = (
    (133, 104, 224),
    (16, 150, 140),
    (206, 72, 126),
    (140, 132, 40),
    (70, 120, 200),
)


def arm_colour(index: int) -> Colour:
    """Colour of the `index`-th arm of a report; repeats after the last."""
    return ARMS[index % len(ARMS)]


def css(colour: Colour) -> str:
    """`#rrggbb`."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def dimmed(colour: Colour, share: float) -> Colour:
    """`colour` mixed with the ground, `share` in [0, 1] of it left."""
    red, green, blue = (
        round(share * c + (1 - share) * g) for c, g in zip(colour, GROUND, strict=True)
    )
    return red, green, blue


_SHIFT = 4  # cv2 draws at 1/16 pixel
_FAR = 1e5  # pixels; keeps far-away points within cv2's fixed-point range


@dataclass(frozen=True)
class CanvasView:
    """Where an orthographic picture of width x height pixels looks.

    Attributes:
        centre: (2,) world point in the picture's middle, metres.
        heading: world direction, radians, that points to the right in the picture.
        scale: pixels a metre.
    """

    centre: Array
    heading: float
    scale: float
    width: int
    height: int

    def pixels(self, points: ArrayLike) -> Array:
        """Pixel coordinates (..., 2) of world points (..., >=2); pixel centres at +0.5."""
        offset = np.asarray(points, np.float64)[..., :2] - self.centre
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        x, y = offset[..., 0], offset[..., 1]
        result = np.empty_like(offset)  # numpy is slow to stack, and films have many lines
        result[..., 0] = self.width / 2 + self.scale * (cos * x + sin * y)
        result[..., 1] = self.height / 2 - self.scale * (-sin * x + cos * y)
        return result

    def world(self, pixels: ArrayLike) -> Array:
        """World points (..., 2) of pixel coordinates (..., 2)."""
        offset = np.asarray(pixels, np.float64) - (self.width / 2, self.height / 2)
        right, up = offset[..., 0] / self.scale, -offset[..., 1] / self.scale
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        return self.centre + np.stack([cos * right - sin * up, sin * right + cos * up], axis=-1)

    @property
    def footprint(self) -> Array:
        """(4, 2) world corners of the picture."""
        return self.world([[0, 0], [self.width, 0], [self.width, self.height], [0, self.height]])


class Canvas:
    """An RGB picture to draw on in world coordinates.

    Attributes:
        image: (height, width, 3) uint8, drawn in place.
    """

    def __init__(self, view: CanvasView, ground: Colour = GROUND) -> None:
        self.view = view
        # Filled row by row: numpy is slow to repeat three values, and films have many pictures.
        rows = np.empty((view.height, 3 * view.width), np.uint8)
        rows[:] = np.tile(np.array(ground, np.uint8), view.width)
        self.image: Image = rows.reshape(view.height, view.width, 3)

    def polygon(self, points: ArrayLike, fill: Colour) -> None:
        """Fill the outline (N, 2)."""
        self.polygons([np.asarray(points)], fill)

    def polygons(self, outlines: Sequence[Array], fill: Colour) -> None:
        """Fill outlines (N_i, 2), each by itself."""
        for piece in self._pieces(outlines):
            cv2.fillPoly(self.image, [piece], fill, cv2.LINE_AA, _SHIFT)

    def line(
        self, points: ArrayLike, colour: Colour, width: int = 1, *, closed: bool = False
    ) -> None:
        """Draw the chain (N, 2), `width` pixels wide."""
        cv2.polylines(self.image, [self._fixed(points)], closed, colour, width, cv2.LINE_AA, _SHIFT)

    def lines(self, chains: Sequence[Array], colour: Colour, width: int = 1) -> None:
        """Draw chains (N_i, 2), each `width` pixels wide."""
        if chains:
            cv2.polylines(
                self.image, self._pieces(chains), False, colour, width, cv2.LINE_AA, _SHIFT
            )

    def dots(self, points: ArrayLike, colour: Colour, radius: float = 2.0) -> None:
        """Draw discs of `radius` pixels at points (N, 2)."""
        size = round(radius * (1 << _SHIFT))
        for x, y in self._fixed(points):
            cv2.circle(self.image, (int(x), int(y)), size, colour, -1, cv2.LINE_AA, _SHIFT)

    def text(
        self,
        pixel: tuple[float, float],
        content: str,
        colour: Colour = TEXT,
        size: int = 14,
        anchor: str = "la",
    ) -> int:
        """Write at a pixel, `anchor` as in Pillow ("la": left, ascender); return the width."""
        return draw_text(self.image, pixel, content, colour, size, anchor)

    def _pieces(self, chains: Sequence[Array]) -> list[NDArray[np.int32]]:
        """Chains (N_i, 2) in pixels, all reckoned at once."""
        if not chains:
            return []
        fixed = self._fixed(np.concatenate(chains))
        ends = list(accumulate(len(chain) for chain in chains))
        return [fixed[start:end] for start, end in zip([0, *ends], ends, strict=False)]

    def _fixed(self, points: ArrayLike) -> NDArray[np.int32]:
        # cv2 counts from pixel centres, the view from pixel corners.
        pixels = np.clip(self.view.pixels(points) - 0.5, -_FAR, _FAR)
        return np.rint(pixels * (1 << _SHIFT)).astype(np.int32)


def at_width(image: Image, width: int) -> Image:
    """An image (H, W, 3), resized to a width in pixels."""
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def dashed(points: ArrayLike, dash: float) -> list[Array]:
    """Every other piece of `dash` metres of the chain (N, >=2), bends kept."""
    points = np.asarray(points, np.float64)[:, :2]
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    pieces = []
    for start in np.arange(0.0, along[-1], 2 * dash):
        end = min(start + dash, along[-1])
        inner = points[(along > start) & (along < end)]
        ends = [
            np.array([np.interp(s, along, points[:, 0]), np.interp(s, along, points[:, 1])])
            for s in (start, end)
        ]
        pieces.append(np.vstack([ends[0][None], inner, ends[1][None]]))
    return pieces
