"""Pictures: the one decoder of encoded images from outside, of masks, and text drawn into images.

Pillow's readers decode. Each is called by the format that the first bytes say: `PIL.Image.open`
may hand a file to another program. OpenCV does not read foreign files: its PNG reader allocates the
length that a chunk claims, and goes on if a file is damaged. The size is checked before memory for
pixels is taken.
"""

from __future__ import annotations

import io
import struct
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PilImage
from PIL import ImageDraw, ImageFont
from PIL.BmpImagePlugin import BmpImageFile
from PIL.GifImagePlugin import GifImageFile
from PIL.Image import Image as PillowImage
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TgaImagePlugin import TgaImageFile
from PIL.TiffImagePlugin import TiffImageFile
from PIL.WebPImagePlugin import WebPImageFile

from recast.arrays import Image
from recast.core.errors import InputError, printable
from recast.core.files import disk_errors

Levels = NDArray[np.unsignedinteger[Any]]
"""8 or 16 bits: grey (H, W), colours (H, W, 3), or colours and straight alpha (H, W, 4)."""

FORMATS = ("BMP", "JPEG", "PNG", "TIFF", "WEBP")
"""Formats of photographs and masks."""
MOST_PIXELS = 1 << 27
"""Pixels of an image, at most, if its reader sets no smaller number: 0.4 GB of 8-bit RGB."""
MOST_BYTES = 1 << 29
"""Bytes of an encoded image, at most."""
FULL = 65535
"""White in 16 bits."""

_READERS: dict[str, type[ImageFile]] = {
    "BMP": BmpImageFile,
    "GIF": GifImageFile,
    "JPEG": JpegImageFile,
    "PNG": PngImageFile,
    "TGA": TgaImageFile,
    "TIFF": TiffImageFile,
    "WEBP": WebPImageFile,
}
_BEGINNINGS = {
    b"\x89PNG\r\n\x1a\n": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"II+\0": "TIFF",  # BigTIFF
    b"BM": "BMP",
    b"GIF8": "GIF",
    b"v/1\x01": "OpenEXR",
    b"#?RADIANCE": "Radiance HDR",
    b"\0\0\0\x0cjP": "JPEG 2000",
    b"%!PS": "PostScript",
    b"version https://git-lfs": "a Git LFS pointer",
}
_HEAD = 32  # bytes: enough for the first bytes above and the size that WebP says
_ORIENTATION = 0x0112  # EXIF tag; from 5 on the stored image lies on its side
_BITS, _PHOTOMETRIC, _TILE_WIDTH, _TILE_HEIGHT = 258, 262, 322, 323  # TIFF tags
_LATE = (b"eXIf", b"iTXt", b"tEXt", b"zTXt")  # chunks of a PNG that may hold the orientation
_FEW_LEVELS = 16
"""A dark image of no more grey levels is a map of labels; a soft mask of nothing has more."""


@dataclass(frozen=True)
class OpenImage:
    """An encoded image whose header was read and found to be sane, its pixels not yet.

    Attributes:
        format: name of the format, as in `FORMATS`.
        late: whether its orientation may stand behind its pixels.
    """

    format: str
    late: bool
    _image: ImageFile
    _stream: BinaryIO

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels, upright."""
        width, height = self._image.size
        if self.late:
            self._image.load()
        return (height, width) if self._orientation() >= 5 else (width, height)

    @property
    def plain(self) -> bool:
        """Whether every program shows the same: 8 bits of grey or RGB, stored upright."""
        depth = _png_depth(self._stream) if self.format == "PNG" else 8
        return (
            self._image.mode in ("L", "P", "RGB", "RGBA", "LA") and depth <= 8 and not self.turned
        )

    @property
    def turned(self) -> bool:
        """Whether it is stored otherwise than upright."""
        return self._orientation() != 1

    def levels(self) -> Levels:
        """Decode the first image, upright, alpha only if the file has it.

        16 bits stay 16 bits, other depths become 8 or 16; white is 255 or 65535.
        """
        image = self._image
        if image.mode.startswith("I;") or _raw_mode(image).partition(";")[2][:2] == "16":
            levels = self._deep()
        else:
            image.load()
            levels = self._shallow()
        return np.ascontiguousarray(_upright(levels, self._orientation()))

    def _shallow(self) -> Levels:
        image: PillowImage = self._image
        key = image.info.get("transparency")
        depth = _png_depth(self._stream) if self.format == "PNG" else 8
        if depth < 8 and isinstance(key, int) and image.mode in ("1", "L"):
            # Pillow spreads the grey levels over 0 to 255, and not the one that is transparent.
            image, key = image.convert("L"), min(key, 2**depth - 1) * 255 // (2**depth - 1)
            image.info["transparency"] = key
        if "a" in image.mode:  # premultiplied; or La, which converts to LA alone
            image = image.convert({"La": "LA"}.get(image.mode, "RGBA"))
        if ("A" in image.mode and image.mode != "LAB") or key is not None:
            image = image if image.mode == "RGBA" else image.convert("RGBA")
        elif image.mode not in ("L", "RGB"):
            image = image.convert("L" if image.mode == "1" else "RGB")
        return np.array(image, np.uint8)

    def _deep(self) -> Levels:
        """(H, W), (H, W, 3) or (H, W, 4) uint16; Pillow itself keeps 16 bits of grey alone."""
        image = self._image
        raw, key = _raw_mode(image), image.info.get("transparency")
        low = None
        if raw.startswith("LA;16"):  # four bytes a pixel, whatever they are called
            image._mode, image.tile = "RGBA", [_with_raw_mode(tile, "RGBA") for tile in image.tile]
        elif raw.startswith(("RGB;16", "RGBA;16")):
            # The other byte of each value is what a reader of the other byte order takes for its
            # high one.
            self._stream.seek(0)
            low = type(image)(self._stream)
            big = raw.endswith("B") or (raw.endswith("N") and sys.byteorder == "big")
            other = raw[:-1] + ("L" if big else "B")
            low.tile = [_with_raw_mode(tile, other) for tile in low.tile]
            low.load()
            self._stream.seek(0)
            tiles = image.tile
            image = type(image)(self._stream)
            image.tile = tiles
        image.load()
        values = np.array(image)
        levels: NDArray[np.uint16]
        if raw.startswith("LA;16"):
            grey, alpha = (
                values[..., i].astype(np.uint16) << 8 | values[..., i + 1] for i in (0, 2)
            )
            levels = np.dstack([grey, grey, grey, alpha])
        elif low is not None:
            levels = values.astype(np.uint16) << 8 | np.array(low)
        elif values.ndim == 2:
            levels = values.astype(np.uint16)
            tags = getattr(image, "tag_v2", {})
            bits = tags.get(_BITS, (16,))[0]
            if bits < 16:
                levels = (levels.astype(np.uint32) * FULL // (2**bits - 1)).astype(np.uint16)
            if tags.get(_PHOTOMETRIC, 1) == 0:
                levels = FULL - levels
        else:  # CMYK or premultiplied alpha, of which the low bytes are left out
            return self._shallow()
        if key is not None and levels.shape[2:] != (4,):
            clear = np.atleast_3d(levels == np.array(key)).all(axis=-1)
            alpha = np.where(clear, np.uint16(0), np.uint16(FULL))
            levels = np.dstack([_three(levels), alpha])
        return levels

    def _orientation(self) -> int:
        """The EXIF orientation, 1 to 8; 1 of TIFF, which Pillow turns itself."""
        if self.format == "TIFF":
            return 1
        with suppress(Exception):  # broken EXIF data say nothing; Pillow raises of many kinds
            # Not `image.getexif`, which decodes every PNG to look for what may follow its pixels.
            orientation = PillowImage.getexif(self._image).get(_ORIENTATION, 1)
            return orientation if orientation in range(1, 9) else 1
        return 1


@contextmanager
def opened(
    source: bytes | Path,
    where: str | Path,
    formats: Sequence[str] = FORMATS,
    most_pixels: int = MOST_PIXELS,
    what: str = "image",
    mend: str = "save it again as PNG or JPEG",
) -> Iterator[OpenImage]:
    """Open an encoded image for its size or pixels; of animations and pages the first image.

    Args:
        source: the bytes, or the file.
        where: file that holds it, for messages.
        formats: formats that are read.
        most_pixels: pixels that it may have, as its header says.
        what: name of the image in messages.
        mend: hint in messages.

    Raises:
        InputError: it is of another format, has too many pixels or bytes, pixels that are not of 1
            to 16 bits, or is cut short or damaged, which may show only when it is decoded.
    """
    try:
        with disk_errors(where), _stream_of(source) as stream:
            head = stream.read(_HEAD)
            kind = _format_of(head, formats)
            if kind is None or kind not in formats:
                begins = f"; it begins like {kind}" if kind else ""
                raise ValueError(f"it is not one of {', '.join(formats)}{begins}")
            size = stream.seek(0, io.SEEK_END)
            if size > MOST_BYTES:
                raise InputError(where, "size", f"has {size} bytes, {MOST_BYTES} are read", mend)
            if kind == "WEBP":
                _check_size(where, _webp_size(head), most_pixels)
            late = kind == "PNG" and _late_chunks(stream, size)
            stream.seek(0)
            # Pillow warns of what is damaged or large, and both are refused here.
            quiet = nullcontext() if kind == "PNG" else warnings.catch_warnings()
            with quiet:
                if kind != "PNG":
                    warnings.simplefilter("ignore")
                with _READERS[kind](stream) as image:
                    _check_size(where, image.size, most_pixels)
                    if image.mode in ("F", "I"):
                        numbers = "floats" if image.mode == "F" else "signed or 32-bit integers"
                        raise ValueError(f"its pixels are {numbers}, not of 8 or 16 bits")
                    if isinstance(image, TiffImageFile):
                        tile = [image.tag_v2.get(tag, 0) for tag in (_TILE_WIDTH, _TILE_HEIGHT)]
                        _check_size(where, (int(tile[0]), int(tile[1])), most_pixels)
                    yield OpenImage(kind, late, image, stream)
    except InputError:
        raise
    except Exception as error:  # Pillow raises of many kinds for damaged files
        reason = str(error).partition("\n")[0] or "broken"
        raise InputError(where, what, f"cannot be decoded ({reason})", mend) from None


def decode_image(source: bytes | Path, where: str | Path, *how: Any, **named: Any) -> Levels:
    """All levels of an encoded image; arguments and errors of `opened`."""
    with opened(source, where, *how, **named) as image:
        return image.levels()


def eight_bits(levels: Levels) -> Image:
    """The same image with 8 bits: white stays white, 257 levels of 16 bits become one."""
    if levels.dtype == np.uint8:
        return levels.astype(np.uint8, copy=False)
    return ((levels.astype(np.uint32) + 128) // 257).astype(np.uint8)


def rgb(levels: Levels) -> Image:
    """Colours (H, W, 3) uint8; alpha is left out."""
    return np.ascontiguousarray(eight_bits(_three(levels)))


def rgba(levels: Levels) -> Image:
    """Colours and straight alpha (H, W, 4) uint8; opaque if there is no alpha."""
    if levels.shape[2:] == (4,):
        return eight_bits(levels)
    colours = rgb(levels)
    return np.dstack([colours, np.full(colours.shape[:2], 255, np.uint8)])


def grey(levels: Levels) -> Levels:
    """Brightness (H, W) by ITU-R 601, of the same depth; alpha is left out."""
    if levels.ndim == 2:
        return levels
    weights = np.array([19595, 38470, 7471], np.uint64)  # of 65536, as Pillow weighs
    bright = (levels[..., :3].astype(np.uint64) @ weights + 32768) >> np.uint64(16)
    return bright.astype(levels.dtype)


def decode_mask(
    source: bytes | Path,
    where: str | Path,
    size: tuple[int, int],
    says: str = "the image",
    **how: Any,
) -> Image:
    """A mask (H, W) uint8, 255 inside and 0 outside, soft if the file is.

    White, or 1 in a file of 0 and 1, is inside; so is the brighter one of any two levels of which
    the other is 0. Of a mask with alpha the visible black and white counts, or else alpha itself.

    Args:
        size: width and height that it must have.
        says: name of the image that has this size, for messages.
        how: further arguments of `opened`.

    Raises:
        InputError: as of `opened`, or of another size, or with labels in place of black and white.
    """
    with opened(source, where, **{"what": "mask", **how}) as image:
        if image.size != size:
            wrong, right = (f"{width}x{height}" for width, height in (image.size, size))
            raise InputError(where, "size", f"is {wrong}, {says} {right}", f"crop it like {says}")
        levels = image.levels()
    values = grey(levels)
    if levels.shape[2:] == (4,):
        values = _seen_mask(values, np.asarray(levels[..., 3]))
    most = int(values.max(initial=0))
    if values.dtype == np.uint16 and most > 255:
        values, most = eight_bits(values), 255 * (most > FULL // 2)
    if most > 127:
        return values.astype(np.uint8)
    counts = np.bincount(values.reshape(-1).astype(np.uint8), minlength=256)
    present = np.flatnonzero(counts)
    if len(present) > _FEW_LEVELS:
        return values.astype(np.uint8)
    if np.count_nonzero(present) > 1:
        shown = ", ".join(map(str, present[:4])) + (", ..." if len(present) > 4 else "")
        raise InputError(
            where, "mask", f"holds labels ({shown})", "write 255 or 1 inside and 0 outside"
        )
    return np.where(values > 0, np.uint8(255), np.uint8(0))


def _seen_mask(values: Levels, alpha: Levels) -> Levels:
    """The mask of an image with alpha; `values` is its brightness."""
    if alpha.min() == alpha.max():
        return values
    visible = np.unique(values[alpha > alpha.max() // 2])
    # Black and white painted on nothing; a cut-out object has more levels, a silhouette one.
    return np.where(alpha > 0, values, 0) if len(visible) == 2 and visible[0] == 0 else alpha


def _three(levels: Levels) -> Levels:
    return np.repeat(levels[..., None], 3, axis=-1) if levels.ndim == 2 else levels[..., :3]


def _stream_of(source: bytes | Path) -> BinaryIO:
    return io.BytesIO(source) if isinstance(source, bytes) else source.open("rb")


def _format_of(head: bytes, formats: Sequence[str]) -> str | None:
    """The format by the first bytes; TGA, which has none of its own, if it is asked for."""
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return "WEBP"
    if head[4:8] == b"ftyp":
        return "HEIC or AVIF"
    known = (kind for begins, kind in _BEGINNINGS.items() if head.startswith(begins))
    return next(known, "TGA" if "TGA" in formats else None)


def _webp_size(head: bytes) -> tuple[int, int]:
    """Width and height of a WebP: its reader takes memory for them before it can be asked."""
    if head[12:16] == b"VP8X":
        width, height = (int.from_bytes(head[at : at + 3], "little") + 1 for at in (24, 27))
    elif head[12:16] == b"VP8L":
        bits = int.from_bytes(head[21:25], "little")
        width, height = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    else:
        width, height = (int.from_bytes(head[at : at + 2], "little") & 0x3FFF for at in (26, 28))
    return width, height


def _check_size(where: str | Path, size: tuple[int, int], most_pixels: int) -> None:
    width, height = size
    if width * height > most_pixels:
        problem = f"is {width}x{height}, more than {most_pixels / 1e6:.0f} megapixels"
        raise InputError(where, "size", problem, "scale it down")


def _late_chunks(stream: BinaryIO, end: int) -> bool:
    """Whether a PNG says something behind its pixels, as exiftool writes the orientation there.

    Raises:
        ValueError: a chunk does not end before `end`, the size of the file.
    """
    pixels = late = False
    at = stream.seek(8)
    while len(head := stream.read(8)) == 8 and not head.endswith(b"IEND"):
        length, kind = struct.unpack(">I4s", head)
        at += length + 12  # with its head and its checksum
        if at > end:
            raise ValueError(f"it is cut short: a chunk claims {length} bytes")
        late |= pixels and kind in _LATE
        pixels |= kind == b"IDAT"
        stream.seek(at)
    return late


def _png_depth(stream: BinaryIO) -> int:
    """Bits a value of a PNG."""
    place = stream.tell()
    stream.seek(24)
    depth = stream.read(1)[0]
    stream.seek(place)
    return depth


def _raw_mode(image: ImageFile) -> str:
    """How Pillow calls the layout of the stored pixels, such as "RGB;16B"; "" if it does not."""
    arguments = image.tile[0][3] if image.tile else ""
    if isinstance(arguments, tuple):
        arguments = arguments[0] if arguments else ""
    return arguments if isinstance(arguments, str) else ""


def _with_raw_mode(tile: Any, raw: str) -> Any:
    arguments = tile[3]
    changed = raw if isinstance(arguments, str) else (raw, *arguments[1:])
    return type(tile)(*tile[:3], changed)


def _upright(levels: Levels, orientation: int) -> Levels:
    """Turned as EXIF says: from 5 on rows and columns change places first."""
    if orientation >= 5:
        levels = levels.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        levels = levels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        levels = levels[::-1]
    return levels


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
