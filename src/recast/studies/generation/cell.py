"""How a generated vehicle comes to stand in its box, and what a generation study keeps of it.

FOLDER/cell.json      scores of every view, or why there is none
FOLDER/features.npz   (V, D) float32 by name of the features
FOLDER/strip.png      the views side by side
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from PIL import Image as PilImage

from recast.actors import Asset, Observation
from recast.actors.icp import FitSurface, bounds
from recast.actors.place import place_asset, stood_up
from recast.arrays import Array, Image
from recast.core.array_files import read_npz
from recast.core.errors import InputError
from recast.core.files import atomic_folder, read_json, write_json
from recast.core.images import decode_image, rgb
from recast.geometry import se3
from recast.metrics.table import rounded
from recast.splats import Gaussians

Features = NDArray[np.float32]
Placement = Literal["views", "canonical"]
"""`views`: by the conditioning view, as `recast eval actor`; `canonical`: as the model says."""

_CELL, _FEATURES = "cell.json", "features.npz"
_MEMBERS = ("key", "id", "failure", "facts", "views", "scores")
"""Of cell.json."""


@dataclass(frozen=True)
class StudyCell:
    """One vehicle.

    Attributes:
        key: hash of all that decides the contents; another one makes the cell stale.
        facts: facts about how it was made and placed, plain values.
        views: names of the views it was looked at in.
        scores: scores of each view, by key of `STUDY_COLUMNS`; none for the truth.
        features: (V, D) features of the views, by name of the features.
        failure: reason why it could not be made; then there are no views.
    """

    key: str
    id: str
    facts: Mapping[str, Any]
    views: tuple[str, ...] = ()
    scores: tuple[Mapping[str, float], ...] = ()
    features: Mapping[str, Features] = field(default_factory=dict)
    failure: str | None = None


def write_cell(folder: Path, cell: StudyCell, pictures: Mapping[str, Image]) -> None:
    """Write a cell in place of what was there, whole or not at all.

    Args:
        pictures: images (H, W, 3) uint8 by name of the file, without ending.

    Raises:
        InputError: the disk is full.
    """
    if folder.exists():
        shutil.rmtree(folder)
    with atomic_folder(folder) as partial:
        record = {name: getattr(cell, name) for name in _MEMBERS}
        for name, picture in pictures.items():
            PilImage.fromarray(picture).save(partial / f"{name}.png", format="PNG")
        with (partial / _FEATURES).open("wb") as stream:
            arrays: dict[str, Any] = dict(cell.features)
            np.savez(stream, **arrays)
        write_json(partial / _CELL, rounded(record))


def cell_is(folder: Path, key: str) -> bool:
    """Whether there is a cell of that key."""
    if not (folder / _CELL).is_file():
        return False
    record = read_json(folder / _CELL)
    return isinstance(record, dict) and record.get("key") == key


def read_cell(folder: Path) -> StudyCell:
    """Read what `write_cell` wrote; InputError if it is missing or broken."""
    record = read_json(folder / _CELL)
    mend = "delete it and run again"
    try:
        plain = {name: record[name] for name in _MEMBERS}
        plain |= {name: tuple(plain[name]) for name in ("views", "scores")}
    except (KeyError, TypeError) as error:
        raise InputError(folder, "cell", f"cannot be read ({error})", mend) from None
    return StudyCell(**plain, features=read_npz(folder / _FEATURES, mend))


def read_strip(folder: Path, name: str = "strip") -> Image:
    """An image (H, W, 3) of a cell; InputError if it is missing or broken."""
    path = folder / f"{name}.png"
    mend = "delete its folder and run again"
    return rgb(decode_image(path, path, ("PNG",), mend=mend))


def place(
    asset: Asset, size: ArrayLike, observations: Sequence[Observation], how: Placement
) -> tuple[Gaussians, dict[str, Any]]:
    """Gaussians in the actor frame, and plain facts on how they were placed.

    Args:
        asset: asset from an `ActorGenerator`.
        size: (3,) length, width, height of the box, metres.
        observations: conditioning views with cameras; only `views` looks at them.
        how: see `Placement`.

    Raises:
        InputError: see `stood_up`.
    """
    if how == "views":
        placed = place_asset(asset, size, observations)
        return placed.gaussians, {"by": how, **asdict(placed.report)}
    return place_canonical(asset, size)


def place_canonical(asset: Asset, size: ArrayLike) -> tuple[Gaussians, dict[str, Any]]:
    """Believe the forward axis of the asset's convention; nothing is searched.

    Scaled so that its length is the box's, centred, and stood on the box's floor. It ends where
    its outermost Gaussians cover half, which is where masks end. For models that were trained to
    look along +x whatever they are shown: errors of a search do not blur the comparison then.

    Raises:
        InputError: see `stood_up`.
    """
    size = np.asarray(size, np.float64)
    gaussians, surface = stood_up(asset)
    low, high = _outline(gaussians, surface)
    scale = float(size[0] / (high[0] - low[0]))
    middle = (low + high) / 2 * scale
    shift = np.array([-middle[0], -middle[1], -size[2] / 2 - low[2] * scale])
    extent = (high - low) * scale
    facts = {
        "by": "canonical",
        "axes": asset.axes.name,
        "scale": scale,
        "width_over_box": float(extent[1] / size[1]),
        "height_over_box": float(extent[2] / size[2]),
    }
    matrix = se3.from_rotation_translation(np.eye(3), shift)
    return gaussians.transformed(torch.from_numpy(matrix), scale), facts


def _outline(gaussians: Gaussians, surface: FitSurface) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of where outer Gaussians alone cover half; strays left out.

    A Gaussian of opacity o covers half at sqrt(2 ln(o / 0.5)) deviations.
    """
    chosen = gaussians.select(torch.from_numpy(surface.index))
    opacity = torch.sigmoid(chosen.logit_opacities).double().numpy()
    radius = np.sqrt(2 * np.log(np.maximum(opacity / 0.5, 1.0)))
    axes = se3.quat_to_matrix(chosen.quats.double().numpy())
    deviations = np.exp(chosen.log_scales.double().numpy())
    along = np.sqrt(np.einsum("nij,nj->ni", axes**2, deviations**2))
    reach = radius[:, None] * along
    return bounds(surface.points - reach)[0], bounds(surface.points + reach)[1]
