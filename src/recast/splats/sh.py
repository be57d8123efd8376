"""Real spherical harmonics up to degree 3: evaluation and rotation.

Order and signs are those of 3D Gaussian splatting (Kerbl et al. 2023): band l holds the 2l + 1
functions m = -l..l, with the Condon-Shortley sign on odd m.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

MAX_DEGREE = 3
C0 = 0.28209479177387814
C1 = 0.4886025119029199
_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
_C3 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
    1.445305721320277,
)


def basis(directions: Tensor, degree: int) -> Tensor:
    """The (degree + 1)^2 harmonics at unit `directions` (..., 3): (..., K). Raises ValueError:
    degree is not 0..3."""
    if not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"sh: degree {degree}, expected 0..{MAX_DEGREE}")
    x, y, z = directions.unbind(-1)
    terms = [torch.full_like(x, C0)]
    if degree >= 1:
        terms += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        terms += [
            _C2[0] * x * y,
            -_C2[0] * y * z,
            _C2[1] * (2 * zz - xx - yy),
            -_C2[0] * x * z,
            _C2[2] * (xx - yy),
        ]
    if degree >= 3:
        terms += [
            -_C3[0] * y * (3 * xx - yy),
            _C3[1] * x * y * z,
            -_C3[2] * y * (4 * zz - xx - yy),
            _C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -_C3[2] * x * (4 * zz - xx - yy),
            _C3[4] * z * (xx - yy),
            -_C3[0] * x * (xx - 3 * yy),
        ]
    return torch.stack(terms, dim=-1)


def evaluate(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Colours (..., C) of `coefficients` (..., K, C) seen along unit `directions` (..., 3)."""
    degree = round(coefficients.shape[-2] ** 0.5) - 1
    return torch.einsum("...k,...kc->...c", basis(directions, degree), coefficients)


@lru_cache(maxsize=MAX_DEGREE + 1)
def _probe(degree: int) -> tuple[Tensor, Tensor]:
    """Fixed directions (M, 3), and the pseudo-inverse (2l + 1, M) of band l = `degree` at them."""
    count = 24
    # A Fibonacci spiral: even enough that every band up to 3 is well conditioned on it.
    index = torch.arange(count, dtype=torch.float64)
    z = 1 - (2 * index + 1) / count
    azimuth = index * (torch.pi * (3 - 5**0.5))
    radius = (1 - z * z).sqrt()
    directions = torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), z], dim=-1)
    band = basis(directions, degree)[:, degree * degree :]
    return directions, torch.linalg.pinv(band)


def rotation_blocks(rotation: Tensor, degree: int) -> list[Tensor]:
    """Matrices D_l (2l + 1, 2l + 1), l = 0..degree, with B_l(R d) = D_l B_l(d) for all d.

    A band is closed under rotation, so D_l follows from its values at enough fixed directions P:
    B_l(P R^T) = B_l(P) D_l^T, solved by the constant pseudo-inverse of B_l(P). Exact to rounding
    and differentiable in `rotation` (3, 3).
    """
    blocks = [rotation.new_ones(1, 1)]
    for band in range(1, degree + 1):
        directions, inverse = (part.to(rotation) for part in _probe(band))
        moved = basis(directions @ rotation.T, band)[:, band * band :]
        blocks.append((inverse @ moved).T)
    return blocks


def rotate(coefficients: Tensor, rotation: Tensor) -> Tensor:
    """Coefficients (N, K, C) of the same colour field turned by `rotation` (3, 3).

    evaluate(rotate(sh, R), R d) equals evaluate(sh, d).
    """
    degree = round(coefficients.shape[-2] ** 0.5) - 1
    blocks = rotation_blocks(rotation.to(coefficients.dtype), degree)
    # D is orthogonal: the basis turns by D, so the coefficients turn by D^-T = D. One product of
    # matrices for all bands and channels: many small ones cost several times that.
    channels = torch.eye(coefficients.shape[-1]).to(blocks[0])
    turn = torch.kron(torch.block_diag(*blocks), channels)
    turned = coefficients.flatten(1) @ turn.T.to(coefficients.device)
    return turned.view(coefficients.shape)
