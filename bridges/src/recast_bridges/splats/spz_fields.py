"""The numbers of SPZ files: 24 bits for a coordinate, 8 for all else, 32 for a rotation.

With b fractional bits, a position is at most 2^-(b + 1) metres off (0.12 mm at the usual 12 bits),
an opacity 1/510, f_dc 1/76.5, a log scale 1/32; harmonics 4.5/128 (degree 1) and 8.5/128 (above).
The three smallest components of a quaternion are at most 1/1445 off. Numbers beyond a field's range
are clipped, as the format's own library does: f_dc beyond +-3.33, log scales beyond -10 and 5.94,
harmonics beyond -1 and 127/128.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.splats.gaussians import Gaussians

Bytes = NDArray[np.uint8]

COLOUR_SCALE, SCALE_OFFSET, SCALE_STEPS, SH_STEPS = 0.15, 10.0, 16.0, 128.0
SH_BUCKETS = (8, 16)
"""Steps of 1/128 that one stored value stands for: degree 1, and above."""
MOST_COMPONENT, COMPONENT_STEPS = 0.5**0.5, 511
"""Of a quaternion's three smallest components, and the steps up to it."""


def packed(gaussians: Gaussians, bits: int) -> list[bytes]:
    """Positions, opacities, colours, scales, rotations and harmonics of N Gaussians on the CPU.

    Args:
        bits: fractional bits of positions, which must fit.
    """
    fixed = (gaussians.means.double() * 2**bits).round().to(torch.int32).numpy()
    positions = fixed.astype("<i4")[..., None].view(np.uint8)[..., :3]
    sh = gaussians.sh.double()
    parts = [
        torch.from_numpy(positions.copy()),
        _byte(gaussians.logit_opacities.double().sigmoid() * 255),
        _byte(sh[:, 0] * (COLOUR_SCALE * 255) + 127.5),
        _byte((gaussians.log_scales.double() + SCALE_OFFSET) * SCALE_STEPS),
        torch.from_numpy(_smallest_three(gaussians.quats.double())),
        torch.cat([_bucketed(sh[:, 1:4], SH_BUCKETS[0]), _bucketed(sh[:, 4:], SH_BUCKETS[1])], 1),
    ]
    return [part.numpy().tobytes() for part in parts]


def _byte(values: Tensor) -> Tensor:
    return values.round().clamp(0, 255).to(torch.uint8)


def _bucketed(sh: Tensor, bucket: int) -> Tensor:
    steps = (sh * SH_STEPS).round() + SH_STEPS
    return _byte(((steps + bucket // 2) / bucket).floor() * bucket)


def _smallest_three(quats: Tensor) -> Bytes:
    """(N, 4) bytes of quaternions (N, 4) wxyz: index of the largest, sign and size of the rest."""
    xyzw = (quats / quats.norm(dim=1, keepdim=True)).roll(-1, 1).numpy()
    largest = np.abs(xyzw).argmax(axis=1)
    flip = np.take_along_axis(xyzw, largest[:, None], 1)[:, 0] < 0
    code = largest.astype(np.uint32)
    for i in range(4):
        size = np.abs(xyzw[:, i]) / MOST_COMPONENT * COMPONENT_STEPS + 0.5
        own = ((xyzw[:, i] < 0) ^ flip).astype(np.uint32) << 9 | size.astype(np.uint32)
        code = np.where(largest == i, code, code << np.uint32(10) | own)
    return code.astype("<u4")[:, None].view(np.uint8)


def unpacked(rows: Sequence[Bytes], bits: int) -> Gaussians:
    """Gaussians of the fields of `packed`, (N, bytes) each; in version 2, rotations have 3."""
    position, opacity, colour, scale, rotation, sh = rows
    n = len(position)
    fixed = np.zeros((n, 3, 4), np.uint8)
    fixed[..., 1:] = position.reshape(n, 3, 3)
    # Half of a step from the ends keeps logits finite.
    shares = np.clip(opacity[:, 0] / 255, 0.25 / 255, 1 - 0.25 / 255)
    constant = (colour / 255 - 0.5) / COLOUR_SCALE
    rest = (sh.reshape(n, sh.shape[1] // 3, 3) - SH_STEPS) / SH_STEPS
    arrays = (
        (fixed.view("<i4")[..., 0] >> 8) * 0.5**bits,
        _of_code(rotation) if rotation.shape[1] == 4 else _first_three(rotation),
        scale / SCALE_STEPS - SCALE_OFFSET,
        np.log(shares / (1 - shares)),
        np.concatenate([constant[:, None], rest], axis=1),
    )
    return Gaussians(*(torch.from_numpy(array).float() for array in arrays))


def _first_three(code: Bytes) -> NDArray[np.float64]:
    """Quaternions wxyz of version 2: x, y, z in a byte each, w not negative."""
    xyz = code / 127.5 - 1
    w = np.sqrt(np.clip(1 - (xyz**2).sum(axis=1, keepdims=True), 0, None))
    return np.concatenate([w, xyz], axis=1)


def _of_code(code: Bytes) -> NDArray[np.float64]:
    """Quaternions wxyz of `_smallest_three`."""
    rest = np.ascontiguousarray(code).view("<u4").reshape(len(code)).copy()
    largest = rest >> 30
    xyzw = np.zeros((len(code), 4))
    for i in (3, 2, 1, 0):
        here = largest != i
        size = (rest & COMPONENT_STEPS) / COMPONENT_STEPS * MOST_COMPONENT
        xyzw[:, i] = np.where(here, np.where(rest >> 9 & 1, -size, size), 0)
        rest = np.where(here, rest >> 10, rest)
    missing = np.sqrt(np.clip(1 - (xyzw**2).sum(axis=1), 0, None))
    np.put_along_axis(xyzw, largest[:, None].astype(np.int64), missing[:, None], 1)
    return np.roll(xyzw, 1, axis=1)
