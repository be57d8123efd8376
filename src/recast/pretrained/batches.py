"""Many items through a network, a fixed number at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Item = TypeVar("Item")

BATCH = 32


@torch.no_grad()
def in_batches(
    compute: Callable[[Sequence[Item]], Tensor],
    items: Sequence[Item],
    width: int,
    size: int = BATCH,
) -> NDArray[np.float64]:
    """(N, width) what `compute` makes of N items, which it gets in order, `size` at a time.

    The last bits of a row depend on how many items were computed with it, on the number of torch's
    threads and on the machine. Work that several processes share therefore gives the same bytes for
    any number of them only if each call gets the items of a fixed unit (such as one rollout) in a
    fixed order with one `size`, and every process has the same number of threads.

    Args:
        compute: from at most `size` items to (n, width), on any device.
    """
    rows = np.empty((len(items), width))
    for start in range(0, len(items), size):
        rows[start : start + size] = compute(items[start : start + size]).double().cpu().numpy()
    return rows
