"""Files of Gaussians by their format: 3DGS PLY, glTF, and those that other packages add.

A format is an entry point of the group `recast.splat_formats`, which names a `SplatFormat`.

Programs take a file's axes for those of its format. What is written is turned into them, and back
when it is read, harmonics included; here x is forward, y left and z up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.gltf_file import (
    LONGEST_GLB,
    POINTS,
    GlbFile,
    GltfPart,
    Primitive,
    placed_primitives,
    write_glb,
)
from recast.core.plugins import entry_points, splat_formats
from recast.geometry import se3
from recast.splats import ply
from recast.splats.gaussians import C0, MAX_DEGREE, Gaussians, concatenate, from_linear, to_linear
from recast.splats.rasterization import LowPass, parse_low_pass

# Gaussians in glTF 2.0 with the extension KHR_gaussian_splatting, as one binary file (GLB).
#
# Khronos, extensions/2.0/Khronos/KHR_gaussian_splatting. Everything is float32, so that nothing but
# rounding is lost: standard deviations and opacities are stored as such, not as log and logit. The
# axes are those of glTF: y up, and z forward for vehicles.

EXTENSION = "KHR_gaussian_splatting"
_FLOAT, _BYTE, _VERTICES = 5126, 5121, 34962
MOST_GAUSSIANS = 10_000_000
"""Gaussians of a file, at most; its parts may share arrays, so its size alone bounds nothing."""
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
    """Whether a GLB draws Gaussians; it may draw triangles too. Raises InputError: no whole GLB."""
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
    """The filter that `write_gltf` told; None if the file tells none. Raises InputError: no whole
    GLB, or what it tells is no filter."""
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


Write = Callable[[str | Path, Gaussians, LowPass | None], None]


@dataclass(frozen=True)
class SplatFormat:
    """A format of files of Gaussians."""

    name: str  # name of the format in commands
    suffix: str  # end of a file's name, in lower case
    # write, read, low_pass: its functions, in the axes of the format. `read` takes the path and
    # `double`, see `read_gaussians`.
    write: Write
    read: Callable[..., Gaussians]
    low_pass: Callable[[str | Path], LowPass | None]
    # directions of x (forward), y (left) and z (up) in the format's axes, (3, 3) row by row; None
    # if they are the same.
    axes: NDArray[np.float64] | None = None
    contents: str = ""  # what the files hold, one sentence for who reads them elsewhere


PLY = SplatFormat(
    "ply",
    ".ply",
    ply.write_ply,
    ply.read_ply,
    ply.read_low_pass,
    contents="PLY of 3D Gaussian splatting: x y z, f_dc and f_rest (real harmonics, channel by "
    "channel; colour = max(0.5 + sum, 0)), opacity (logit), scale (natural log of standard "
    "deviations), rot (quaternion w x y z, not normalised)",
)
GLTF = SplatFormat(
    "gltf",
    ".glb",
    write_gltf,
    read_gltf,
    read_low_pass,
    np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),  # z forward, y up
    "glTF 2.0, KHR_gaussian_splatting; turned: world and actor (x, y, z) = file (z, x, y)",
)


@cache
def formats() -> dict[str, SplatFormat]:
    """All installed formats by name."""
    entries = entry_points("recast.splat_formats")
    return {name: entries[name].load() for name in splat_formats()}


def splat_suffixes() -> tuple[str, ...]:
    """Ends of the names of files of Gaussians, in lower case."""
    return tuple(one.suffix for one in formats().values())


def format_named(name: str) -> SplatFormat:
    """The format of a name. Raises InputError: it is not installed."""
    if name not in formats():
        names = ", ".join(formats())
        raise InputError("format", name, "is not known", f"choose one of {names}")
    return formats()[name]


def format_of(path: str | Path) -> SplatFormat:
    """The format of a file by its name. Raises InputError: the name ends otherwise."""
    suffix = Path(path).suffix.lower()
    for one in formats().values():
        if suffix == one.suffix:
            return one
    known = ", ".join(splat_suffixes())
    raise InputError(path, "format", f"{suffix!r} is unknown", f"use {known}")


def write_gaussians(
    path: str | Path, gaussians: Gaussians, low_pass: LowPass | None = None
) -> None:
    """Write Gaussians in the format that the name tells, turned into its axes.

    Args:
        gaussians: x forward, y left, z up, metres.
        low_pass: the filter that they were made for, declared as far as the format can.

    Raises:
        ValueError: a field is not valid.
        InputError: the name tells no format, they do not fit into it, or the disk refuses.
    """
    one = format_of(path)
    one.write(path, _turned(gaussians, one.axes), low_pass)


def read_gaussians(path: str | Path, double: bool = False) -> Gaussians:
    """Read Gaussians of any format, turned from its axes: x forward, y left, z up.

    Args:
        double: whether centres are float64, as exact as the file has them. Coordinates far from the
            origin, such as UTM, must be moved before they are rounded to float32.

    Raises:
        InputError: the name tells no format, or the file is missing or broken.
    """
    one = format_of(path)
    return _turned(one.read(path, double), None if one.axes is None else one.axes.T)


def _turned(gaussians: Gaussians, axes: NDArray[np.float64] | None) -> Gaussians:
    """Gaussians whose x, y and z become the rows of `axes`; None leaves them."""
    if axes is None:
        return gaussians
    pose = se3.from_rotation_translation(axes.T, np.zeros(3))
    return gaussians.transformed(torch.from_numpy(pose))
