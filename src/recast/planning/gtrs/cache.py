"""Keeps a result until anything it was computed from has changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor


class TensorCache:
    """The last result of a pure function of tensors.

    The inputs are compared by value with copies of their own. That costs one pass over them, and
    cannot miss a change, however it was made: an optimiser step, new weights, writing in place.
    """

    def __init__(self) -> None:
        self._inputs: list[Tensor] = []
        self._result: Tensor | None = None

    def get(self, inputs: Sequence[Tensor], compute: Callable[[], Tensor]) -> Tensor:
        """The kept result if `inputs` are as they were, else that of `compute`.

        Args:
            inputs: all that `compute` reads.
            compute: gives a tensor that nobody writes to.
        """
        if self._result is None or not self._unchanged(inputs):
            # Forgotten first, so that a failing computation leaves nothing that looks valid.
            self._result = None
            result = compute().detach()
            self._inputs = [tensor.detach().clone() for tensor in inputs]
            self._result = result
        return self._result

    def _unchanged(self, inputs: Sequence[Tensor]) -> bool:
        return len(inputs) == len(self._inputs) and all(
            ours.device == theirs.device
            and ours.dtype == theirs.dtype
            and torch.equal(ours, theirs)
            for ours, theirs in zip(self._inputs, inputs, strict=True)
        )
