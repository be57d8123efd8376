"""The processes that train together: one, or those that torchrun started."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from recast.errors import InputError
from recast.recar.training.log import Means

_BUCKET = 1 << 25  # elements that are averaged in one message, 128 MiB


@dataclass(frozen=True)
class Processes:
    """Which of how many processes this is.

    Each takes other parts of every batch; gradients are averaged, so that all hold the same
    weights. The first one alone writes files.

    Attributes:
        index, count: of this process, and of all.
        device: where this process computes; None leaves that to the caller.
    """

    index: int = 0
    count: int = 1
    device: torch.device | None = None

    @property
    def first(self) -> bool:
        """Whether this process writes files."""
        return self.index == 0

    @staticmethod
    def started() -> Processes:
        """Those of torchrun, by its environment variables; a single one without them.

        Raises:
            InputError: there are several, and accelerate is not installed.
        """
        if int(os.environ.get("WORLD_SIZE", "1")) == 1:
            return Processes()
        state = _accelerate().PartialState(cpu=not torch.cuda.is_available())
        return Processes(state.process_index, state.num_processes, torch.device(state.device))

    def wait(self) -> None:
        """Until all processes are here."""
        if self.count > 1:
            _accelerate().PartialState().wait_for_everyone()

    def average_gradients(self, parameters: Sequence[Tensor]) -> None:
        """Replace all gradients by their mean over the processes."""
        if self.count == 1:
            return
        bucket: list[Tensor] = []
        for parameter in parameters:
            if parameter.grad is None:  # others may have one
                parameter.grad = torch.zeros_like(parameter)
            bucket.append(parameter.grad)
            if sum(gradient.numel() for gradient in bucket) >= _BUCKET:
                _average(bucket)
                bucket = []
        if bucket:
            _average(bucket)

    def merge(self, means: Means) -> Means:
        """Sums and counts over all processes; the names must be the same everywhere."""
        if self.count == 1:
            return means
        names = sorted(means.sums)
        device = self.device or "cpu"
        table = torch.tensor(
            [[means.sums[n] for n in names], [means.counts[n] for n in names]],
            dtype=torch.float64, device=device,
        )  # fmt: skip
        sums, counts = _accelerate().utils.reduce(table, "sum").tolist()
        return Means(dict(zip(names, sums, strict=True)), dict(zip(names, counts, strict=True)))


def _average(gradients: list[Tensor]) -> None:
    flat = torch.cat([gradient.float().flatten() for gradient in gradients])
    mean = _accelerate().utils.reduce(flat, "mean")
    for gradient, part in zip(gradients, mean.split([g.numel() for g in gradients]), strict=True):
        gradient.copy_(part.view_as(gradient))


def _accelerate() -> Any:
    try:
        return importlib.import_module("accelerate")
    except ImportError:
        raise InputError(
            "accelerate", "package", "is not installed, and several processes were started",
            "pip install 'recast-sim[distributed]'",
        ) from None  # fmt: skip
