"""What is kept of each vehicle of a library: proportions and mean colour, read once a process."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.actors.hull import bounds
from recast.actors.mesh import read_triangles
from recast.actors.mesh.generator import sampled
from recast.actors.observation import Observation
from recast.actors.store import VEHICLE_FILE
from recast.errors import InputError
from recast.splats import read_ply
from recast.splats.sh import C0

Array = NDArray[np.float64]

_LENGTH, _SPACING = 4.5, 0.1  # metres: enough of a mesh for a mean colour
_OPAQUE = 0.3
_GAINS = (0.3, 3.0)  # of the light, as where pictures are compared


@dataclass(frozen=True)
class Summary:
    """A vehicle in a few numbers.

    Attributes:
        proportions: (2,) middle and shortest extent along the file's axes, over the longest: which
            axis points up need not be known.
        paint: (3,) mean colour of the surface, linear light.
    """

    proportions: Array
    paint: Array


def summary_of(path: Path) -> Summary | str:
    """A vehicle's summary, or why it cannot be read; kept until the file changes."""
    file = path / VEHICLE_FILE if path.is_dir() else path
    try:
        stat = file.stat()
    except OSError as error:
        return f"{path}: {error.strerror}"
    return _read(file, stat.st_mtime_ns, stat.st_size)


@cache
def _read(path: Path, changed_ns: int, size: int) -> Summary | str:
    try:
        points, colours = _of_ply(path) if path.suffix.lower() == ".ply" else _of_mesh(path)
    except InputError as error:
        return str(error)
    if len(points) == 0:
        return f"{path}: nothing of it is opaque"
    extent: Array = np.sort(np.subtract(*bounds(points)[::-1]))
    if not extent[0] > 0:
        return f"{path}: has no volume"
    return Summary(extent[1::-1] / extent[2], colours.mean(axis=0))


def _of_ply(path: Path) -> tuple[Array, Array]:
    """Points (N, 3) and linear colours (N, 3) of the opaque Gaussians."""
    gaussians = read_ply(path)
    opaque = gaussians.logit_opacities.sigmoid() > _OPAQUE
    colours = 0.5 + C0 * gaussians.sh[opaque, 0].double().numpy()
    return gaussians.means[opaque].double().numpy(), np.clip(colours, 0, 1) ** 2.2


def _of_mesh(path: Path) -> tuple[Array, Array]:
    """Points (N, 3) and linear colours (N, 3) of a coarse lattice."""
    _, samples, _ = sampled(read_triangles(path), _LENGTH, _SPACING)
    return samples.points, samples.albedo


def seen_paint(observation: Observation) -> Array:
    """(3,) mean linear colour of the observed vehicle."""
    return np.mean((observation.rgba[observation.rgba[..., 3] > 127, :3] / 255.0) ** 2.2, axis=0)


def size_apart(summary: Summary, size: ArrayLike) -> float:
    """Sum of the logs by which the proportions differ from those of a box (3,)."""
    sides: Array = np.sort(np.asarray(size, np.float64))
    return float(np.abs(np.log(summary.proportions / (sides[1::-1] / sides[2]))).sum())


def paint_apart(summary: Summary, seen: Array) -> float:
    """Mean difference in display values to a linear colour (3,), after the light's best gain."""
    power = max(float(summary.paint @ summary.paint), 1e-9)
    gain = np.clip(float(summary.paint @ seen) / power, *_GAINS)
    shown, wanted = (np.clip(one, 0, 1) ** (1 / 2.2) for one in (gain * summary.paint, seen))
    return float(np.abs(shown - wanted).mean())
