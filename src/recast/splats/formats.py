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

import numpy as np
import torch
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.core.plugins import entry_points, splat_formats
from recast.geometry import se3
from recast.splats import gltf, ply
from recast.splats.gaussians import Gaussians
from recast.splats.low_pass import LowPass

Write = Callable[[str | Path, Gaussians, LowPass | None], None]


@dataclass(frozen=True)
class SplatFormat:
    """A format of files of Gaussians.

    Attributes:
        name: name of the format in commands.
        suffix: end of a file's name, in lower case.
        write, read, low_pass: its functions, in the axes of the format. `read` takes the path and
            `double`, see `read_gaussians`.
        axes: directions of x (forward), y (left) and z (up) in the format's axes, (3, 3) row by
            row; None if they are the same.
        contents: what the files hold, one sentence for who reads them elsewhere.
    """

    name: str
    suffix: str
    write: Write
    read: Callable[..., Gaussians]
    low_pass: Callable[[str | Path], LowPass | None]
    axes: NDArray[np.float64] | None = None
    contents: str = ""


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
    gltf.write_gltf,
    gltf.read_gltf,
    gltf.read_low_pass,
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
    """The format of a name.

    Raises:
        InputError: it is not installed.
    """
    if name not in formats():
        names = ", ".join(formats())
        raise InputError("format", name, "is not known", f"choose one of {names}")
    return formats()[name]


def format_of(path: str | Path) -> SplatFormat:
    """The format of a file by its name.

    Raises:
        InputError: the name ends otherwise.
    """
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
