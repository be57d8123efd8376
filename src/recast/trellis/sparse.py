"""Features on the occupied voxels of several samples, and the 26 neighbours of each, by sorting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import scaled_dot_product_attention

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
        """One tensor of samples given as coordinates (T_i,3) and features (T_i,C). Raises
        InputError: no sample, or coordinates and features that do not fit each other."""
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
        """Check shapes, the order of the rows and that no voxel stands twice in a sample. Raises
        InputError: naming what is wrong."""
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
    """Keys (T,) in ascending order and the rows (T,) they come from. Raises InputError: a sample
    holds a voxel twice."""
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


class PackedTokens:
    """Tokens (T,C) of several samples, in the rows of a sparse tensor; full attention per sample.

    Args:
        x: the voxels; its features are not used.
    """

    def __init__(self, x: SparseTensor) -> None:
        self.x = x

    def spread(self, per_sample: Tensor) -> Tensor:
        """(B,...) values of the samples, to be combined with their tokens: (T,...) or (1,...)."""
        if self.x.batch_size == 1:
            return per_sample
        # Expanding adds the gradient up per sample in one fixed order; indexing would scatter it.
        shape = per_sample.shape[1:]
        return torch.cat(
            [row.expand(n, *shape) for row, n in zip(per_sample, self.x.counts, strict=True)]
        )

    def attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """softmax(q k^T / sqrt(D)) v within each sample; all (T,H,D)."""
        counts = self.x.counts
        parts = zip(q.split(counts), k.split(counts), v.split(counts), strict=True)
        return torch.cat([attention(*part) for part in parts])

    def attend_reference(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Readable twin of `attend`: one sample after another, weights written out."""
        return torch.cat([attention_reference(q[s], k[s], v[s]) for s in self.x.slices])

    def attend_to(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Queries (T,H,D) of each sample over that sample's context k, v (B,L,H,D)."""
        parts = zip(q.split(self.x.counts), k.unbind(), v.unbind(), strict=True)
        return torch.cat([attention(*part) for part in parts])


def attention(q: Tensor, k: Tensor, v: Tensor) -> Tensor:
    """softmax(q k^T / sqrt(D)) v of (...,N,H,D) queries over (...,M,H,D) keys and values."""
    if q.numel() == 0:
        return q + 0 * v.sum()  # no token; still a part of the graph
    if q.ndim == 3:
        # Without an axis for the batch, torch writes out the matrix of weights.
        return attention(q[None], k[None], v[None])[0]
    out = scaled_dot_product_attention(
        q.transpose(-3, -2), k.transpose(-3, -2), v.transpose(-3, -2)
    )
    return out.transpose(-3, -2)


def attention_reference(q: Tensor, k: Tensor, v: Tensor) -> Tensor:
    """Readable twin of `attention`: the matrix of weights, written out."""
    scores = torch.einsum("...nhd,...mhd->...hnm", q, k) / q.shape[-1] ** 0.5
    return torch.einsum("...hnm,...mhd->...nhd", scores.softmax(-1), v)


@dataclass(frozen=True, eq=False)
class WindowPartition:
    """The voxels of a sparse tensor, ordered so that windows of equal size lie together.

    Args:
        order: (T,) int64 rows, window after window, small windows first.
        inverse: (T,) int64 place of every row in `order`.
        buckets: (number of windows, voxels in each), in the order in which they lie in `order`.
    """

    order: Tensor
    inverse: Tensor
    buckets: list[tuple[int, int]]


def window_partition(x: SparseTensor, window: int, shift: int) -> WindowPartition:
    """Windows (batch, floor((c + shift) / window)) of the voxels of `x`, computed once."""
    key = ("windows", window, shift)
    cached: dict[Any, WindowPartition] = x.cache
    if key not in cached:
        keys, _ = voxel_keys(window_cells(x, window, shift), margin=0)
        _, cell, counts = keys.unique(return_inverse=True, return_counts=True)
        # By size, then by window: equal sizes become one batch without padding.
        order = torch.argsort(counts[cell] * max(len(counts), 1) + cell, stable=True)
        inverse = torch.empty_like(order)
        inverse[order] = torch.arange(len(order), device=order.device)
        sizes, numbers = counts.unique(return_counts=True)
        buckets = list(zip(numbers.tolist(), sizes.tolist(), strict=True))
        cached[key] = WindowPartition(order, inverse, buckets)
    return cached[key]


class WindowedTokens(PackedTokens):
    """Tokens (T,C) in the rows of a sparse tensor; self attention within windows of voxels.

    A window holds the voxels of one sample with equal floor((c + shift) / window) on all axes: a
    plain shift, not a cyclic one, and windows at the border are smaller. Cross attention is as in
    `PackedTokens`.
    """

    def __init__(self, x: SparseTensor, window: int, shift: int) -> None:
        super().__init__(x)
        self.window = window
        self.shift = shift

    def attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """softmax(q k^T / sqrt(D)) v within each window; all (T,H,D)."""
        partition = window_partition(self.x, self.window, self.shift)
        if not partition.buckets:
            return q + 0 * v.sum()
        q, k, v = (_Permute.apply(t, partition.order, partition.inverse) for t in (q, k, v))
        # Splitting gives one gradient for all parts; slices would give one of full size each.
        sizes = [number * size for number, size in partition.buckets]
        rows = [
            attention(*(t.unflatten(0, bucket) for t in part)).flatten(0, 1)
            for bucket, *part in zip(
                partition.buckets, q.split(sizes), k.split(sizes), v.split(sizes), strict=True
            )
        ]
        return _Permute.apply(torch.cat(rows), partition.inverse, partition.order)

    def attend_reference(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Readable twin of `attend`: one window after another."""
        cells = window_cells(self.x, self.window, self.shift)
        out = torch.zeros_like(q)
        for cell in cells.unique(dim=0):
            rows = torch.nonzero((cells == cell).all(1)).squeeze(1)
            out[rows] = attention_reference(q[rows], k[rows], v[rows])
        return out


def window_cells(x: SparseTensor, window: int, shift: int) -> Tensor:
    """(T,4) int32 window [batch, i, j, k] of every voxel."""
    moved = (x.coords[:, 1:] + shift).div(window, rounding_mode="floor")
    return torch.cat([x.coords[:, :1], moved], dim=1)


class _Permute(torch.autograd.Function):
    """Rows in another order; the gradient gathers by the inverse instead of scattering."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, order: Tensor, inverse: Tensor) -> Tensor:
        ctx.save_for_backward(order, inverse)
        return rows.index_select(0, order)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        order, inverse = ctx.saved_tensors
        return _Permute.apply(grads[0], inverse, order), None, None


@dataclass(frozen=True, eq=False)
class PoolIndex:
    """Which fine voxels lie in which coarse voxel.

    Args:
        fine, coarse: the voxels, without features, (T,0) and (T',0).
        parent: (T,) int64 row of the coarse voxel around each fine one.
        children: (factor^3,T') int64 rows of the fine voxels in each coarse one, by their place in
            it; T where there is none.
        counts: (T',) int64 number of fine voxels in each coarse one.
    """

    fine: SparseTensor
    coarse: SparseTensor
    parent: Tensor
    children: Tensor = field(repr=False)
    counts: Tensor = field(repr=False)


def pool(x: SparseTensor, factor: int = 2) -> tuple[SparseTensor, PoolIndex]:
    """Features on voxels `factor` times as large: the sum of the children over their count plus 1.

    The published networks were trained with this divisor (a mean in which the zero they sum onto
    counts as one more child), so it belongs to the weights.

    Returns:
        The coarse tensor, its rows in lexicographic order (batch, x, y, z), and the index that
        `unpool` needs.

    Raises:
        InputError: a voxel stands twice.
    """
    index = _pool_index(x, factor)
    total: Tensor = _SumOfChildren.apply(x.feats, index.parent, index.children)
    feats = total / (index.counts + 1).to(total.dtype).unsqueeze(1)
    return index.coarse.with_feats(feats), index


def unpool(coarse: SparseTensor, index: PoolIndex) -> SparseTensor:
    """Each fine voxel takes the features of the coarse voxel around it (nearest neighbour).

    The voxels and the order of the rows are those that were pooled.
    """
    feats: Tensor = _OfParent.apply(coarse.feats, index.parent, index.children)
    return index.fine.with_feats(feats)


def pool_reference(x: SparseTensor, factor: int = 2) -> SparseTensor:
    """Readable twin of `pool`, voxel by voxel."""
    families: dict[tuple[int, ...], list[int]] = {}
    for row, (batch, *voxel) in enumerate(x.coords.tolist()):
        families.setdefault((batch, *(c // factor for c in voxel)), []).append(row)
    ordered = sorted(families)
    feats = x.feats.new_zeros(len(ordered), x.feats.shape[1])
    for i, parent in enumerate(ordered):
        rows = families[parent]
        feats[i] = x.feats[rows].sum(0) / (len(rows) + 1)
    coords = torch.tensor(ordered, dtype=torch.int32, device=x.coords.device).reshape(-1, 4)
    return SparseTensor(coords, feats, x.batch_size)


def _pool_index(x: SparseTensor, factor: int) -> PoolIndex:
    cached: dict[Any, PoolIndex] = x.cache
    if ("pool", factor) not in cached:
        coords = x.coords.clone()
        coords[:, 1:] = x.coords[:, 1:].div(factor, rounding_mode="floor")
        keys, _ = voxel_keys(coords, margin=0)
        _, parent, counts = keys.unique(return_inverse=True, return_counts=True)
        place = torch.zeros_like(parent)
        for axis in (1, 2, 3):
            place = place * factor + (x.coords[:, axis] - coords[:, axis] * factor)
        rows = torch.arange(len(parent), device=parent.device)
        children = parent.new_full((factor**3, len(counts)), len(parent))
        children[place, parent] = rows
        if not torch.equal(children[place, parent], rows):
            found = "a sample holds a voxel twice"
            raise InputError("sparse tensor", "coords", found, "give every voxel once")
        first = children.amin(0)
        empty = x.feats.new_empty
        cached[("pool", factor)] = PoolIndex(
            x.with_feats(empty(len(parent), 0)),
            SparseTensor(coords[first], empty(len(counts), 0), x.batch_size),
            parent,
            children,
            counts,
        )
    return cached[("pool", factor)]


class _SumOfChildren(torch.autograd.Function):
    """(T,C) -> (T',C); gathers in both directions, so that the sums have one fixed order."""

    @staticmethod
    def forward(ctx: Any, feats: Tensor, parent: Tensor, children: Tensor) -> Tensor:
        ctx.save_for_backward(parent, children)
        padded = torch.cat([feats, feats.new_zeros(1, feats.shape[1])])
        total = feats.new_zeros(children.shape[1], feats.shape[1])
        for rows in children:
            total += padded.index_select(0, rows)
        return total

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        parent, children = ctx.saved_tensors
        return _OfParent.apply(grads[0], parent, children), None, None


class _OfParent(torch.autograd.Function):
    """(T',C) -> (T,C): the transpose of `_SumOfChildren`."""

    @staticmethod
    def forward(ctx: Any, feats: Tensor, parent: Tensor, children: Tensor) -> Tensor:
        ctx.save_for_backward(parent, children)
        return feats.index_select(0, parent)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        parent, children = ctx.saved_tensors
        return _SumOfChildren.apply(grads[0], parent, children), None, None
