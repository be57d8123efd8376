"""Text drawn into images: captions of sheets, films and plots, in one font."""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage
from PIL import ImageDraw, ImageFont

from recast.arrays import Image
from recast.core.errors import printable

_BLACK = (0, 0, 0)


def draw_text(
    image: Image,
    pixel: tuple[float, float],
    content: str,
    colour: tuple[int, int, int] = _BLACK,
    size: int = 14,
    anchor: str = "la",
) -> int:
    """Write a line into an image (H, W, 3), in place; what lies outside of it is cut off.

    Args:
        pixel: x and y of the anchor.
        content: any text; names from outside may hold anything.
        colour: RGB, 0 to 255.
        size: height of the font in pixels.
        anchor: which point of the text is at `pixel`, as in Pillow: "la" is left and ascender,
            "ls" left and baseline, "mm" the middle.

    Returns:
        Width of the text in pixels.
    """
    left, top, advance, mask = _mask(_one_line(content), size, anchor)
    x0, y0 = int(pixel[0]) + left, int(pixel[1]) + top
    x1, y1 = x0 + mask.shape[1], y0 + mask.shape[0]
    inside = np.s_[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)]
    patch = image[inside]
    if patch.size:
        rows, columns = patch.shape[:2]
        row, column = max(-y0, 0), max(-x0, 0)
        share = mask[row : row + rows, column : column + columns, None]
        ink = np.array(colour, np.uint16)
        image[inside] = (patch * (255 - share) + ink * share + 127) // 255
    return advance


def wrapped(content: str, size: int, width: float) -> list[str]:
    """Text in lines of at most `width` pixels, unless a single word is longer."""
    font, lines = _font(size), [""]
    for word in _one_line(content).split(" "):
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and font.getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _one_line(content: str) -> str:
    return printable(" ".join(content.split()))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


@lru_cache(maxsize=1024)
def _mask(content: str, size: int, anchor: str) -> tuple[int, int, int, NDArray[np.uint16]]:
    """Text as a mask, 0 to 255: its left and top from the anchor, its width, and the mask.

    A film repeats the same words in each picture; drawing them anew would take half of its time.
    """
    font = _font(size)
    left, top, right, bottom = (int(v) for v in font.getbbox(content, anchor=anchor))
    patch = PilImage.new("L", (right - left + 3, bottom - top + 3))
    ImageDraw.Draw(patch).text((1 - left, 1 - top), content, 255, font, anchor=anchor)
    return left - 1, top - 1, right - left, np.asarray(patch, np.uint16)
