"""The photographs of one vehicle, brought to size and cut out: files of the set, in memory."""

from __future__ import annotations

import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageOps

from recast.core.errors import InputError
from recast.core.files import disk_errors
from recast.recar.ingest.duplicates import Hashes, first_twice, perceptual_hash
from recast.recar.ingest.settings import IngestSettings, VehicleRow
from recast.recar.set_records import LARGEST_SIDE
from recast.recar.views import Image, encode_picture

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
MOST_PIXELS = LARGEST_SIDE**2
"""Most pixels of a photograph: each takes some 30 bytes while it is brought to size, 2 GB."""

_FORMATS = ("BMP", "JPEG", "PNG", "TIFF", "WEBP")  # others may run programs of their own
_MODES = ("1", "CMYK", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "YCbCr")
_ORIENTATION = 0x0112  # EXIF tag; from 5 on the picture lies on its side
_TOLD_LATE = (b"eXIf", b"iTXt", b"tEXt", b"zTXt")  # chunks of a PNG that may hold it
_MEND = "replace the photograph"


def natural_order(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Sorts 2.jpg before 10.jpg."""
    parts = re.findall(r"\d+|\D+", path.name.lower())
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts], path.name


def photograph_size(path: Path) -> tuple[int, int]:
    """Width and height, upright, from the header.

    Raises:
        InputError: it is no picture, not one of 8 bits, or has more than `MOST_PIXELS`.
    """
    with _opened(path) as picture:
        width, height = picture.size
        if picture.format == "PNG" and _told_late(path):
            picture.load()
        # Not `picture.getexif`, which decodes every PNG to look for what may follow its pixels.
        exif = Pillow.Image.getexif(picture)
        return (height, width) if exif.get(_ORIENTATION, 1) in range(5, 9) else (width, height)


def read_photograph(path: Path) -> tuple[Image, NDArray[np.uint8] | None]:
    """Colour (H, W, 3) and alpha (H, W), upright; None where nothing is transparent.

    Raises:
        InputError: as `photograph_size`, or cut short, or transparent everywhere.
    """
    with _opened(path) as picture:
        transparent = "A" in picture.mode or "transparency" in picture.info
        upright = ImageOps.exif_transpose(picture).convert("RGBA" if transparent else "RGB")
        pixels = np.asarray(upright)
    if not transparent or (pixels[..., 3] == 255).all():
        return np.ascontiguousarray(pixels[..., :3]), None
    if not pixels[..., 3].any():
        raise InputError(path, "alpha", "is zero everywhere", _MEND)
    return np.ascontiguousarray(pixels[..., :3]), np.ascontiguousarray(pixels[..., 3])


def read_mask(path: Path, size: tuple[int, ...]) -> NDArray[np.uint8]:
    """A mask (H, W), grey, of a photograph of `size` (W, H): 255 on the vehicle.

    Raises:
        InputError: as `photograph_size`, or cut short, or of another size.
    """
    with _opened(path) as picture:
        pixels = np.asarray(ImageOps.exif_transpose(picture).convert("L"))
    if pixels.shape[::-1] != tuple(size):
        raise InputError(
            path,
            "size",
            f"is {pixels.shape[1]}x{pixels.shape[0]}, the photograph's {size[0]}x{size[1]}",
            "cut the mask like its photograph",
        )
    return np.ascontiguousarray(pixels)


def fit(rgb: Image, alpha: NDArray[np.uint8], width: int, height: int) -> Image:
    """Scaled to fit `width` x `height` and centred there, transparent beside it: (H, W, 4).

    Colours are weighed by alpha, so that no background bleeds into the vehicle's edge.
    """
    scale = min(width / rgb.shape[1], height / rgb.shape[0])
    size = (max(round(rgb.shape[1] * scale), 1), max(round(rgb.shape[0] * scale), 1))
    top, left = (height - size[1]) // 2, (width - size[0]) // 2
    fitted = np.zeros((height, width, 4), np.uint8)
    if size == rgb.shape[1::-1]:
        part = np.dstack([rgb, alpha])
    else:
        share = alpha[..., None].astype(np.float32)
        weighed = np.concatenate([rgb * (share / 255), share], axis=-1)
        way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        scaled = cv2.resize(weighed, size, interpolation=way)
        colour = scaled[..., :3] * (255 / np.maximum(scaled[..., 3:], 1e-3))
        part = np.concatenate([colour, scaled[..., 3:]], axis=-1)
        part = np.clip(np.round(part), 0, 255).astype(np.uint8)
    fitted[top : top + size[1], left : left + size[0]] = part
    return fitted


def _told_late(path: Path) -> bool:
    """Whether a PNG says something behind its pixels, as exiftool writes the orientation there."""
    pixels = False
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8:
            size, kind = struct.unpack(">I4s", head)
            if pixels and kind in _TOLD_LATE:
                return True
            pixels |= kind == b"IDAT"
            file.seek(size + 4, 1)  # with its checksum
    return False


@contextmanager
def _opened(path: Path) -> Iterator[Pillow.Image]:
    """The picture, its header read and found to be sane, its pixels not yet."""
    try:
        with disk_errors(path), warnings.catch_warnings():
            # Of its bound Pillow only warns; ours comes first.
            warnings.simplefilter("ignore", Pillow.DecompressionBombWarning)
            with Pillow.open(path, formats=_FORMATS) as picture:
                _check_header(path, picture)
                yield picture
    except InputError:
        raise
    except Pillow.UnidentifiedImageError:
        problem = f"is none of {', '.join(_FORMATS)}, or broken"
        raise InputError(path, "photograph", problem, _MEND) from None
    # Of damaged files its readers raise whatever their code runs into.
    except Exception as error:
        problem = f"cannot be read ({str(error).splitlines()[0] if str(error) else 'broken'})"
        raise InputError(path, "photograph", problem, _MEND) from None


def _check_header(path: Path, picture: Pillow.Image) -> None:
    if picture.mode not in _MODES:
        raise InputError(path, "pixels", f"are of the kind {picture.mode}", "save it with 8 bits")
    width, height = picture.size
    if width * height > MOST_PIXELS:
        raise InputError(
            path,
            "size",
            f"is {width}x{height}, more than {MOST_PIXELS / 1e6:.0f} megapixels",
            "scale it down",
        )


class Cutout(Protocol):
    """What a remover found; `recast.actors.Segmentation` is one."""

    @property
    def alpha(self) -> NDArray[np.uint8]:
        """(H, W), 255 on the vehicle."""

    @property
    def doubts(self) -> tuple[str, ...]:
        """What a person should look at."""


class BackgroundRemover(Protocol):
    """Finds the one vehicle in a photograph; see `recast.actors.cutout` for two that do."""

    def remove(self, image: NDArray[np.uint8], category: str) -> Cutout:
        """The mask of the vehicle in a picture (H, W, 3) uint8 RGB.

        Raises:
            InputError: no vehicle was found.
        """


@dataclass(frozen=True)
class Candidate:
    """A vehicle to bring in.

    Attributes:
        row: row of the table.
        photographs: files of the photographs, by rising azimuth.
        masks: mask of each photograph, None where there is none; empty where there are none at all.
        doubts: what a person should look at.
    """

    row: VehicleRow
    photographs: tuple[Path, ...]
    masks: tuple[Path | None, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Prepared:
    """PNG and hash of each view of a vehicle, and what a person should look at."""

    pictures: tuple[bytes, ...]
    hashes: Hashes
    doubts: tuple[str, ...]


def prepare(
    candidate: Candidate, settings: IngestSettings, remover: BackgroundRemover | None
) -> Prepared:
    """Remove backgrounds, bring to size, encode, and compare the views with each other.

    Raises:
        InputError: a photograph or a mask is broken, a photograph without alpha where there is
            neither a mask nor a remover, or transparent everywhere; or two are the same.
    """
    pictures: list[bytes] = []
    hashes: list[Hashes] = []
    doubts = list(candidate.doubts)
    masks = candidate.masks or (None,) * len(candidate.photographs)
    for path, mask in zip(candidate.photographs, masks, strict=True):
        rgb, alpha = read_photograph(path)
        if mask is not None:
            alpha = read_mask(mask, rgb.shape[1::-1])
        elif alpha is None:
            if remover is None:
                raise InputError(
                    path, "alpha", "is absent", "cut out the background, or name a `remover`"
                )
            cutout = remover.remove(rgb, candidate.row.category)
            alpha = cutout.alpha
            doubts += [f"{path.name}: {doubt}" for doubt in cutout.doubts]
        picture = fit(rgb, alpha, settings.width, settings.height)
        if not picture[..., 3].any():
            raise InputError(
                path, "alpha", "is zero everywhere: no vehicle was found", "cut it out by hand"
            )
        pictures.append(encode_picture(picture))
        hashes.append(perceptual_hash(picture))
    stacked = np.stack(hashes)
    if twice := first_twice(stacked, settings.duplicate_bits):
        first, second = (candidate.photographs[index] for index in twice)
        raise InputError(
            second,
            "duplicate",
            f"is the same picture as {first.name}",
            "replace it; if both are right, lower `duplicate_bits`",
        )
    return Prepared(tuple(pictures), stacked, tuple(doubts))
