"""Samples on disk: a folder for each world, pictures memory-mapped, worlds whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from recast.errors import InputError
from recast.planning.gtrs.vocabulary import Trajectories, read_vocabulary
from recast.records import Record, read_record
from recast.storage import atomic_folder

RECORD_FILE, VOCABULARY_FILE = "dataset.json", "vocabulary.npy"
MEND = "name another folder, or make the samples again"
CLUES = (
    "present", "x", "y", "cos", "sin", "lateral", "turn", "route_10", "route_20", "route_30",
)  # fmt: skip
"""What a picture tells, beside the scores: whether the vehicle placed is in sight, where its middle
is and how it is turned (ego frame); how far the ego is off the route, to the left, and turned
against it; how far to the left the route is 10, 20 and 30 m on. Metres and radians."""
HELD_OUT_EVERY = 10
"""Worlds; nine scenes take turns, so each is held out in turn."""

_IMAGES, _REST = "images.npy", "samples.npz"
_MEMBERS = ("status", "scores", "best", "clues", "twin")


class DatasetRecord(Record):
    """What all samples of a folder share, as written to `dataset.json`.

    Attributes:
        seed: of everything random; a world's samples depend on it and on the world's number alone.
        per_world: samples of each world.
        speeds: ego states of each sample.
        seconds: of each world's drive.
        scenes: by which worlds take turns.
    """

    format: Literal["recast-planner-dataset"] = "recast-planner-dataset"
    version: Literal[1] = 1
    seed: int = Field(default=0, ge=0)
    per_world: int = Field(default=32, ge=2)
    speeds: int = Field(default=3, ge=1)
    seconds: float = Field(default=16.0, ge=14.0, le=20.0)
    scenes: tuple[str, ...] = Field(min_length=1)


@dataclass(frozen=True)
class Sample:
    """One picture, K speeds of the ego, L trajectories.

    Attributes:
        image: (128, 512, 3) uint8 RGB.
        status: (K, 8) float32, see `ego_status`.
        scores: (K, 6, L) uint8, see `Targets`.
        best: (K,) int32, the best trajectory.
        clues: (10,) float32, see `CLUES`.
    """

    image: NDArray[np.uint8]
    status: NDArray[np.float32]
    scores: NDArray[np.uint8]
    best: NDArray[np.int32]
    clues: NDArray[np.float32]


def world_folder(folder: Path, number: int) -> Path:
    """Where the samples of a world lie."""
    return folder / f"world-{number:05d}"


def write_world(folder: Path, samples: Sequence[Sample], twins: Sequence[int]) -> None:
    """Write the samples of a world, whole or not at all.

    Args:
        twins: for each sample the number of the one that differs in the vehicle alone, or -1.
    """
    with atomic_folder(folder) as partial:
        np.save(partial / _IMAGES, np.stack([one.image for one in samples]))
        np.savez_compressed(
            partial / _REST,
            status=np.stack([one.status for one in samples]),
            scores=np.stack([one.scores for one in samples]),
            best=np.stack([one.best for one in samples]),
            clues=np.stack([one.clues for one in samples]),
            twin=np.array(twins, np.int32),
        )


class SampleStore:
    """All samples of a dataset folder; pictures stay on disk until they are looked at.

    Args:
        folder: of `recast planner dataset`.

    Raises:
        InputError: it has no samples, its record or a world's files are wrong.

    Attributes:
        record, vocabulary: of the folder.
        worlds: (N,) number of each sample's world.
        status, scores, best, clues: of all samples, see `Sample`.
        twin: (N,) index of the sample that differs in the vehicle alone, or -1.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.record = read_record(
            folder / RECORD_FILE, DatasetRecord, 1, MEND, "recast-planner-dataset"
        )
        self.vocabulary: Trajectories = read_vocabulary(folder / VOCABULARY_FILE)
        paths = sorted(folder.glob("world-*"))
        if not paths:
            raise InputError(folder, "samples", "there are none", "recast planner dataset")
        self._images: list[NDArray[np.uint8]] = []
        parts: dict[str, list[np.ndarray]] = {name: [] for name in _MEMBERS}
        worlds, first = [], 0
        for path in paths:
            images, rest = _read_world(path)
            self._images.append(images)
            for name in _MEMBERS:
                parts[name].append(rest[name])
            twin = parts["twin"][-1]
            parts["twin"][-1] = np.where(twin < 0, -1, twin + first)
            worlds.append(np.full(len(images), int(path.name.removeprefix("world-"))))
            first += len(images)
        self.worlds = np.concatenate(worlds)
        self.status, self.scores, self.best, self.clues, self.twin = (
            np.concatenate(parts[name]) for name in _MEMBERS
        )
        self._first = np.cumsum([0, *(len(images) for images in self._images)])
        if self.scores.shape[-1] != len(self.vocabulary):
            raise InputError(
                folder / VOCABULARY_FILE, "vocabulary",
                f"has {len(self.vocabulary)} trajectories, scored were {self.scores.shape[-1]}",
                MEND,
            )  # fmt: skip

    def __len__(self) -> int:
        return len(self.worlds)

    def image(self, index: int) -> NDArray[np.uint8]:
        """(128, 512, 3) uint8."""
        part = int(np.searchsorted(self._first, index, side="right")) - 1
        return np.array(self._images[part][index - self._first[part]])

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """(N,) samples of the worlds that are not trained on."""
        found: NDArray[np.bool_] = self.worlds % HELD_OUT_EVERY == HELD_OUT_EVERY - 1
        return found


def _read_world(path: Path) -> tuple[NDArray[np.uint8], dict[str, np.ndarray]]:
    try:
        images = np.load(path / _IMAGES, mmap_mode="r", allow_pickle=False)
        with np.load(path / _REST, allow_pickle=False) as archive:
            return images, {name: archive[name] for name in _MEMBERS}
    except (OSError, ValueError, KeyError, EOFError) as error:
        said = " ".join(str(error).split())
        raise InputError(path, "samples", f"cannot be read ({said})", f"remove {path}") from None
