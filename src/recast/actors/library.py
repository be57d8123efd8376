"""The generator `library:FOLDER`: those of a user's vehicles that look most like the observed one.

Retrieval instead of generation, as in HUGSIM (Zhou et al. 2024), which inserts scanned vehicles of
3DRealCar, and MADrive (Karpikova et al. 2025), which finds look-alikes in MAD-Cars by embeddings of
images and by colour. Two passes: all vehicles by size and mean colour, read once a process; then
the best few by silhouette and colours as they stand in the observed box. Where there is a log, its
evidence chooses among the best of these (`candidates.choose`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike

from recast.actors.generate import AUTO, Asset, BaseGenerator, lengthwise_yaw
from recast.actors.icp import extent, fit_of
from recast.actors.insert import agree, draw_beside
from recast.actors.mesh_generator import read_triangles, sampled
from recast.actors.observation import Observation
from recast.actors.observe import MIN_LIDAR_POINTS
from recast.actors.place import box_misfit, stand_on_box, stood_up
from recast.actors.register import aligned
from recast.actors.vehicle_files import (
    VEHICLE_FILE,
    VEHICLE_SUFFIXES,
    holds_gaussians,
    is_actor_folder,
    is_vehicle_file,
    vehicle_generator,
)
from recast.arrays import Array
from recast.core.errors import InputError
from recast.pretrained import ClipImages, whole_picture
from recast.splats.formats import read_gaussians
from recast.splats.gaussians import C0

_LENGTH, _SPACING = 4.5, 0.1  # metres: enough of a mesh for a mean colour
_OPAQUE = 0.3
_GAINS = (0.3, 3.0)  # of the light, as where pictures are compared
LIBRARY = "library:"
"""What the name of such a generator begins with; the folder follows."""
CLIP_FOLDER = "clip"
"""Folder of a library with a CLIP model in the files of its Hugging Face repository."""

_COARSE = 0.03  # metres between points of meshes that are only compared
_NAMED = 5  # vehicles of a ranking, and files that were left out, that are told of
# What counts as one unit of cost: logs of width and height, mean colour, share of the LiDAR points
# that are not met, overlap, colours, cosine of CLIP.
_UNITS = {
    "size": 0.10,
    "paint": 0.10,
    "lidar": 0.06,
    "silhouette": 0.03,
    "colour": 0.02,
    "clip": 0.05,
}


@dataclass(frozen=True)
class Summary:
    """A vehicle in a few numbers."""

    # (2,) middle and shortest extent along the file's axes, over the longest: which axis points up
    # need not be known.
    proportions: Array
    paint: Array  # (3,) mean colour of the surface, linear light


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
        points, colours = _of_gaussians(path) if holds_gaussians(path) else _of_mesh(path)
    except InputError as error:
        return str(error)
    if len(points) == 0:
        return f"{path}: has no opaque surface"
    sides: Array = np.sort(extent(points))
    if not sides[0] > 0:
        return f"{path}: has no volume"
    return Summary(sides[1::-1] / sides[2], colours.mean(axis=0))


def _of_gaussians(path: Path) -> tuple[Array, Array]:
    """Points (N, 3) and linear colours (N, 3) of the opaque Gaussians."""
    gaussians = read_gaussians(path)
    opaque = gaussians.logit_opacities.sigmoid() > _OPAQUE
    colours = 0.5 + C0 * gaussians.sh[opaque, 0].double().numpy()
    return gaussians.means[opaque].double().numpy(), np.clip(colours, 0, 1) ** 2.2


def _of_mesh(path: Path) -> tuple[Array, Array]:
    """Points (N, 3) and linear colours (N, 3) of a coarse lattice."""
    _, samples, _ = sampled(read_triangles(path), _LENGTH, _SPACING)
    return samples.points, samples.albedo + samples.emission


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


@dataclass(frozen=True)
class Ranked:
    """A vehicle of the library and what speaks against it."""

    path: Path  # its file or folder
    # misfits by kind, 0 at best: size, paint, lidar, silhouette, colour, clip; see `_UNITS`.
    terms: dict[str, float]

    @property
    def cost(self) -> float:
        """Sum of the terms in units; less is better."""
        return sum(value / _UNITS[kind] for kind, value in self.terms.items())

    def explain(self) -> str:
        """Name, cost and terms."""
        terms = ", ".join(f"{kind} {value:.3f}" for kind, value in self.terms.items())
        return f"{self.path.name} {self.cost:.1f} ({terms})"


class LibraryGenerator(BaseGenerator):
    """Picks vehicles of a folder: PLY, GLB and OBJ files and actors' folders, one level deep.

    Args:
        folder: the library; `clip` in it may hold a CLIP model, whose image similarity then counts.
        axes: orientation of its files, see `recast.actors.axes_of`.
        tried: vehicles that are placed in the box, the best by size and mean colour.
        offered: number of the tried vehicles that `candidates` offers.

    Raises:
        InputError: no such folder, or no vehicle in it; CLIP's files are incomplete.
    """

    name = "library"

    def __init__(
        self, folder: str | Path, axes: str = AUTO, tried: int = 8, offered: int = 3
    ) -> None:
        self.folder, self.axes, self.tried, self.offered = Path(folder), axes, tried, offered
        if not self.folder.is_dir():
            raise InputError(folder, "folder", "is missing", f"check the path behind {LIBRARY}")
        self.vehicles = sorted(
            path for path in self.folder.iterdir() if is_vehicle_file(path) or is_actor_folder(path)
        )
        if not self.vehicles:
            raise self._none("holds no vehicle")
        if (self.folder / CLIP_FOLDER).is_dir():
            ClipImages.folder(self.folder / CLIP_FOLDER).check()

    def generate(self, observation: Observation, seed: int) -> Asset:
        """The best vehicle by one view.

        Raises:
            InputError: none can be read, or stood up in the box.
        """
        return self.candidates(observation, seed)[0]()

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """The best few, the best first; see `BaseGenerator.candidates`. Raises InputError: see
        `generate`."""
        ranking, left_out = self.rank(observation)
        told: dict[str, str | int] = {
            "ranking": "; ".join(one.explain() for one in ranking[:_NAMED]),
            "vehicles": len(self.vehicles),
        }
        if left_out:
            rest = len(left_out) - _NAMED
            more = f"; and {rest} more" if rest > 0 else ""
            told["left_out"] = "; ".join(left_out[:_NAMED]) + more
        return [
            partial(self._make, one, rank, told, observation, seed)
            for rank, one in enumerate(ranking[: self.offered], 1)
        ]

    def rank(self, observation: Observation) -> tuple[list[Ranked], list[str]]:
        """The best vehicles, the best first, and why others cannot be used. Raises InputError: see
        `generate`."""
        paint = seen_paint(observation)
        first: list[Ranked] = []
        left_out: list[str] = []
        for path in self.vehicles:
            found = summary_of(path)
            if isinstance(found, Summary):
                terms = {
                    "size": size_apart(found, observation.size),
                    "paint": paint_apart(found, paint),
                }
                first.append(Ranked(path, terms))
            else:
                left_out.append(found)
        placed: list[Ranked] = []
        for one in sorted(first, key=lambda one: (one.cost, one.path.name)):
            if len(placed) == self.tried:
                break
            try:
                placed.append(self._placed(one, observation))
            except InputError as error:
                left_out.append(str(error))
        if not placed:
            raise self._none(
                f"holds {len(self.vehicles)} vehicles, but none can be used: {left_out[0]}"
            )
        return sorted(placed, key=lambda one: (one.cost, one.path.name)), left_out

    def _placed(self, one: Ranked, observation: Observation) -> Ranked:
        """The vehicle with the terms of its place in the box, the better way round."""
        asset = vehicle_generator(one.path, self.axes, _COARSE).generate(observation, seed=0)
        gaussians, surface = stood_up(asset)
        lidar = np.asarray(observation.points, np.float64)
        yaws = [0.0]
        if not asset.axes.declares_front:
            first = lengthwise_yaw(surface.points[:, :2])
            yaws = [first, first + np.pi]
        found = []
        for yaw in yaws:
            start = stand_on_box(surface.points, yaw, observation.size)
            sides = extent(start.apply(surface).points)
            terms = one.terms | {"size": box_misfit(sides, observation.size)}
            if len(lidar) >= MIN_LIDAR_POINTS:
                start = aligned(surface, lidar, start, observation.size)
                fit = fit_of(start.apply(surface).points, lidar)
                terms["lidar"] = 1 - fit.inlier_share
            placed = gaussians.transformed(torch.from_numpy(start.matrix), start.scale)
            pictures = draw_beside(placed, asset.low_pass, observation)
            overlap, terms["colour"] = agree(pictures)
            terms["silhouette"] = 1 - overlap
            if self._clip is not None:
                seen = pictures.wanted * pictures.mask[..., None]
                terms["clip"] = 1 - _alike(self._clip, pictures.shown, seen)
            found.append(Ranked(one.path, terms))
        return min(found, key=lambda turned: turned.cost)

    def _make(
        self,
        one: Ranked,
        rank: int,
        told: dict[str, str | int],
        observation: Observation,
        seed: int,
    ) -> Asset:
        asset = vehicle_generator(one.path, self.axes).generate(observation, seed)
        details = {**asset.details, "read_by": asset.generator, "rank": rank, **told}
        return replace(asset, generator=self.name, details=details)

    @cached_property
    def _clip(self) -> ClipImages | None:
        folder = self.folder / CLIP_FOLDER
        return ClipImages.read(folder) if folder.is_dir() else None

    def _none(self, problem: str) -> InputError:
        mend = f"put *{', *'.join(VEHICLE_SUFFIXES)} or folders of actors into the folder"
        return InputError(self.folder, "vehicles", problem, mend)


def _alike(clip: ClipImages, first: Array, second: Array) -> float:
    """Cosine of CLIP's embeddings of two pictures (H, W, 3)."""
    one, other = (clip.embedding(whole_picture(clip.processor, p))[0] for p in (first, second))
    return float(one @ other / (one.norm() * other.norm()).clamp(min=1e-12))
