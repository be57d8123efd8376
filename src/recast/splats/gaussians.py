"""3D Gaussians as a struct of arrays: their colours, rotations and order in memory.

Colours are real spherical harmonics up to degree 3, rotations are quaternions; both turn with the
Gaussians.

Order and signs of the harmonics are those of 3D Gaussian splatting (Kerbl et al. 2023): band l
holds the 2l + 1 functions m = -l..l, with the Condon-Shortley sign on odd m.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from torch import Tensor

MAX_DEGREE = 3
C0 = 0.28209479177387814
C1 = 0.4886025119029199

LOG_SCALES = (-60.0, 14.0)
"""Log scales lie between these: beyond, areas in the image leave the range of float32."""
QUAT_NORMS = (1e-15, 1e15)
"""Norms of quaternions lie between these, so that their squares stay in the range of float32."""
LARGEST = 1e15
"""No centre, logit or coefficient is larger: sums of products stay in the range of float32."""
_RANGES = {
    "means": (-LARGEST, LARGEST),
    "quats": QUAT_NORMS,
    "log_scales": LOG_SCALES,
    "logit_opacities": (-LARGEST, LARGEST),
    "sh": (-LARGEST, LARGEST),
}
_BITS = 20
_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
_C3 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
    1.445305721320277,
)


@dataclass(frozen=True)
class Gaussians:
    """N anisotropic 3D Gaussians with opacity and view-dependent colour.

    Attributes:
        means: (N, 3) centres, metres.
        quats: (N, 4) wxyz, normalised on use.
        log_scales: (N, 3) natural log of the standard deviations along the rotated axes.
        logit_opacities: (N,) opacity before the sigmoid.
        sh: (N, K, 3) spherical-harmonic colour coefficients, K = (degree + 1)^2; the colour is
            max(eval + 0.5, 0).
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    logit_opacities: Tensor
    sh: Tensor

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def sh_degree(self) -> int:
        """Degree of the harmonics: 0 for a colour that does not depend on the view."""
        return round(self.sh.shape[1] ** 0.5) - 1

    def expected_shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape that each field must have beside the others."""
        n = self.means.shape[0] if self.means.ndim else 0
        return {
            "means": (n, 3),
            "quats": (n, 4),
            "log_scales": (n, 3),
            "logit_opacities": (n,),
            "sh": (n, (self.sh_degree + 1) ** 2 if self.sh.ndim == 3 else 1, 3),
        }

    def fault(self) -> tuple[str, str] | None:
        """The field at fault and what is wrong with it; None if the rasterizer takes them all.

        Shapes and types come first, then values that are not finite or out of range (`LOG_SCALES`,
        `QUAT_NORMS`, `LARGEST`), of which the first row is named.
        """
        for name, shape in self.expected_shapes().items():
            value: Tensor = getattr(self, name)
            if tuple(value.shape) != shape:
                return name, f"shape {tuple(value.shape)}, expected {shape}"
            if not value.is_floating_point():
                return name, f"dtype {value.dtype}, expected floating point"
        if self.sh_degree > MAX_DEGREE:
            return "sh", f"degree {self.sh_degree}, expected {MAX_DEGREE} at most"
        for name, (low, high) in _RANGES.items():
            bad = (~self._within(name)).nonzero()
            if len(bad):
                row = int(bad[0, 0])
                if not bool(getattr(self, name)[row].isfinite().all()):
                    return name, f"row {row} is not finite"
                what = "has a norm" if name == "quats" else "is"
                return name, f"row {row} {what} out of {low:g}..{high:g}"
        return None

    def in_range(self) -> Tensor:
        """Whether all values are in range: () bool, where the Gaussians lie, so without waiting."""
        return torch.stack([self._within(name).all() for name in _RANGES]).all()

    def _within(self, name: str) -> Tensor:
        """(N,) bool: rows of a field that are finite and in range."""
        value: Tensor = getattr(self, name).detach()
        low, high = _RANGES[name]
        size = value.norm(dim=1) if name == "quats" else value
        good = (size > low) & (size < high)  # of NaN neither is true
        return good.flatten(1).all(dim=1) if good.ndim > 1 else good

    def validate(self) -> None:
        """Raise ValueError naming the field at fault, see `fault`."""
        fault = self.fault()
        if fault is not None:
            raise ValueError(f"Gaussians.{fault[0]}: {fault[1]}")

    def select(self, index: Tensor) -> Gaussians:
        """The Gaussians at `index`: (M,) int64 or a (N,) bool mask."""
        return self._map(lambda value: value[index])

    def detach(self) -> Gaussians:
        """The same values without gradient history."""
        return self._map(Tensor.detach)

    def with_centres(self, double: bool) -> Gaussians:
        """The same Gaussians with centres of float64 or float32."""
        return replace(self, means=self.means.double() if double else self.means.float())

    def to(self, device: torch.device | str) -> Gaussians:
        """The same values on another device."""
        return self._map(lambda value: value.to(device))

    def _map(self, change: Callable[[Tensor], Tensor]) -> Gaussians:
        return Gaussians(*(change(getattr(self, name)) for name in _RANGES))

    def transformed(self, world_from_local: Tensor, scale: float = 1.0) -> Gaussians:
        """The Gaussians moved to another frame, their colours turning with them.

        Centres may be float64 beside fields of float32, so that they can be moved from far away.

        Args:
            world_from_local: (4, 4) rigid transform.
            scale: isotropic factor applied in the local frame before the transform.

        Returns:
            Gaussians with x_world = R (scale x) + t; differentiable in the Gaussians and the pose.

        Raises:
            ValueError: `world_from_local` is not rigid, or `scale` is not positive.
        """
        # A pose is small: it is worked on where it lies, so that no accelerator is waited for.
        pose = world_from_local.to(self.means.dtype)
        rotation, translation = pose[:3, :3], pose[:3, 3]
        with torch.no_grad():
            error = (rotation @ rotation.T - torch.eye(3).to(pose)).abs().max()
            if not (error < 1e-3 and torch.linalg.det(rotation) > 0):
                raise ValueError("Gaussians.transformed: world_from_local is not a rigid transform")
        if not scale > 0:
            raise ValueError(f"Gaussians.transformed: scale {scale}, expected a positive number")
        turn = left_matrix(matrix_to_quat(rotation)).to(self.quats)
        device = self.means.device
        return Gaussians(
            means=torch.addmm(translation.to(device), self.means, scale * rotation.T.to(device)),
            quats=self.quats @ turn.T,
            log_scales=self.log_scales if scale == 1 else self.log_scales + math.log(scale),
            logit_opacities=self.logit_opacities,
            sh=rotate_harmonics(self.sh, rotation.to(self.sh.dtype)),
        )


def concatenate(parts: Sequence[Gaussians]) -> Gaussians:
    """All Gaussians of `parts` in order; harmonics are padded with zeros to the largest degree.

    Raises:
        ValueError: `parts` is empty.
    """
    if not parts:
        raise ValueError("concatenate: no Gaussians given")
    width = max(part.sh.shape[1] for part in parts)
    padded = [
        replace(part, sh=torch.nn.functional.pad(part.sh, (0, 0, 0, width - part.sh.shape[1])))
        for part in parts
    ]
    return Gaussians(*(torch.cat([getattr(part, name) for part in padded]) for name in _RANGES))


def harmonic_basis(directions: Tensor, degree: int) -> Tensor:
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


def evaluate_harmonics(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Colours (..., C) of `coefficients` (..., K, C) seen along unit `directions` (..., 3)."""
    degree = round(coefficients.shape[-2] ** 0.5) - 1
    return torch.einsum("...k,...kc->...c", harmonic_basis(directions, degree), coefficients)


@lru_cache(maxsize=MAX_DEGREE + 1)
def _harmonic_probe(degree: int) -> tuple[Tensor, Tensor]:
    """Fixed directions (M, 3), and the pseudo-inverse (2l + 1, M) of band l = `degree` at them."""
    count = 24
    # A Fibonacci spiral: even enough that every band up to 3 is well conditioned on it.
    index = torch.arange(count, dtype=torch.float64)
    z = 1 - (2 * index + 1) / count
    azimuth = index * (torch.pi * (3 - 5**0.5))
    radius = (1 - z * z).sqrt()
    directions = torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), z], dim=-1)
    band = harmonic_basis(directions, degree)[:, degree * degree :]
    return directions, torch.linalg.pinv(band)


def harmonic_rotations(rotation: Tensor, degree: int) -> list[Tensor]:
    """Matrices D_l (2l + 1, 2l + 1), l = 0..degree, with B_l(R d) = D_l B_l(d) for all d.

    A band is closed under rotation, so D_l follows from its values at enough fixed directions P:
    B_l(P R^T) = B_l(P) D_l^T, solved by the constant pseudo-inverse of B_l(P). Exact to rounding
    and differentiable in `rotation` (3, 3).
    """
    blocks = [rotation.new_ones(1, 1)]
    for band in range(1, degree + 1):
        directions, inverse = (part.to(rotation) for part in _harmonic_probe(band))
        moved = harmonic_basis(directions @ rotation.T, band)[:, band * band :]
        blocks.append((inverse @ moved).T)
    return blocks


def rotate_harmonics(coefficients: Tensor, rotation: Tensor) -> Tensor:
    """Coefficients (N, K, C) of the same colour field turned by `rotation` (3, 3).

    evaluate_harmonics(rotate_harmonics(sh, R), R d) equals evaluate_harmonics(sh, d).
    """
    degree = round(coefficients.shape[-2] ** 0.5) - 1
    blocks = harmonic_rotations(rotation.to(coefficients.dtype), degree)
    # D is orthogonal: the basis turns by D, so the coefficients turn by D^-T = D. One product of
    # matrices for all bands and channels: many small ones cost several times that.
    channels = torch.eye(coefficients.shape[-1]).to(blocks[0])
    turn = torch.kron(torch.block_diag(*blocks), channels)
    turned = coefficients.flatten(1) @ turn.T.to(coefficients.device)
    return turned.view(coefficients.shape)


def quat_to_matrix(quats: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz, normalised first."""
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True)).unbind(-1)
    entries = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return torch.stack(entries, dim=-1).unflatten(-1, (3, 3))


def quat_multiply(left: Tensor, right: Tensor) -> Tensor:
    """Hamilton product (..., 4) of wxyz quaternions: the rotation `right`, then `left`."""
    a, b, c, d = left.unbind(-1)
    w, x, y, z = right.unbind(-1)
    product = [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]
    return torch.stack(product, dim=-1)


def left_matrix(quat: Tensor) -> Tensor:
    """(4, 4) matrix of the product with a quaternion (4,) wxyz from the left."""
    a, b, c, d = quat.unbind()
    return torch.stack([a, -b, -c, -d, b, a, -d, c, c, d, a, -b, d, -c, b, a]).view(4, 4)


def _quat_table() -> Tensor:
    """(16, 9): by the nine entries of a rotation, 4 q q^T - I of its quaternion, row by row."""
    rows = (
        *("+0+4+8", "+7-5", "+2-6", "+3-1"),
        *("+7-5", "+0-4-8", "+1+3", "+2+6"),
        *("+2-6", "+1+3", "-0+4-8", "+5+7"),
        *("+3-1", "+2+6", "+5+7", "-0-4+8"),
    )
    table = torch.zeros(16, 9)
    for row, terms in zip(table, rows, strict=True):
        for sign, entry in zip(terms[::2], terms[1::2], strict=True):
            row[int(entry)] = float(sign + "1")
    return table


_QUAT_TABLE = _quat_table()


def matrix_to_quat(rotation: Tensor) -> Tensor:
    """Unit quaternion (4,) wxyz of one rotation matrix (3, 3), differentiable.

    Of the four equivalent formulas the one with the largest square root is taken (Shepperd 1978).
    """
    # All four times each component, a row: linear in the entries but for the diagonal's 1.
    table = torch.eye(4).to(rotation) + (_QUAT_TABLE.to(rotation) @ rotation.reshape(9)).view(4, 4)
    quat = table[int(table.detach().diagonal().argmax())]
    return quat / quat.norm()


def morton_order(means: Tensor) -> Tensor:
    """Index (N,) int64 that sorts points (N, 3) along a Morton (Z-order) curve; stable.

    The rasterizer works in any order, but is faster in this one: reorder a scene once after it was
    initialised or densified (`gaussians.select(morton_order(gaussians.means))`).
    """
    if len(means) == 0:
        return torch.zeros(0, dtype=torch.int64, device=means.device)
    points = means.detach().double()
    low = points.amin(dim=0)
    # One scale for all axes: cells must be cubes for the curve to keep neighbours together.
    size = (points.amax(dim=0) - low).max().clamp(min=1e-12)
    cells = ((points - low) / size * (2**_BITS - 1)).long()
    code = torch.zeros(len(means), dtype=torch.int64, device=means.device)
    for axis in range(3):
        code |= _spread(cells[:, axis]) << axis
    return code.argsort(stable=True)


def _spread(value: Tensor) -> Tensor:
    """Put two zero bits between the bits of values below 2^20."""
    value = (value | value << 32) & 0x1F00000000FFFF
    value = (value | value << 16) & 0x1F0000FF0000FF
    value = (value | value << 8) & 0x100F00F00F00F00F
    value = (value | value << 4) & 0x10C30C30C30C30C3
    return (value | value << 2) & 0x1249249249249249


# Gaussians as most interchange formats hold them: deviations and opacities instead of logarithms.
#
# float32 to float32, so the log scale of what comes back is off by two roundings of its size and
# one of the deviation's; an opacity by a few units of 2^-24. Of an opacity nearer to 1 than that,
# the logit is not kept; the nearest number below 1 stands for it.

_LEAST_OPACITY, _MOST_OPACITY = 1e-38, 1 - 2**-24
_INSIDE = 1e-4  # the ends of LOG_SCALES do not belong to it


def to_linear(gaussians: Gaussians) -> tuple[Tensor, Tensor, Tensor]:
    """Unit quaternions (N, 4) wxyz, standard deviations (N, 3) in metres and opacities (N,)."""
    quats = gaussians.quats / gaussians.quats.norm(dim=1, keepdim=True)
    return quats, gaussians.log_scales.exp(), gaussians.logit_opacities.sigmoid()


def from_linear(
    means: Tensor, quats: Tensor, deviations: Tensor, opacities: Tensor, sh: Tensor
) -> Gaussians:
    """The Gaussians of `to_linear`; deviations and opacities of 0, and opacities of 1, are allowed.

    Others out of range become fields that are not finite, which `Gaussians.fault` names.
    """
    log_scales = torch.where(deviations == 0, LOG_SCALES[0], deviations.log())
    least, most = LOG_SCALES[0] + _INSIDE, LOG_SCALES[1] - _INSIDE
    inside = (opacities >= 0) & (opacities <= 1)
    clamped = opacities.clamp(_LEAST_OPACITY, _MOST_OPACITY).logit()
    return Gaussians(
        means=means,
        quats=quats,
        # What rounding or a flat Gaussian puts on an end of the range, not what lies far beyond it.
        log_scales=torch.where(
            (log_scales >= LOG_SCALES[0] - 1) & (log_scales <= LOG_SCALES[1] + _INSIDE),
            log_scales.clamp(least, most),
            log_scales,
        ),
        logit_opacities=torch.where(inside, clamped, torch.nan),
        sh=sh,
    )
