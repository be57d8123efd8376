"""What conditions a flow: the vehicles of a step, a picture of each, and its image tokens.

Pictures are the views of a vehicle set, or those of 3D assets. Frame of an asset: the unit cube of
the image-to-3D model, [-0.5, 0.5]^3, longest side 1, z up; vehicles look along +x.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.table_files import read_npz
from recast.recar.screening import read_decisions
from recast.recar.vehicle_set import SET_FILE, Split, VehicleSet, read_set
from recast.recar.views import write_arrays
from recast.trellis.conditioning import ImageEncoder, crop_to_object, images_from_crops

FEATURES = 17
"""Colour, normal, centroid in the voxel (three each) and eight sub-voxels' occupancy."""


@dataclass(frozen=True)
class TrainingAsset:
    """One asset.

    Attributes:
        size: (3,) extents in the unit cube before the asset was centred, longest 1.
        coords: (T, 3) uint8 voxels of the visible surface, lexicographic.
        features: (T, 17) float16, see `FEATURES`; colours and normals in [-1, 1], the centroid in
            voxels from its centre, sub-voxels 0 or 1.
        pictures: (V, S, S, 4) uint8 RGBA with straight alpha.
        poses: (V, 4, 4) float32 `camera_from_asset`.
        focal: (V,) float32 focal lengths in pixels; the principal point is the middle.
        crops: number of pictures, the first ones, that look as a car's camera would see them.
    """

    kind: str
    size: NDArray[np.float32]
    coords: NDArray[np.uint8]
    features: NDArray[np.float16]
    pictures: NDArray[np.uint8]
    poses: NDArray[np.float32]
    focal: NDArray[np.float32]
    crops: int

    def validate(self) -> None:
        """Check types, shapes and ranges.

        Raises:
            ValueError: the first that is wrong.
        """
        voxels, views = self.coords.shape[:1], self.pictures.shape[:1]
        pixels = self.pictures.shape[1:2]
        for name, dtype, shape in (
            ("size", np.float32, (3,)),
            ("coords", np.uint8, (*voxels, 3)),
            ("features", np.float16, (*voxels, FEATURES)),
            ("pictures", np.uint8, (*views, *pixels, *pixels, 4)),
            ("poses", np.float32, (*views, 4, 4)),
            ("focal", np.float32, views),
        ):
            found = getattr(self, name)
            if found.dtype != dtype or found.shape != shape:
                raise ValueError(f"{name}: is {found.dtype} {found.shape}, not {dtype} {shape}")
            if not np.isfinite(found).all():
                raise ValueError(f"{name}: holds values that are not finite")
        if not voxels or not pixels or 0 in (*voxels, *views, *pixels):
            raise ValueError("holds no voxels or no images")
        if not 0 < self.crops <= len(self.pictures) or not (self.focal > 0).all():
            raise ValueError(
                f"crops is {self.crops}, of {len(self.pictures)} images, or a focal length is <= 0"
            )


_MEND_ASSET = "make the assets again"
_MOST_BYTES = 1 << 29
_ARRAYS = tuple(field.name for field in fields(TrainingAsset))


def write_asset(path: Path, asset: TrainingAsset) -> None:
    """Write an asset as a compressed NumPy archive, whole or not at all."""
    write_arrays(
        path,
        kind=np.array(asset.kind),
        size=asset.size,
        coords=asset.coords,
        features=asset.features,
        pictures=asset.pictures,
        poses=asset.poses,
        focal=asset.focal,
        crops=np.array(asset.crops),
    )


def read_asset(path: Path) -> TrainingAsset:
    """Read what `write_asset` wrote.

    Raises:
        InputError: missing, cut short, or of another layout.
    """
    found = read_npz(path, _MEND_ASSET, _ARRAYS, _MOST_BYTES)
    try:
        values: dict[str, Any] = {**found, "kind": str(found["kind"]), "crops": int(found["crops"])}
        asset = TrainingAsset(**values)
        asset.validate()
    except (TypeError, ValueError) as error:
        raise InputError(path, "arrays", str(error), _MEND_ASSET) from None
    return asset


_ASSETS_KEPT = 1024  # whose crops are decoded at a time, half a megabyte each
Perturb = Callable[[Image, np.random.Generator], Image]


class SetConditions:
    """The views of a vehicle set.

    Attributes:
        decisions: decisions of a person about its identities, see `recast.recar.screening`.

    Raises:
        InputError: screening.csv is wrong.
    """

    def __init__(self, vehicle_set: VehicleSet) -> None:
        self._identities = vehicle_set.identities
        self.decisions = read_decisions(vehicle_set.folder, vehicle_set.identities)

    @property
    def ids(self) -> tuple[str, ...]:
        """Identities, sorted."""
        return tuple(self._identities)

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
        read: function that reads an asset file; for tests.
    """

    def __init__(
        self, paths: Iterable[Path], read: Callable[[Path], TrainingAsset] = read_asset
    ) -> None:
        self._paths = {path.stem: path for path in paths}
        self._crops = lru_cache(maxsize=_ASSETS_KEPT)(self._read_crops)
        self._read = read

    def _read_crops(self, path: Path) -> NDArray[np.uint8]:
        asset = self._read(path)
        return asset.pictures[: asset.crops].copy()  # a view would keep all pictures

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
            raise IndexError(f"crop {index}: {identity} has {len(crops)} crops")
        return crops[index]


ConditionSource = SetConditions | AssetConditions


def open_conditions(folder: Path) -> ConditionSource:
    """The pictures in a folder: a vehicle set, or assets `*.npz`.

    Raises:
        InputError: neither is there, or the set is at fault.
    """
    if (folder / SET_FILE).is_file():
        return SetConditions(read_set(folder))
    paths = sorted(folder.glob("[!.]*.npz"))
    if not paths:
        problem = f"the folder contains no {SET_FILE} or assets (*.npz)"
        mend = "give a vehicle set, or a folder of training assets"
        raise InputError(folder, "pictures", problem, mend)
    return AssetConditions(paths)


def draw_identities(
    identities: Sequence[str], count: int, rng: np.random.Generator
) -> tuple[str, ...]:
    """Draw the vehicles of a batch: no one twice before all were drawn once."""
    drawn: list[str] = []
    while len(drawn) < count:
        order = rng.permutation(len(identities))[: count - len(drawn)]
        drawn += [identities[i] for i in order]
    return tuple(drawn)


def balanced_parts(loads: Sequence[int], parts: int) -> list[list[int]]:
    """Split a batch into parts of about the same load, such as voxels.

    The heaviest sample first, each goes to the part with the least load so far (Graham 1969,
    longest processing time first); no part stays empty.

    Args:
        loads: load of each sample, above zero.
        parts: number of parts; at most as many as samples.

    Returns:
        Indices of the samples of each part, ascending.

    Raises:
        ValueError: more parts than samples.
    """
    if parts > len(loads):
        raise ValueError(f"a batch of {len(loads)} does not split into {parts} parts")
    groups: list[list[int]] = [[] for _ in range(parts)]
    totals = [0] * parts
    for index in sorted(range(len(loads)), key=lambda i: (-loads[i], i)):
        lightest = min(range(parts), key=lambda p: (totals[p], len(groups[p]), p))
        groups[lightest].append(index)
        totals[lightest] += loads[index]
    return [sorted(group) for group in groups]


@dataclass(frozen=True)
class ConditionView:
    """One picture of one identity."""

    identity: str
    index: int


@dataclass
class ConditionTokens:
    """Tokens of views; those of a frozen encoder are kept in memory up to a bound.

    Every picture is encoded alone: a batch of several would round differently, and a resumed
    training, whose memory is empty, would not come out the same.

    Attributes:
        frozen: whether to encode without gradients.
        kept_bytes: most bytes of tokens kept; nothing is dropped, what comes later is encoded each
            time.
    """

    encoder: ImageEncoder
    source: ConditionSource
    device: torch.device
    frozen: bool = True
    kept_bytes: int = 0
    used_bytes: int = field(default=0, init=False)
    _kept: dict[ConditionView, Tensor] = field(default_factory=dict, init=False, repr=False)

    def crop(self, view: ConditionView, alter: Perturb | None, rng: np.random.Generator) -> Image:
        """The square crop (S, S, 3) on black that the encoder sees, altered first if asked.

        Raises:
            InputError: nothing to see in the picture, or it cannot be read.
        """
        rgba = self.source.picture(view.identity, view.index)
        if alter is not None:
            rgba = alter(rgba, rng)
        where = f"{view.identity} image {view.index}"
        return crop_to_object(rgba, self.encoder.image_size, where=where)

    def of(
        self,
        views: Sequence[ConditionView],
        alters: Sequence[Perturb | None],
        rng: np.random.Generator,
    ) -> Tensor:
        """Tokens (B, L, C) of views, each altered by its own function or left clean."""
        if self.frozen:
            with torch.no_grad():
                tokens = [self._one(v, a, rng) for v, a in zip(views, alters, strict=True)]
            return torch.stack(tokens).to(self.device)
        crops = [self.crop(v, a, rng) for v, a in zip(views, alters, strict=True)]
        return self.encoder.encode(images_from_crops(crops).to(self.device))

    def _one(self, view: ConditionView, alter: Perturb | None, rng: np.random.Generator) -> Tensor:
        if alter is None and view in self._kept:
            return self._kept[view]
        images = images_from_crops([self.crop(view, alter, rng)]).to(self.device)
        tokens = self.encoder.encode(images)[0].detach()
        size = tokens.numel() * tokens.element_size()
        if alter is None and self.used_bytes + size <= self.kept_bytes:
            self._kept[view] = tokens = tokens.cpu()
            self.used_bytes += size
        return tokens.to(self.device)
