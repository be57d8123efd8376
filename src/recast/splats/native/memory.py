"""Recycled memory for tensors that every step makes anew.

A fresh large tensor costs a page fault every 4 kB, which at some hundred thousand Gaussians is as
slow as computing its content. Tensors given out here own their memory like any other; when the last
reference goes, the memory goes back to a small store instead of to the operating system.
"""

from __future__ import annotations

import math
import threading
import weakref
from collections import deque

import numpy as np
import torch
from torch import Tensor

_KEEP = 16
_store: list[np.ndarray] = []
_lock = threading.Lock()
# Blocks come back whenever Python collects a tensor, even while the lock is held: they wait here.
_returned: deque[np.ndarray] = deque()


def empty(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """A tensor with undefined content, its memory taken from the store where a block fits."""
    size = dtype.itemsize * math.prod(shape)
    block = _take(size)
    lease = block.view()
    weakref.finalize(lease, _returned.append, block).atexit = False
    flat: Tensor = torch.from_numpy(lease)[:size].view(dtype)
    return flat.view(shape)


def clear() -> None:
    """Give the stored memory back to the operating system."""
    with _lock:
        _returned.clear()
        _store.clear()


def _take(size: int) -> np.ndarray:
    with _lock:
        while _returned:
            _store.append(_returned.popleft())
        best = -1
        for i, block in enumerate(_store):
            # A much larger block would be missing elsewhere.
            fits = size <= block.nbytes <= 1.5 * size + 4096
            if fits and (best < 0 or block.nbytes < _store[best].nbytes):
                best = i
        if best >= 0:
            return _store.pop(best)
        del _store[: max(0, len(_store) - _KEEP)]
    return np.empty(max(64, size + size // 8), np.uint8)
