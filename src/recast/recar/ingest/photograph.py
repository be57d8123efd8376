"""The photographs of one vehicle, brought to size and cut out: files of the set, in memory."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.images import decode_image, decode_mask, opened, rgb, rgba
from recast.recar.ingest.duplicates import Hashes, first_twice, perceptual_hash
from recast.recar.ingest.outlines import outline_doubts
from recast.recar.ingest.settings import IngestSettings, VehicleRow
from recast.recar.views import LARGEST_SIDE, encode_picture

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
MOST_PIXELS = LARGEST_SIDE**2
"""Most pixels of a photograph: each takes some 30 bytes while it is brought to size, 2 GB."""

_MEND = "replace the photograph"
_HOW: dict[str, Any] = {"most_pixels": MOST_PIXELS, "what": "photograph", "mend": _MEND}


def natural_order(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Sorts 2.jpg before 10.jpg."""
    parts = re.findall(r"\d+|\D+", path.name.lower())
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts], path.name


def photograph_size(path: Path) -> tuple[int, int]:
    """Width and height, upright, from the header.

    Raises:
        InputError: see `opened`; or more than `MOST_PIXELS`.
    """
    with opened(path, path, **_HOW) as picture:
        return picture.size


def read_photograph(path: Path) -> tuple[Image, NDArray[np.uint8] | None]:
    """Colour (H, W, 3) and alpha (H, W), upright; None where nothing is transparent.

    Raises:
        InputError: as `photograph_size`, or cut short, or transparent everywhere.
    """
    levels = decode_image(path, path, **_HOW)
    alpha = rgba(levels)[..., 3]
    if (alpha == 255).all():
        return rgb(levels), None
    if not alpha.any():
        raise InputError(path, "alpha", "is zero everywhere", _MEND)
    return rgb(levels), np.ascontiguousarray(alpha)


def read_mask(path: Path, size: tuple[int, ...]) -> NDArray[np.uint8]:
    """A mask (H, W) of a photograph of `size` (W, H): 255 on the vehicle, soft at its edge.

    Raises:
        InputError: see `decode_mask`.
    """
    how = _HOW | {"what": "mask", "mend": "replace the mask"}
    return decode_mask(path, path, (size[0], size[1]), "the photograph", **how)


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


class PhotographCutout(Protocol):
    """What a remover found; `recast.actors.Segmentation` is one."""

    @property
    def alpha(self) -> NDArray[np.uint8]:
        """(H, W), 255 on the vehicle."""

    @property
    def doubts(self) -> tuple[str, ...]:
        """What a person should look at."""


class PhotographMasker(Protocol):
    """Finds the one vehicle in a photograph; see `recast.actors.cutout` for two that do."""

    def remove(self, image: NDArray[np.uint8], category: str) -> PhotographCutout:
        """The mask of the vehicle in a picture (H, W, 3) uint8 RGB.

        Raises:
            InputError: no vehicle was found.
        """


@dataclass(frozen=True)
class PhotographCandidate:
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
    candidate: PhotographCandidate, settings: IngestSettings, remover: PhotographMasker | None
) -> Prepared:
    """Remove backgrounds, bring to size, encode, and compare the views with each other.

    Raises:
        InputError: a photograph or a mask is broken, a photograph without alpha where there is
            neither a mask nor a remover, or transparent everywhere; or two are the same.
    """
    pictures: list[bytes] = []
    hashes: list[Hashes] = []
    alphas: list[NDArray[np.uint8]] = []
    doubts = list(candidate.doubts)
    masks = candidate.masks or (None,) * len(candidate.photographs)
    for path, mask in zip(candidate.photographs, masks, strict=True):
        rgb, alpha = read_photograph(path)
        if mask is not None:
            alpha = read_mask(mask, rgb.shape[1::-1])
        elif alpha is None:
            if remover is None:
                raise InputError(
                    path, "alpha", "is absent", "cut out the background, or choose a `remover`"
                )
            cutout = remover.remove(rgb, candidate.row.category)
            alpha = cutout.alpha
            doubts += [f"{path.name}: {doubt}" for doubt in cutout.doubts]
        picture = fit(rgb, alpha, settings.width, settings.height)
        if not picture[..., 3].any():
            raise InputError(
                path, "alpha", "is zero everywhere: no vehicle was found", "cut it out by hand"
            )
        alphas.append(picture[..., 3].copy())
        pictures.append(encode_picture(picture))
        hashes.append(perceptual_hash(picture))
    stacked = np.stack(hashes)
    if twice := first_twice(stacked, settings.duplicate_bits):
        first, second = (candidate.photographs[index] for index in twice)
        raise InputError(
            second,
            "duplicate",
            f"is the same image as {first.name}",
            "replace one of them; if both are right, lower `duplicate_bits`",
        )
    doubts += outline_doubts(alphas, [path.name for path in candidate.photographs])
    return Prepared(tuple(pictures), stacked, tuple(doubts))
