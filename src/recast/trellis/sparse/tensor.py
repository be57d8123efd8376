"""Features on the occupied voxels of several samples, and the 26 neighbours of each, by sorting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import torch
from torch import Tensor

from recast.core.errors import InputError

_WHERE = "sparse tensor"
OFFSETS = tuple(product((-1, 0, 1), repeat=3))
"""The 27 steps (dx,dy,dz), as a kernel lists its taps; `OFFSETS[26 - k]` mirrors `OFFSETS[k]`."""
CENTRE = 13


@dataclass(frozen=True, eq=False)
class SparseTensor:
    """Features of occupied voxels, of one or several samples.

    The batch size is explicit, so that samples without voxels may stand anywhere in the batch,
    the end included; a tensor without a single row is a tensor like any other.

    Args:
        coords: (T,4) int32 rows [batch, x, y, z]; distinct, rows of a sample contiguous, batch
            ascending, any order inside a sample. Voxel (x,y,z) of an R^3 grid has its centre at
            ((x,y,z) + 0.5) / R - 0.5 of the object's unit cube.
        feats: (T,C) features, row by row.
        batch_size: number of samples, empty ones included.
        cache: what has been derived from the coordinates alone (neighbours, windows, pooling);
            shared between tensors of equal coordinates, so that it is computed once per forward
            pass, or once per sampling run where the caller keeps the tensor.
    """

    coords: Tensor
    feats: Tensor
    batch_size: int
    cache: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)

    @staticmethod
    def stack(coords: Sequence[Tensor], feats: Sequence[Tensor]) -> SparseTensor:
        """One tensor of samples given as coordinates (T_i,3) and features (T_i,C).

        Raises:
            InputError: no sample, or coordinates and features that do not fit each other.
        """
        if not coords or len(coords) != len(feats):
            found = f"{len(coords)} coordinate sets, {len(feats)} feature sets"
            raise InputError(_WHERE, "samples", found, "give one of each for every sample")
        rows = [
            torch.nn.functional.pad(c.to(torch.int32), (1, 0), value=i)
            for i, c in enumerate(coords)
        ]
        tensor = SparseTensor(torch.cat(rows), torch.cat(list(feats)), len(coords))
        tensor.validate()
        return tensor

    @property
    def batch(self) -> Tensor:
        """(T,) int64: the sample each row belongs to."""
        return self.coords[:, 0].long()

    @property
    def counts(self) -> list[int]:
        """Rows of each sample; zeros for empty samples."""
        if "counts" not in self.cache:
            counts = torch.bincount(self.batch, minlength=self.batch_size)
            self.cache["counts"] = counts.tolist()
        return self.cache["counts"]

    @property
    def slices(self) -> list[slice]:
        """Range of rows of each sample."""
        ranges, start = [], 0
        for count in self.counts:
            ranges.append(slice(start, start + count))
            start += count
        return ranges

    def with_feats(self, feats: Tensor) -> SparseTensor:
        """The same voxels with other features (T,C'); what was derived from them is kept."""
        return replace(self, feats=feats)

    def to(self, device: torch.device | str) -> SparseTensor:
        """On another device."""
        return SparseTensor(self.coords.to(device), self.feats.to(device), self.batch_size)

    def validate(self) -> None:
        """Check shapes, the order of the rows and that no voxel stands twice in a sample.

        Raises:
            InputError: naming what is wrong.
        """
        coords = self.coords
        if coords.ndim != 2 or coords.shape[1] != 4 or coords.dtype != torch.int32:
            found = f"shape {tuple(coords.shape)}, {coords.dtype}"
            raise InputError(_WHERE, "coords", found, "give (T,4) int32 rows [batch, x, y, z]")
        if self.feats.ndim != 2 or self.feats.shape[0] != coords.shape[0]:
            found = f"shape {tuple(self.feats.shape)} with {coords.shape[0]} voxels"
            raise InputError(_WHERE, "feats", found, "give (T,C), one row per voxel")
        if coords.shape[0] == 0:
            return
        batch = coords[:, 0]
        first, last = int(batch.min()), int(batch.max())
        if first < 0 or last >= self.batch_size:
            found = f"batch indices {first} to {last} in a batch of {self.batch_size}"
            raise InputError(_WHERE, "coords", found, "number the samples from 0 to batch_size - 1")
        if bool((batch[1:] < batch[:-1]).any()):
            found = "the rows of a sample are not contiguous"
            raise InputError(_WHERE, "coords", found, "order the rows by batch index")
        sorted_keys(voxel_keys(coords, margin=0)[0])


def voxel_keys(coords: Tensor, margin: int) -> tuple[Tensor, tuple[int, int, int, int]]:
    """Keys (T,) int64 of voxels (T,4), and what one step along (batch, x, y, z) adds to a key.

    They ascend in lexicographic order; steps of up to `margin` along any axis cannot meet others.
    They span the bounding box of the voxels, not a grid that is ever held in memory.
    """
    if coords.shape[0] == 0:
        return coords.new_empty(0, dtype=torch.int64), (1, 1, 1, 1)
    low, high = torch.aminmax(coords.long(), dim=0)
    _, x, y, z = (high - low + 1 + 2 * margin).tolist()
    strides = (x * y * z, y * z, z, 1)
    # Weighted sum column by column: an integer matrix product has no kernel on CUDA.
    keys = torch.zeros(coords.shape[0], dtype=torch.int64, device=coords.device)
    for axis, stride in enumerate(strides):
        keys += (coords[:, axis].long() - low[axis] + (margin if axis else 0)) * stride
    return keys, strides


def sorted_keys(keys: Tensor) -> tuple[Tensor, Tensor]:
    """Keys (T,) in ascending order and the rows (T,) they come from.

    Raises:
        InputError: a sample holds a voxel twice.
    """
    ordered, rows = keys.sort()
    if bool((ordered[1:] == ordered[:-1]).any()):
        found = "a sample holds a voxel twice"
        raise InputError(_WHERE, "coords", found, "give every voxel once")
    return ordered, rows


@dataclass(frozen=True, eq=False)
class NeighbourMap:
    """Pairs of touching voxels of the same sample.

    Args:
        pairs: pair (rows, neighbours) of each of the 13 steps before the centre, both (P_k,) int64:
            the voxel of `neighbours[i]` is one step `OFFSETS[k]` from the voxel of `rows[i]`. The
            steps after the centre are the same pairs read backwards.
        count: number of voxels T.
    """

    pairs: tuple[tuple[Tensor, Tensor], ...]
    count: int

    def of(self, tap: int) -> tuple[Tensor, Tensor]:
        """(rows, neighbours) of any tap but the centre."""
        if tap < CENTRE:
            return self.pairs[tap]
        rows, neighbours = self.pairs[2 * CENTRE - tap]
        return neighbours, rows

    @cached_property
    def table(self) -> Tensor:
        """(T,27) int64 row of the voxel at each tap; T where there is none."""
        table = self.pairs[0][0].new_full((self.count, len(OFFSETS)), self.count)
        table[:, CENTRE] = torch.arange(self.count, device=table.device)
        for tap in range(len(OFFSETS)):
            if tap != CENTRE:
                rows, neighbours = self.of(tap)
                table[rows, tap] = neighbours
        return table


def neighbour_map(x: SparseTensor) -> NeighbourMap:
    """Neighbours of the voxels of `x`, computed once per set of coordinates.

    Sorts the voxels once and finds each of the 13 steps by binary search: O(T log T) time and O(T)
    memory, whatever the resolution.

    Raises:
        InputError: a voxel stands twice.
    """
    if "neighbours" not in x.cache:
        keys, strides = voxel_keys(x.coords, margin=1)
        ordered, order = sorted_keys(keys)
        pairs = []
        for offset in OFFSETS[:CENTRE]:
            step = sum(d * s for d, s in zip(offset, strides[1:], strict=True))
            wanted = ordered + step
            place = torch.searchsorted(ordered, wanted)  # never T: the steps lead backwards
            found = torch.nonzero(ordered[place] == wanted).squeeze(1)
            pairs.append((order[found], order[place[found]]))
        x.cache["neighbours"] = NeighbourMap(tuple(pairs), len(order))
    return x.cache["neighbours"]
