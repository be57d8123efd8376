"""The same photograph twice, also scaled or compressed anew: hashes, and a journal beside a set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Int64Array
from recast.core import files
from recast.core.errors import InputError
from recast.core.records import Record
from recast.recar.vehicle_set import Identity
from recast.recar.views import Image

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
Keys = NDArray[np.uint32]

_NARROWEST = 18
"""Bits of a piece at least: pieces of fewer bits are shared by too many pictures to save time."""
_WIDEST = 24
"""Bits of a piece at most: of all pieces of so many bits, it is noted which there are."""
_NEW = 4096
"""Most pictures that are compared one by one before they are sorted into the index."""
REPORT_FILE = "ingest.json"
_FOLDER = ".ingest"  # a reader of the set takes no folder whose name begins with a dot


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


@dataclass(frozen=True)
class Pieces:
    """How hashes are cut, so that alike hashes have a piece in which one bit differs at most.

    Two hashes that differ in `bits` differ in less than two bits on average over bits // 2 + 1
    pieces, hence in at most one in some piece (Norouzi, Punjani, Fleet: Fast exact search in
    Hamming space with multi-index hashing, 2014, section 3). A piece takes every n-th bit, so that
    each holds low and high frequencies: neighbours are much alike.

    Attributes:
        columns: (T, W) bits of each piece.
    """

    columns: Int64Array

    @classmethod
    def of(cls, bits: int) -> Self | None:
        """The cut for hashes that differ in `bits` or less; None where pieces are too narrow."""
        count = bits // 2 + 1
        width = min(_WIDEST, BITS // count)
        if width < _NARROWEST:
            return None
        return cls(np.arange(count)[:, None] + count * np.arange(width))

    def keys(self, hashes: Hashes) -> Keys:
        """(N, T): number of the piece above its bits, of hashes (N, 4)."""
        count, width = self.columns.shape
        flat = np.unpackbits(np.ascontiguousarray(hashes).view(np.uint8), axis=1)
        keys = flat[:, self.columns].astype(np.uint32) @ self._weights
        return keys | (np.arange(count, dtype=np.uint32) << np.uint32(width))

    def near(self, hashes: Hashes) -> Keys:
        """(N, T (W + 1)): the keys, and all that differ from one of them in one bit."""
        keys = self.keys(hashes)[..., None]
        near = np.concatenate([keys, keys ^ self._weights], axis=2)
        return np.asarray(near.reshape(len(hashes), -1))

    def room(self) -> NDArray[np.uint8]:
        """A zero bit for each key there can be: key k is bit k % 8 of byte k // 8."""
        count, width = self.columns.shape
        return np.zeros((count << width) // 8, np.uint8)

    @property
    def _weights(self) -> Keys:
        return np.uint32(1) << np.arange(self.columns.shape[1], dtype=np.uint32)


class SeenPictures:
    """The hashes of all pictures so far, to ask whether a new one is among them.

    Up to 27 bits, pictures are looked up by pieces of their hashes, in sorted runs whose lengths
    double; beyond, every pair is compared, as in `matches_by_scan`.
    """

    def __init__(self, bits: int = DUPLICATE_BITS) -> None:
        self.bits = bits
        self._pieces = Pieces.of(bits)
        self._hashes = np.zeros((0, WORDS), np.uint64)
        self._owner_of = np.zeros(0, np.int32)  # of each hash: its place in `_owners`
        self._owners: list[str] = []
        self._filled = 0
        self._indexed = 0
        self._runs: list[tuple[Keys, NDArray[np.int32]]] = []  # sorted keys, and whose they are
        self._present = np.zeros(0, np.uint8) if self._pieces is None else self._pieces.room()

    def add(self, owner: str, hashes: Hashes) -> None:
        """Remember the hashes (N, 4) of an identity."""
        needed = self._filled + len(hashes)
        if needed > len(self._hashes):
            room = max(2 * len(self._hashes), needed) - len(self._hashes)
            self._hashes = np.concatenate([self._hashes, np.zeros((room, WORDS), np.uint64)])
            self._owner_of = np.concatenate([self._owner_of, np.zeros(room, np.int32)])
        self._hashes[self._filled : needed] = hashes
        self._owner_of[self._filled : needed] = len(self._owners)
        self._filled = needed
        self._owners.append(owner)
        if self._pieces is not None and needed - self._indexed >= _NEW:
            self._index(self._pieces)

    def matches(self, hashes: Hashes) -> dict[str, int]:
        """How many of the pictures (N, 4) each identity has too, those with none left out."""
        if self._pieces is None or not self._runs:
            return self.matches_by_scan(hashes)
        asked, known = self._scanned(hashes, self._indexed)
        near = self._pieces.near(hashes)
        # Few of the keys near a picture are those of any other: the search is for these alone.
        rows, columns = np.nonzero((self._present[near >> 3] >> (near & 7).astype(np.uint8)) & 1)
        needles = near[rows, columns]
        for keys, pictures in self._runs:
            first = np.searchsorted(keys, needles)
            counts = np.searchsorted(keys, needles, side="right") - first
            hits = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
            known = np.append(known, pictures[hits])
            asked = np.append(asked, np.repeat(rows, counts))
        alike = ones(hashes[asked] ^ self._hashes[known]).sum(axis=1, dtype=np.int64) <= self.bits
        return self._counted(asked[alike], known[alike])

    def matches_by_scan(self, hashes: Hashes) -> dict[str, int]:
        """`matches` by comparing all pairs."""
        return self._counted(*self._scanned(hashes, 0))

    def _scanned(self, hashes: Hashes, start: int) -> tuple[Int64Array, Int64Array]:
        """Pairs of the pictures (N, 4) with those known from `start` on that are the same."""
        asked, found = [], []
        others = self._hashes[start : self._filled]
        for index, one in enumerate(hashes):
            near = np.flatnonzero(ones(others[:, 0] ^ one[0]) <= self.bits)  # a quarter of the bits
            near = near[distances(one, others[near]) <= self.bits]
            asked.append(np.full(len(near), index))
            found.append(near + start)
        none = np.zeros(0, np.int64)
        return np.concatenate([none, *asked]), np.concatenate([none, *found])

    def _counted(self, asked: Int64Array, known: Int64Array) -> dict[str, int]:
        pictures = int(asked.max(initial=0)) + 1
        pairs = np.unique(self._owner_of[known].astype(np.int64) * pictures + asked)
        owners, counts = np.unique(pairs // pictures, return_counts=True)
        return {
            self._owners[owner]: int(count) for owner, count in zip(owners, counts, strict=True)
        }

    def _index(self, pieces: Pieces) -> None:
        """Sort what is new into a run, together with all runs that are not longer."""
        keys = pieces.keys(self._hashes[self._indexed : self._filled]).ravel()
        np.bitwise_or.at(self._present, keys >> 3, np.uint8(1) << (keys & 7).astype(np.uint8))
        new = np.arange(self._indexed, self._filled, dtype=np.int32)
        pictures = np.repeat(new, len(pieces.columns))
        while self._runs and len(self._runs[-1][0]) <= len(keys):
            older_keys, older = self._runs.pop()
            keys, pictures = np.append(older_keys, keys), np.append(older, pictures)
        order = np.argsort(keys, kind="stable")  # merges runs that are sorted already
        self._runs.append((keys[order], pictures[order]))
        self._indexed = self._filled


class _Entry(Record):
    hashes: tuple[str, ...]
    doubts: tuple[str, ...]


def write_entry(out: Path, identity: str, hashes: Hashes, doubts: tuple[str, ...]) -> None:
    """Remember hashes (V, 4) and doubts of an identity."""
    value = {"hashes": [one.tobytes().hex() for one in hashes], "doubts": list(doubts)}
    files.write_json(out / _FOLDER / f"{identity}.json", value)


def read_entry(out: Path, identity: Identity) -> tuple[Hashes, tuple[str, ...]]:
    """Hashes (V, 4) and doubts of a finished identity, the hashes anew where they are lost."""
    path, views = out / _FOLDER / f"{identity.record.id}.json", identity.set_record.views
    try:
        entry = _Entry.model_validate(files.read_json(path))
        data = bytes.fromhex("".join(entry.hashes))
        return np.frombuffer(data, np.uint64).reshape(views, WORDS), entry.doubts
    except ValueError:  # as are those of pydantic, and an InputError
        return np.stack([perceptual_hash(identity.view(index)) for index in range(views)]), ()


def write_report(
    out: Path, skipped: Mapping[str, InputError], doubts: Mapping[str, tuple[str, ...]]
) -> None:
    """Write ingest.json: every vehicle that is not in the set and why, and every doubt."""
    value = {
        "skipped": [
            {
                "vehicle": name,
                "where": error.where,
                "field": error.field,
                "problem": error.problem,
                "mend": error.mend,
            }
            for name, error in sorted(skipped.items())
        ],
        "doubts": {name: list(lines) for name, lines in sorted(doubts.items()) if lines},
    }
    files.write_json(out / REPORT_FILE, value)
