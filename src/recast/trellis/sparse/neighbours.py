"""The 26 neighbours of every occupied voxel, found by sorting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import torch
from torch import Tensor

from recast.trellis.sparse.tensor import SparseTensor, voxel_keys

OFFSETS = tuple(product((-1, 0, 1), repeat=3))
"""The 27 steps (dx,dy,dz), as a kernel lists its taps; `OFFSETS[26 - k]` mirrors `OFFSETS[k]`."""
CENTRE = 13


@dataclass(frozen=True, eq=False)
class NeighbourMap:
    """Pairs of touching voxels of the same sample.

    Args:
        pairs: for each of the 13 steps before the centre, (rows, neighbours), both (P_k,) int64:
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
        numbered = voxel_keys(x.coords, margin=1)
        ordered, order = numbered.sort()
        pairs = []
        for offset in OFFSETS[:CENTRE]:
            step = sum(d * s for d, s in zip(offset, numbered.strides[1:], strict=True))
            wanted = ordered + step
            place = torch.searchsorted(ordered, wanted)  # never T: the steps lead backwards
            found = torch.nonzero(ordered[place] == wanted).squeeze(1)
            pairs.append((order[found], order[place[found]]))
        x.cache["neighbours"] = NeighbourMap(tuple(pairs), len(order))
    neighbours: NeighbourMap = x.cache["neighbours"]
    return neighbours
