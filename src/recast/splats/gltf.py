"""Gaussians in glTF 2.0 with the extension KHR_gaussian_splatting, as one binary file (GLB).

Khronos, extensions/2.0/Khronos/KHR_gaussian_splatting. Everything is float32, so that nothing but
rounding is lost: standard deviations and opacities are stored as such, not as log and logit. The
axes are those of glTF: y up, and z forward for vehicles.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.gltf.file import LONGEST_GLB, GlbFile, write_glb
from recast.core.gltf.tree import POINTS, GltfPart, Primitive, placed_primitives
from recast.geometry import se3
from recast.splats.gaussians import Gaussians, concatenate
from recast.splats.linear import from_linear, to_linear
from recast.splats.low_pass import LowPass, parse_low_pass
from recast.splats.sh import C0, MAX_DEGREE

EXTENSION = "KHR_gaussian_splatting"
_FLOAT, _BYTE, _VERTICES = 5126, 5121, 34962
MOST_GAUSSIANS = 10_000_000
"""Of a file; its parts may share arrays, so that its size alone bounds nothing."""
_MEND = "export it again as plain glTF with KHR_gaussian_splatting"
_LOW_PASS = "recast_low_pass"  # in asset.extras


class GltfSplats(GltfPart):
    """The extension's members."""

    kernel: Literal["ellipse"]
    color_space: Literal["srgb_rec709_display"]
    projection: Literal["perspective"] = "perspective"


def write_gltf(path: str | Path, gaussians: Gaussians, low_pass: LowPass | None = None) -> None:
    """Write Gaussians as one primitive, whole or not at all.

    Args:
        gaussians: N of one or more, in the axes of the format.
        low_pass: the filter that they were made for, told in `asset.extras.recast_low_pass`.

    Raises:
        ValueError: a field is not valid.
        InputError: there are none or too many, or the disk refuses.
    """
    gaussians = gaussians.detach().to("cpu")
    gaussians.validate()
    n = len(gaussians)
    if n == 0:
        raise InputError(
            path,
            "Gaussians",
            "there are none, and glTF cannot hold an empty array",
            "leave this file out",
        )
    arrays = _arrays(gaussians)
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    start = 0
    for values in arrays.values():
        view = {"buffer": 0, "byteOffset": start, "byteLength": values.nbytes, "target": _VERTICES}
        start += values.nbytes
        views.append(view)
        kind = "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}"
        number = {"componentType": _FLOAT} if values.dtype.kind == "f" else _SHARE
        accessors.append({"bufferView": len(accessors), "count": n, "type": kind, **number})
    means = arrays["POSITION"]
    accessors[0] |= {"min": means.min(axis=0).tolist(), "max": means.max(axis=0).tolist()}
    splats = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    primitive = {
        "mode": POINTS,
        "attributes": {name: i for i, name in enumerate(arrays)},
        "extensions": {EXTENSION: splats},
    }
    extras = {} if low_pass is None else {"extras": {_LOW_PASS: low_pass.text()}}
    tree = {
        "asset": {"version": "2.0", "generator": "recast", **extras},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
    write_glb(path, tree, b"".join(values.tobytes() for values in arrays.values()))


_SHARE = {"componentType": _BYTE, "normalized": True}


def _arrays(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Attributes by name: little-endian float32, and the points' colours in bytes."""
    quats, deviations, opacity = to_linear(gaussians)
    arrays = {
        "POSITION": gaussians.means,
        f"{EXTENSION}:ROTATION": quats.roll(-1, 1),
        f"{EXTENSION}:SCALE": deviations,
        f"{EXTENSION}:OPACITY": opacity,
    }
    arrays |= {_coefficient(k): gaussians.sh[:, k] for k in range(gaussians.sh.shape[1])}
    found = {name: np.ascontiguousarray(v.numpy(), "<f4") for name, v in arrays.items()}
    # What is drawn of the points by programs that do not know the extension; linear, as all of
    # glTF's colours.
    linear = (gaussians.sh[:, 0] * C0 + 0.5).clamp(0, 1) ** 2.2
    points = torch.cat([linear, opacity[:, None]], dim=1)
    return found | {"COLOR_0": (points * 255).round().to(torch.uint8).numpy()}


def _coefficient(k: int) -> str:
    degree = int(k**0.5)
    return f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{k - degree * degree}"


def has_gaussians(path: str | Path) -> bool:
    """Whether a GLB draws Gaussians; it may draw triangles too.

    Raises:
        InputError: no whole GLB.
    """
    return any(EXTENSION in one.extensions for one, _, _ in placed_primitives(_opened(path)))


def read_gltf(path: str | Path, double: bool = False) -> Gaussians:
    """All Gaussians that a GLB draws, in its axes; nodes may move, turn and scale them.

    Args:
        double: whether centres are float64.

    Raises:
        InputError: no whole GLB, no Gaussians or of a kernel or colour space that is not read, a
            member that is missing or out of range, or a node that shears or mirrors.
    """
    file = _opened(path)
    drawn = [one for one in placed_primitives(file) if EXTENSION in one[0].extensions]
    counts = [_count(file, one, field) for one, _, field in drawn]
    if sum(counts) > MOST_GAUSSIANS:
        raise file.fault("accessors", f"draw {sum(counts)} Gaussians, more than {MOST_GAUSSIANS}")
    found = [_primitive(file, *one, n) for one, n in zip(drawn, counts, strict=True)]
    if not found:
        raise file.fault(EXTENSION, "is not in the file: it draws no Gaussians")
    gaussians = concatenate(found).with_centres(double)
    fault = gaussians.fault()
    if fault is not None:
        raise InputError(path, fault[0], fault[1], _MEND)
    return gaussians


def read_low_pass(path: str | Path) -> LowPass | None:
    """The filter that `write_gltf` told; None if the file tells none.

    Raises:
        InputError: no whole GLB, or what it tells is no filter.
    """
    extras = _opened(path).tree.asset.extras
    told = extras.get(_LOW_PASS) if isinstance(extras, dict) else None
    if told is None:
        return None
    return parse_low_pass(path, str(told))


def _opened(path: str | Path) -> GlbFile:
    return GlbFile(Path(path), LONGEST_GLB)


def _count(file: GlbFile, primitive: Primitive, field: str) -> int:
    """How many Gaussians a primitive has."""
    if primitive.mode != POINTS or "POSITION" not in primitive.attributes:
        raise file.fault(field, "is not made of points, or they have no POSITION")
    if primitive.indices is not None:
        raise file.fault(f"{field}.indices", "are not supported for Gaussians")
    index = primitive.attributes["POSITION"]
    return file.at(file.tree.accessors, index, f"{field}.POSITION").count


def _primitive(file: GlbFile, one: Primitive, pose: Array, field: str, n: int) -> Gaussians:
    """The N Gaussians of a primitive, placed."""
    file.extension(one, EXTENSION, GltfSplats)  # refuses other kernels and colour spaces
    prefix = f"{EXTENSION}:SH_"
    named = sum(name.startswith(prefix) for name in one.attributes)
    degree = round(named**0.5) - 1
    if (degree + 1) ** 2 != named or not 0 <= degree <= MAX_DEGREE:
        raise file.fault(f"{field}.attributes", f"have {named} harmonics, not whole degrees to 3")

    def rows(name: str, width: int) -> Tensor:
        if name not in one.attributes:
            raise file.fault(f"{field}.attributes", f"lack {name}")
        return torch.from_numpy(file.rows(one.attributes[name], f"{field}.{name}", (width,), n))

    gaussians = from_linear(
        rows("POSITION", 3).double(),
        rows(f"{EXTENSION}:ROTATION", 4).roll(1, 1),
        rows(f"{EXTENSION}:SCALE", 3),
        rows(f"{EXTENSION}:OPACITY", 1)[:, 0],
        torch.stack([rows(_coefficient(k), 3) for k in range(named)], dim=1),
    )
    if np.array_equal(pose, np.eye(4)):
        return gaussians
    block = pose[:3, :3]
    scale = float(max(np.linalg.det(block), 0.0)) ** (1 / 3)
    if not np.allclose(block @ block.T, scale**2 * np.eye(3), 0, 1e-4 * scale**2) or scale == 0:
        raise file.fault("nodes", "shear, mirror, or scale unevenly, which is not supported")
    rigid = se3.from_rotation_translation(block / scale, pose[:3, 3])
    return gaussians.transformed(torch.from_numpy(rigid), scale)
