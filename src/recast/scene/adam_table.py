"""Adam for small tables of which every step touches a few rows: poses, sky cells."""

from __future__ import annotations

import torch
from torch import Tensor

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15


class AdamTable:
    """A parameter table with its own moments and step count a row (Kingma & Ba 2015).

    Attributes:
        value: (R, C) leaf tensor; rows without a gradient rest, moments and all.
    """

    def __init__(self, value: Tensor) -> None:
        self.value = value.detach().clone().requires_grad_()
        self._first = torch.zeros_like(value)
        self._second = torch.zeros_like(value)
        self._steps = value.new_zeros(value.shape[0], 1)

    def to(self, device: torch.device | str) -> None:
        """Move value and moments; `value` is another tensor then."""
        self.value = self.value.detach().to(device).requires_grad_()
        self._first, self._second = self._first.to(device), self._second.to(device)
        self._steps = self._steps.to(device)

    def step(self, lr: float | Tensor) -> None:
        """Move the rows that have a gradient, then forget it.

        Args:
            lr: step size, or one per column (C,).
        """
        gradient = self.value.grad
        if gradient is None:
            return
        rows = gradient.any(dim=1).nonzero()[:, 0]
        gradient = gradient[rows]
        steps = self._steps[rows] + 1
        first = torch.lerp(gradient, self._first[rows], BETA1)
        second = torch.lerp(gradient.square(), self._second[rows], BETA2)
        update = (first / (1 - BETA1**steps)) / ((second / (1 - BETA2**steps)).sqrt() + EPSILON)
        with torch.no_grad():
            self.value[rows] -= lr * update
        self._steps[rows], self._first[rows], self._second[rows] = steps, first, second
        self.value.grad = None

    def state_dict(self) -> dict[str, Tensor]:
        """Everything needed to go on, as plain tensors."""
        return {
            "value": self.value.detach(),
            "first": self._first,
            "second": self._second,
            "steps": self._steps,
        }

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Go on from `state_dict`."""
        with torch.no_grad():
            self.value.copy_(state["value"])
        self._first.copy_(state["first"])
        self._second.copy_(state["second"])
        self._steps.copy_(state["steps"])
