"""The straight path from data (t = 0) to noise (t = 1) that all parts of the flow share."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

TIME_SCALE = 1000.0
"""The networks are given 1000 t."""

Velocity = Callable[[Tensor, Tensor, Tensor], Tensor]
"""`velocity(x, 1000 t, cond)`: x of any shape, times (B,) float32, conditions (B, L, C).

The result has the shape of x. A sparse network is closed over its coordinates, so that x is (T, C).
"""


def noise_scale(t: Tensor | float, sigma_min: float) -> Tensor | float:
    """Standard deviation sigma + (1 - sigma) t of the noise in x_t.

    x_t = (1 - t) x_0 + (sigma + (1 - sigma) t) eps, the path of optimal transport of Lipman et al.
    2023 ("Flow matching for generative modeling", section 4.1), with time reversed.
    """
    return sigma_min + (1 - sigma_min) * t


def data_from_velocity(x_t: Tensor, velocity: Tensor, t: float, sigma_min: float) -> Tensor:
    """x_0 of the path through `x_t` with `velocity`: (1 - sigma) x_t - (sigma + (1 - sigma) t) v.

    Exact where the velocity is (1 - sigma) eps - x_0.
    """
    return (1 - sigma_min) * x_t - noise_scale(t, sigma_min) * velocity
