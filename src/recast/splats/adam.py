"""Adam that moves only the Gaussians a view has seen."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from typing import Literal

import torch
from torch import Tensor

from recast.kernel import AdamRows, AdamSettings, info, library

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15
_LANES = 16  # kAdamLanes of frame.hpp

Bounds = tuple[Tensor | float, Tensor | float]


class RowAdam:
    """Adam (Kingma & Ba 2015) on rows: those not visible keep value and moments as they are.

    The bias correction counts steps, not visits of a row. The values change in place, outside of
    autograd's sight. Moments lie where their parameters do.

    Args:
        params: leaf tensors (N, ...) by name, float32 and contiguous; their `.grad` is read.
        lrs: learning rates by name; a name without one needs it in every `step`.
        column_rates: factors of the learning rate within a row (shape of a row), by name.
        bounds: low and high bound, by name, that a value is clamped to after its step (each a
            number or the shape of a row).
        backend: "native" the compiled kernel (CPU), "foreach" a few operations on whole tensors
            that never wait for the device (CUDA), "reference" the readable one; "auto" what suits
            the parameters' device.

    Attributes:
        params: put new tensors here after `select` or `append`.
        steps: number of steps done.

    Raises:
        ValueError: numbers of rows differ, or a tensor has the wrong type, layout or device.
    """

    def __init__(
        self,
        params: Mapping[str, Tensor],
        lrs: Mapping[str, float],
        *,
        column_rates: Mapping[str, Tensor] | None = None,
        bounds: Mapping[str, Bounds] | None = None,
        backend: Literal["auto", "native", "foreach", "reference"] = "auto",
    ) -> None:
        self.params = dict(params)
        self.lrs = dict(lrs)
        self.steps = 0
        self._column_rates = dict(column_rates or {})
        self._bounds = dict(bounds or {})
        on_cpu = all(p.device.type == "cpu" for p in self.params.values())
        if backend == "auto":
            backend = ("native" if info().available else "reference") if on_cpu else "foreach"
        if backend == "native" and not on_cpu:
            raise ValueError("RowAdam: the compiled kernel takes parameters on the CPU")
        self._backend = backend
        self._patterns: dict[str, tuple[Tensor, Tensor, Tensor]] = {}
        self._first = {name: torch.zeros_like(p.detach()) for name, p in self.params.items()}
        self._second = {name: torch.zeros_like(p.detach()) for name, p in self.params.items()}
        if len({len(p) for p in self.params.values()}) > 1:
            sizes = {name: len(p) for name, p in self.params.items()}
            raise ValueError(f"RowAdam: numbers of rows differ: {sizes}")

    @torch.no_grad()
    def step(self, visible: Tensor, lrs: Mapping[str, float] | None = None) -> None:
        """Move the visible rows against their gradients.

        Parameters whose `.grad` is None stay, moments included.

        Args:
            visible: (N,) bool.
            lrs: learning rates of this step, in place of those given at the start.

        Raises:
            ValueError: a shape, type or layout is wrong.
        """
        self.steps += 1
        rates = {**self.lrs, **(lrs or {})}
        moved = [name for name, p in self.params.items() if p.grad is not None]
        for name in moved:
            self._check(name, visible)
        if not moved:
            return
        if self._backend == "native":
            self._step_native(moved, visible, rates)
        elif self._backend == "foreach":
            self._step_foreach(moved, visible, rates)
        else:
            for name in moved:
                self._step_reference(name, visible, rates[name])

    def _check(self, name: str, visible: Tensor) -> None:
        p = self.params[name]
        if p.dtype != torch.float32 or not p.is_contiguous():
            raise ValueError(f"RowAdam: {name}: expected contiguous float32, got {p.dtype}")
        if self._first[name].shape != p.shape:
            raise ValueError(
                f"RowAdam: {name}: shape {tuple(p.shape)}, "
                f"but its moments have {tuple(self._first[name].shape)}"
            )
        if visible.dtype != torch.bool or visible.shape != p.shape[:1]:
            raise ValueError(
                f"RowAdam: visible: {visible.dtype} {tuple(visible.shape)}, "
                f"expected bool ({p.shape[0]},)"
            )

    def _row_pattern(self, name: str) -> tuple[Tensor, Tensor, Tensor]:
        """Rate factors, low and high bounds, each of the shape of a row, beside the parameter."""
        if name not in self._patterns:
            p = self.params[name]
            low, high = self._bounds.get(name, (-math.inf, math.inf))
            factors = self._column_rates.get(name, 1.0)
            parts = (torch.as_tensor(part, dtype=torch.float32) for part in (factors, low, high))
            first, second, third = (part.to(p.device).expand(p.shape[1:]) for part in parts)
            self._patterns[name] = first, second, third
        return self._patterns[name]

    def _step_reference(self, name: str, visible: Tensor, rate: float) -> None:
        p = self.params[name]
        assert p.grad is not None
        gradient = p.grad[visible]
        first = BETA1 * self._first[name][visible] + (1 - BETA1) * gradient
        second = BETA2 * self._second[name][visible] + (1 - BETA2) * gradient.square()
        factors, low, high = self._row_pattern(name)
        mean = first / (1 - BETA1**self.steps)
        root = (second / (1 - BETA2**self.steps)).sqrt()
        value = p[visible] - rate * factors * mean / (root + EPSILON)
        p[visible] = value.clamp(low, high)
        self._first[name][visible] = first
        self._second[name][visible] = second

    def _step_foreach(self, moved: list[str], visible: Tensor, rates: Mapping[str, float]) -> None:
        params = [self.params[name] for name in moved]
        gradients = [p.grad.float() for p in params if p.grad is not None]
        firsts = [self._first[name] for name in moved]
        seconds = [self._second[name] for name in moved]
        masks = [visible.view(-1, *[1] * (p.ndim - 1)) for p in params]
        squares = torch._foreach_mul(gradients, gradients)
        # A share of 0 leaves a row's moments: no row is looked up, so that nothing need be counted.
        share1, share2 = (1 - BETA1) * visible, (1 - BETA2) * visible
        for first, second, gradient, square, mask in zip(
            firsts, seconds, gradients, squares, masks, strict=True
        ):
            first.lerp_(gradient, share1.view(mask.shape))
            second.lerp_(square, share2.view(mask.shape))
        roots = torch._foreach_sqrt(seconds)
        torch._foreach_mul_(roots, 1 / math.sqrt(1 - BETA2**self.steps))
        torch._foreach_add_(roots, EPSILON)
        updates = torch._foreach_div(firsts, roots)
        torch._foreach_mul_(updates, [-rates[name] / (1 - BETA1**self.steps) for name in moved])
        for name, p, update, mask in zip(moved, params, updates, masks, strict=True):
            factors, low, high = self._row_pattern(name)
            if name in self._column_rates:
                update.mul_(factors)
            value = update.add_(p)
            if name in self._bounds:
                value.clamp_(low, high)
            p.copy_(torch.where(mask, value, p))

    def _step_native(self, moved: list[str], visible: Tensor, rates: Mapping[str, float]) -> None:
        rows = (AdamRows * len(moved))()
        held = []
        for row, name in zip(rows, moved, strict=True):
            p = self.params[name]
            assert p.grad is not None
            gradient = p.grad.float().contiguous()
            factors, low, high = self._row_pattern(name)
            steps = factors * (rates[name] / (1 - BETA1**self.steps))
            patterns = [part.flatten().repeat(_LANES) for part in (steps, low, high)]
            held += [gradient, *patterns]
            row.value, row.gradient = p.data_ptr(), gradient.data_ptr()
            row.first, row.second = self._first[name].data_ptr(), self._second[name].data_ptr()
            row.steps, row.low, row.high = (pattern.data_ptr() for pattern in patterns)
            row.width = p[:1].numel()
        settings = AdamSettings(
            BETA1, BETA2, 1 - BETA1, 1 - BETA2, EPSILON, 1 / math.sqrt(1 - BETA2**self.steps)
        )
        mask = visible.contiguous()
        library().recast_adam(
            rows, len(moved), ctypes.byref(settings), mask.data_ptr(), mask.shape[0]
        )
        del held

    @property
    def moved(self) -> Tensor:
        """Rows (N,) bool that have moved since they came."""
        seconds = [m[:, None].flatten(1) for m in self._second.values()]
        return torch.cat(seconds, dim=1).any(dim=1)

    def select(self, index: Tensor) -> None:
        """Keep the moments of the rows at `index` ((M,) int64 or (N,) bool), in that order.

        The caller puts the new parameters into `params`.
        """
        self._first = {name: m[index] for name, m in self._first.items()}
        self._second = {name: m[index] for name, m in self._second.items()}

    def append(self, count: int) -> None:
        """Add `count` rows without history; the caller puts the new parameters into `params`."""
        for moments in (self._first, self._second):
            for name, m in moments.items():
                moments[name] = torch.cat([m, m.new_zeros(count, *m.shape[1:])])

    def forget(self, name: str) -> None:
        """Start one parameter's moments anew, for values that were set from outside."""
        self._first[name] = torch.zeros_like(self._first[name])
        self._second[name] = torch.zeros_like(self._second[name])

    def state_dict(self) -> dict[str, Tensor]:
        """Moments and step count as plain tensors: `first.NAME`, `second.NAME`, `steps`."""
        state = {"steps": torch.tensor(self.steps)}
        for name in self.params:
            state[f"first.{name}"] = self._first[name]
            state[f"second.{name}"] = self._second[name]
        return state

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Go on from `state_dict`. Raises KeyError: a parameter's moments are missing."""
        self.steps = int(state["steps"])
        for part, moments in (("first", self._first), ("second", self._second)):
            for name, p in self.params.items():
                moments[name] = state[f"{part}.{name}"].to(p.device, copy=True)
