"""Finding the same photograph twice, also where it was scaled or compressed anew."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.recar.picture import Image

Hashes = NDArray[np.uint64]

BITS = 255
WORDS = 4
DUPLICATE_BITS = 20
"""Hashes that differ in no more bits are of one picture. Measured on renders of synthetic vehicles:
views of one vehicle 12 degrees apart differ in 68 bits at least, 3 degrees apart in 22; views of
different vehicles in 48. The same view scaled by half and compressed to JPEG of quality 60 differs
in 4 bits by the median, but in up to 54 where a vehicle is one flat dark surface: such copies are
missed rather than good vehicles lost."""

_SIDE = 64  # pixels to which the vehicle is brought
_FREQUENCIES = 16  # of each axis
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R BT.601
_ONES = np.array([bin(value).count("1") for value in range(2**16)], np.uint8)


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
    waves = cv2.dct(small)[:_FREQUENCIES, :_FREQUENCIES].ravel()[1:]
    bits = np.append(waves > np.median(waves), False)
    return np.packbits(bits).view(np.uint64).copy()


def distances(one: Hashes, others: Hashes) -> NDArray[np.int64]:
    """In how many bits a hash (4,) differs from others (N, 4): (N,)."""
    return ones(one ^ others).sum(axis=1, dtype=np.int64)


def ones(words: Hashes) -> NDArray[np.uint8]:
    """How many bits of each uint64 are set."""
    if hasattr(np, "bitwise_count"):  # from numpy 2 on
        return np.asarray(np.bitwise_count(words), np.uint8)
    return ones_by_table(words)


def ones_by_table(words: Hashes) -> NDArray[np.uint8]:
    """`ones` with any numpy, some thirty times slower."""
    quarters = np.ascontiguousarray(words).view(np.uint16).reshape(*words.shape, 4)
    return np.asarray(_ONES[quarters].sum(axis=-1), np.uint8)


def first_twice(hashes: Hashes, bits: int) -> tuple[int, int] | None:
    """The first two of the pictures (N, 4) of one identity that are the same."""
    for index in range(1, len(hashes)):
        near = np.flatnonzero(distances(hashes[index], hashes[:index]) <= bits)
        if len(near):
            return int(near[0]), index
    return None
