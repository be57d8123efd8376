"""The same photograph twice, also scaled or compressed anew: hashes, and a journal beside a set."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Image
from recast.core import files
from recast.core.errors import InputError
from recast.core.records import Record, validated
from recast.recar.vehicle_set import Identity

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

    def shown(text: str) -> str:  # settings in backquotes as options of the command line
        return re.sub("`([a-z_]+)`", lambda name: "--" + name[1].replace("_", "-"), text)

    value = {
        "skipped": [
            {
                "vehicle": name,
                "where": shown(error.where),
                "field": shown(error.field),
                "problem": error.problem,
                "mend": shown(error.mend),
            }
            for name, error in sorted(skipped.items())
        ],
        "doubts": {name: list(lines) for name, lines in sorted(doubts.items()) if lines},
    }
    files.write_json(out / REPORT_FILE, value)


class _Report(Record):
    skipped: tuple[dict[str, str], ...]
    doubts: dict[str, tuple[str, ...]]


def read_doubts(out: Path) -> dict[str, tuple[str, ...]] | None:
    """The doubts in ingest.json by identity; None for a set without the file, such as renders.

    Raises:
        InputError: the file is broken.
    """
    path = out / REPORT_FILE
    if not path.exists():
        return None
    mend = "run `recast recar ingest` again, or delete the file"
    return validated(path, files.read_json(path), _Report, mend).doubts
