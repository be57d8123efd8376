"""The photographs of one vehicle: brought to size, cut out, hashed, and their masks in doubt."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Image, Mask
from recast.core.errors import InputError
from recast.core.images import decode_image, decode_mask, opened, rgb, rgba
from recast.recar.ingest_table import DUPLICATE_BITS, IngestSettings, VehicleRow
from recast.recar.views import MOST_PIXELS, encode_picture

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")

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
        photographs: files of the photographs, by rising azimuth.
        masks: mask of each photograph, None where there is none; empty where there are none at all.
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
            how = _HOW | {"what": "mask", "mend": "replace the mask"}
            size = rgb.shape[1], rgb.shape[0]
            alpha = decode_mask(mask, mask, size, "the photograph", **how)  # soft at its edge
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
        mend = "replace one of them; if both are right, lower `duplicate_bits`"
        raise InputError(second, "duplicate", f"is the same image as {first.name}", mend)
    doubts += outline_doubts(alphas, [path.name for path in candidate.photographs])
    return Prepared(tuple(pictures), stacked, tuple(doubts))


Hashes = NDArray[np.uint64]
WORDS = 4

_SIDE = 64  # pixels to which the vehicle is brought
_FREQUENCIES = 16  # of each axis
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R BT.601


def perceptual_hash(rgba: Image) -> Hashes:
    """Hash (4,) uint64 of a picture (H, W, 4) whose alpha is not zero everywhere.

    The rectangle about the vehicle, over mid grey, is brought to 64 x 64 pixels. Of its discrete
    cosine transform the 16 x 16 lowest frequencies, without the mean, are compared with their
    median: 255 bits. So neither the place nor the size of the vehicle in its picture matters.

    Source: Zauner, Implementation and benchmarking of perceptual image hash functions, 2010
    (section 3.2.1), with more frequencies.
    """
    solid = rgba[..., 3] > 127 if (rgba[..., 3] > 127).any() else rgba[..., 3] > 0
    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    part = rgba[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].astype(np.float32)
    alpha = part[..., 3] / 255
    grey = (part[..., :3] @ _LUMA) * alpha + 128 * (1 - alpha)
    small = cv2.resize(grey, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    frequencies = cv2.dct(small)[:_FREQUENCIES, :_FREQUENCIES].ravel()[1:]
    bits = np.append(frequencies > np.median(frequencies), False)
    return np.packbits(bits).view(np.uint64).copy()


def distances(one: Hashes, others: Hashes) -> NDArray[np.int64]:
    """In how many bits a hash (4,) differs from others (N, 4): (N,)."""
    return np.bitwise_count(one ^ others).sum(axis=1, dtype=np.int64)


def first_twice(hashes: Hashes, bits: int) -> tuple[int, int] | None:
    """The first two of the pictures (N, 4) of one identity that are the same."""
    for index in range(1, len(hashes)):
        near = np.flatnonzero(distances(hashes[index], hashes[:index]) <= bits)
        if len(near):
            return int(near[0]), index
    return None


class SeenPictures:
    """The hashes of all pictures so far, to ask whether a new one is among them.

    Every pair is compared: 48 ms for 30 pictures against 387,000, where preparing them takes 1.8 s.
    """

    def __init__(self, bits: int = DUPLICATE_BITS) -> None:
        self.bits = bits
        self._hashes = np.zeros((0, WORDS), np.uint64)
        self._owner_of = np.zeros(0, np.int32)  # of each hash: its place in `_owners`
        self._owners: list[str] = []
        self._filled = 0

    def add(self, owner: str, hashes: Hashes) -> None:
        """Remember the hashes (N, 4) of an identity."""
        needed = self._filled + len(hashes)
        if needed > len(self._hashes):
            room = max(2 * len(self._hashes), needed) - len(self._hashes)
            self._hashes = np.pad(self._hashes, ((0, room), (0, 0)))
            self._owner_of = np.pad(self._owner_of, (0, room))
        self._hashes[self._filled : needed] = hashes
        self._owner_of[self._filled : needed] = len(self._owners)
        self._filled = needed
        self._owners.append(owner)

    def matches(self, hashes: Hashes) -> dict[str, int]:
        """How many of the pictures (N, 4) each identity has too, those with none left out."""
        found = Counter[int]()
        others = self._hashes[: self._filled]
        for one in hashes:
            # A quarter of the bits first: it can only be less.
            near = np.flatnonzero(np.bitwise_count(others[:, 0] ^ one[0]) <= self.bits)
            near = near[distances(one, others[near]) <= self.bits]
            found.update(np.unique(self._owner_of[near]).tolist())
        return {self._owners[owner]: count for owner, count in sorted(found.items())}


LEAST_OVERLAP = 0.85
"""Intersection over union of an outline and the mirrored one below which both are doubtful. On 40
synthetic vehicles of all kinds it is 0.99 at least, and 0.79 at most where a third of one mask is
missing."""
BELOW_MEDIAN = 0.1
"""A doubtful pair is also this far below the vehicle's median: azimuths that are a few degrees off
make all pairs less alike."""
LEAST_FILLED = 0.8
"""Share of its convex hull that a mask covers; 0.84 at least on the same synthetic vehicles."""
MOST_LISTED = 1 / 3
"""Share of a vehicle's views above which doubts are one line."""

_HEIGHT = 64  # pixels of an outline when it is compared
_FRONT_OFF_DEG = 15.0  # error of the front's azimuth that is allowed for


def outline_doubts(alphas: Sequence[Image], names: Sequence[str]) -> tuple[str, ...]:
    """What a person should look at: masks with holes or of parts, or unlike the mirrored view's.

    A vehicle is nearly symmetric, so the view at azimuth a shows the mirrored outline of the view
    at -a. The axis of symmetry is that about which most views agree, within `_FRONT_OFF_DEG` of the
    first view. Of a pair that differs, the view with the smaller mask is named.

    Args:
        alphas: (H, W) uint8 of the views at regular azimuths, none zero everywhere.
    """
    masks = [_cut(alpha) for alpha in alphas]
    areas = [int((alpha > 127).sum()) for alpha in alphas]
    lines = {}
    for first, second, overlap in _unlike(masks):
        view, other = sorted((first, second), key=lambda index: areas[index])
        lines[view] = (
            f"{names[view]}: the mask differs from the mirrored mask of {names[other]} "
            f"(overlap {overlap:.2f}): is a part missing?"
        )
    for view, mask in enumerate(masks):
        hull = cv2.convexHull(cv2.findNonZero(mask.astype(np.uint8)))
        filled = mask.sum() / max(cv2.contourArea(hull), 1.0)
        if filled < LEAST_FILLED:
            lines[view] = (
                f"{names[view]}: the mask has holes or loose parts, fills {filled:.0%} of its hull"
            )
    if len(lines) > max(MOST_LISTED * len(masks), 1):
        doubtful = ", ".join(names[view] for view in sorted(lines))
        return (
            f"{len(lines)} of {len(masks)} masks have holes or differ from those of the other "
            f"side; check the first photograph's azimuth and these masks: {doubtful}",
        )
    return tuple(lines[view] for view in sorted(lines))


def _unlike(masks: Sequence[Mask]) -> list[tuple[int, int, float]]:
    """Doubtful pairs of views, and their overlap."""
    views = len(masks)
    most = int(2 * _FRONT_OFF_DEG * views / 360)  # steps; the mirror turns by twice the error
    best: list[tuple[int, int, float]] = []
    for turn in sorted(range(-most, most + 1), key=abs):
        pairs = [(view, (turn - view) % views) for view in range(views)]
        alike = [(i, j, _overlap(masks[i], masks[j][:, ::-1])) for i, j in pairs if i < j]
        if alike and (not best or _median(alike) > _median(best)):
            best = alike
    limit = min(LEAST_OVERLAP, _median(best) - BELOW_MEDIAN) if len(best) > 2 else LEAST_OVERLAP
    return [pair for pair in best if pair[2] < limit]


def _median(pairs: Sequence[tuple[int, int, float]]) -> float:
    return float(np.median([overlap for _, _, overlap in pairs]))


def _cut(alpha: Image) -> Mask:
    """The mask in its bounding box, scaled to a height of `_HEIGHT` pixels."""
    mask = alpha > 127 if (alpha > 127).any() else alpha > 0
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    part = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].astype(np.uint8)
    width = max(round(part.shape[1] * _HEIGHT / part.shape[0]), 1)
    scaled = cv2.resize(part * 255, (width, _HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(scaled) >= 127


def _overlap(first: Mask, second: Mask) -> float:
    """Best intersection over union with the left ends, the middles or the right ends together."""
    width = max(first.shape[1], second.shape[1])
    shares = []
    for place in (0.0, 0.5, 1.0):
        wide = []
        for mask in (first, second):
            before = round((width - mask.shape[1]) * place)
            wide.append(np.pad(mask, ((0, 0), (before, width - mask.shape[1] - before))))
        shares.append((wide[0] & wide[1]).sum() / (wide[0] | wide[1]).sum())
    return float(max(shares))
