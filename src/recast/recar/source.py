"""What a vehicle set is to those who use it, whether it lies in folders or in shards."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recast.geometry import PinholeCamera
from recast.recar.picture import Image
from recast.recar.record import IdentityRecord, SetRecord, Split


class IdentitySource(Protocol):
    """One vehicle; its pictures are decoded when asked for."""

    @property
    def record(self) -> IdentityRecord:
        """What is known about it."""

    @property
    def set_record(self) -> SetRecord:
        """What it shares with all of the set."""

    def view(self, index: int) -> Image:
        """(height, width, 4) uint8 RGBA with straight alpha."""

    def encoded(self, index: int) -> bytes:
        """The PNG of a view."""

    def picture_bytes(self) -> int:
        """Bytes of all its pictures."""

    def camera(self, index: int) -> tuple[PinholeCamera, NDArray[np.float64]]:
        """The camera of a view and `actor_from_camera` (4, 4)."""


class VehicleSource(Protocol):
    """A set: `VehicleSet` and `ShardedSet` alike."""

    @property
    def folder(self) -> Path:
        """Where it lies."""

    @property
    def record(self) -> SetRecord:
        """set.json."""

    @property
    def identities(self) -> Mapping[str, IdentitySource]:
        """By id, sorted."""

    def of_split(self, split: Split) -> Iterator[IdentitySource]:
        """The identities of one split, sorted."""

    def records(self) -> Iterator[tuple[IdentityRecord, int]]:
        """Record and bytes of the pictures of every identity, in the order in which they lie.

        Nothing is kept, so that statistics of a large set take little memory.
        """

    def check_pictures(
        self, decode: bool = False, progress: Callable[[int, int], None] | None = None
    ) -> None:
        """Look at every picture: its header, or all of it."""
