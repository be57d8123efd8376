"""Where the pictures that condition a flow come from: a vehicle set, or training assets."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.recar.assets.asset import TrainingAsset, read_asset
from recast.recar.picture import Image
from recast.recar.record import SET_FILE, Split
from recast.recar.shards.layout import INDEX_FILE
from recast.recar.shards.opening import open_set
from recast.recar.source import IdentitySource

_ASSETS_KEPT = 1024  # whose crops are decoded at a time, half a megabyte each


class ConditionSource(Protocol):
    """Pictures by identity and number."""

    @property
    def ids(self) -> tuple[str, ...]:
        """Identities with pictures, sorted."""
        ...

    def count(self, identity: str) -> int:
        """Pictures of an identity."""
        ...

    def picture(self, identity: str, index: int) -> Image:
        """(H, W, 4) uint8 RGBA with straight alpha."""
        ...


class SetConditions:
    """The views of a vehicle set's identities, in folders or in shards.

    Args:
        identities: of the set, by id.
    """

    def __init__(self, identities: Mapping[str, IdentitySource]) -> None:
        self._identities = dict(identities)

    @property
    def ids(self) -> tuple[str, ...]:
        """Identities, sorted."""
        return tuple(sorted(self._identities))

    def split(self, identity: str) -> Split:
        """Whether the set lets it be trained on."""
        return self._identities[identity].record.split

    def count(self, identity: str) -> int:
        """Views of the set."""
        return self._identities[identity].set_record.views

    def picture(self, identity: str, index: int) -> Image:
        """A view; see `Identity.view` for what it raises."""
        return self._identities[identity].view(index)


class AssetConditions:
    """The crops of training assets, which look as a car's camera would; see `TrainingAsset`.

    Args:
        paths: files of assets; their stems are the identities.
        read: for tests.
    """

    def __init__(
        self, paths: Iterable[Path], read: Callable[[Path], TrainingAsset] = read_asset
    ) -> None:
        self._paths = {path.stem: path for path in paths}
        self._crops = lru_cache(maxsize=_ASSETS_KEPT)(lambda path: _crops(read(path)))

    @property
    def ids(self) -> tuple[str, ...]:
        """Identities, sorted."""
        return tuple(sorted(self._paths))

    def count(self, identity: str) -> int:
        """Crops of an asset."""
        return len(self._crops(self._paths[identity]))

    def picture(self, identity: str, index: int) -> NDArray[np.uint8]:
        """One of its first `crops` pictures."""
        crops = self._crops(self._paths[identity])
        if not 0 <= index < len(crops):
            raise IndexError(f"crop {index}: {identity} has {len(crops)}")
        return crops[index]


def _crops(asset: TrainingAsset) -> NDArray[np.uint8]:
    return asset.pictures[: asset.crops].copy()  # a view would keep all pictures


def open_conditions(folder: Path) -> ConditionSource:
    """The pictures in a folder: a vehicle set, in folders or in shards, or assets `*.npz`.

    Raises:
        InputError: neither is there, or the set is at fault.
    """
    if any((folder / name).is_file() for name in (SET_FILE, INDEX_FILE)):
        return SetConditions(open_set(folder).identities)
    paths = sorted(folder.glob("[!.]*.npz"))
    if not paths:
        raise InputError(
            folder, "pictures", f"no {SET_FILE}, no {INDEX_FILE} and no assets (*.npz) there",
            "name a vehicle set, or a folder of training assets",
        )  # fmt: skip
    return AssetConditions(paths)


def missing_pictures(source: ConditionSource, identities: Iterable[str]) -> tuple[str, ...]:
    """Of some identities those that a source has no picture of."""
    known = set(source.ids)
    return tuple(one for one in identities if one not in known or source.count(one) == 0)
