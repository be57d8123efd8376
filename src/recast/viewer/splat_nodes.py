"""Gaussians, sky and map as a browser can draw them, and the nodes of a viser scene that hold them.

Each set of Gaussians is sent once, however many arms show it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np
import shapely
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.insert import coloured_by_shares
from recast.arrays import Array, Float32Array
from recast.geometry import se3
from recast.logs import HdMap
from recast.logs.hdmap import drivable_region
from recast.reporting.drawing import SHARES
from recast.scene import StreetScene
from recast.scene.sky import SkyMap
from recast.splats import Gaussians
from recast.splats.gaussians import evaluate_harmonics, quat_to_matrix
from recast.viewer.drives import ViewedDrive, ViewInputs

if TYPE_CHECKING:
    import viser


LARGEST_SIGMA = 250.0
"""Metres. viser stores covariances as float16, which ends at 65504, the square of 256 m."""
NEAREST = 3.0
"""Metres; what is nearer to the path counts as if it were this far."""
ACTOR_DISTANCE = 8.0
"""Metres at which actors are looked at, for their importance beside that of the street."""
SKY_RADIUS = 700.0
"""Metres; viser draws nothing beyond 1000 m."""
SKY_DISCS = 4000
_OVERLAP = 0.7  # standard deviation over the spacing of the centres
_RAISED = 0.06  # metres above the ground, so that splats of the road do not hide lines


@dataclass(frozen=True)
class BakedSplats:
    """N Gaussians with constant colours.

    Attributes:
        centres: (N, 3) float32 metres.
        covariances: (N, 3, 3) float32, all members within the range of float16.
        colours: (N, 3) float32 in [0, 1].
        opacities: (N, 1) float32 in [0, 1].
    """

    centres: Float32Array
    covariances: Float32Array
    colours: Float32Array
    opacities: Float32Array

    def __len__(self) -> int:
        return len(self.centres)


def baked(gaussians: Gaussians, eyes: Tensor) -> BakedSplats:
    """Gaussians with the colour that they have in the mean direction from which `eyes` see them.

    Standard deviations above `LARGEST_SIGMA` are cut to it.

    Args:
        gaussians: Gaussians in any frame.
        eyes: (E, 3) places of cameras in the same frame; none: along x.
    """
    with torch.no_grad():
        directions = mean_directions(gaussians.means, eyes)
        colours = (evaluate_harmonics(gaussians.sh, directions) + 0.5).clamp(0, 1)
        sigmas = gaussians.log_scales.exp().clamp(max=LARGEST_SIGMA)
        axes = quat_to_matrix(gaussians.quats) * sigmas[:, None, :]
        return BakedSplats(
            centres=gaussians.means.float().numpy(),
            covariances=(axes @ axes.transpose(1, 2)).float().numpy(),
            colours=colours.float().numpy(),
            opacities=torch.sigmoid(gaussians.logit_opacities)[:, None].float().numpy(),
        )


def mean_directions(points: Tensor, eyes: Tensor) -> Tensor:
    """Unit directions (N, 3) in which points (N, 3) are seen from eyes (E, 3), on average.

    An eye counts by one over its distance, so that the near ones, which see most, decide. Where
    directions cancel out, that of the nearest eye is taken.
    """
    if len(eyes) == 0:
        return torch.tensor([1.0, 0.0, 0.0]).to(points).expand_as(points)
    total = torch.zeros_like(points)
    nearest = torch.full((len(points), 1), float("inf")).to(points)
    fallback = torch.zeros_like(points)
    fallback[:, 0] = 1
    for eye in eyes.to(points):
        away = points - eye
        distance = away.norm(dim=1, keepdim=True).clamp(min=1e-3)
        total += away / distance**2
        fallback = torch.where(distance < nearest, away / distance, fallback)
        nearest = torch.minimum(nearest, distance)
    length = total.norm(dim=1, keepdim=True)
    found = torch.where(length > 1e-6, total / length.clamp(min=1e-6), fallback)
    return found / found.norm(dim=1, keepdim=True).clamp(min=1e-6)


def importance(gaussians: Gaussians, distances: Array) -> Array:
    """Opacity times the area of each Gaussian's largest section over its squared distance: (N,).

    Args:
        distances: (N,) metres to the path from which it is looked at; below `NEAREST`, that.
    """
    sigmas = gaussians.log_scales.detach().double().exp().sort(dim=1).values
    opacity = torch.sigmoid(gaussians.logit_opacities.detach().double())
    area = (opacity * sigmas[:, 1] * sigmas[:, 2]).numpy()
    return area / np.maximum(distances, NEAREST) ** 2


def path_distances(gaussians: Gaussians, path: Array) -> Array:
    """Metres (N,) from each centre to the nearest of the points (P, 3); `NEAREST` without any."""
    if len(path) == 0:
        return np.full(len(gaussians), NEAREST)
    distances, _ = cKDTree(path).query(gaussians.means.detach().double().numpy())
    return np.asarray(distances, np.float64)


def most_important(values: Sequence[Array], most: int) -> list[NDArray[np.int64]]:
    """Rows to keep of each of several arrays, `most` altogether, the most important ones.

    Rows stay in their order. Equal ones: the earlier array and row first.
    """
    sizes = [len(part) for part in values]
    if sum(sizes) <= most:
        return [np.arange(size) for size in sizes]
    ranking = np.argsort(-np.concatenate(values), kind="stable")[: max(most, 0)]
    kept = np.zeros(sum(sizes), bool)
    kept[ranking] = True
    starts = np.cumsum(sizes)[:-1]
    return [np.flatnonzero(part) for part in np.split(kept, starts)]


def sky_dome(
    sky: SkyMap, middle: Array, radius: float = SKY_RADIUS, count: int = SKY_DISCS
) -> BakedSplats:
    """Opaque discs on a sphere, in the colours of a sky map.

    Args:
        middle: (3,) centre of the sphere, metres.
        radius: radius of the sphere, metres.
        count: number of discs, evenly spread.
    """
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    azimuth = index * math.pi * (3 - math.sqrt(5))
    flat = np.sqrt(1 - z * z)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], axis=-1)
    spacing = radius * math.sqrt(4 * math.pi / count)
    normals = directions[:, :, None] * directions[:, None, :]
    covariances = (_OVERLAP * spacing) ** 2 * (np.eye(3) - normals) + normals
    with torch.no_grad():
        colours = sky(torch.from_numpy(directions).float()).numpy()
    return BakedSplats(
        centres=(middle + radius * directions).astype(np.float32),
        covariances=covariances.astype(np.float32),
        colours=colours.astype(np.float32),
        opacities=np.ones((count, 1), np.float32),
    )


def segments(lines: Sequence[Array]) -> Array:
    """Line segments (M, 2, 3) of polylines (N_i, 3), without those that have no length."""
    pairs = [np.stack([line[:-1], line[1:]], axis=1) for line in lines if len(line) > 1]
    joined = np.concatenate(pairs) if pairs else np.zeros((0, 2, 3))
    return joined[np.any(joined[:, 0] != joined[:, 1], axis=1)]


def raised(points: Array) -> Array:
    """Points (N, 3), a little higher."""
    return points + np.array([0.0, 0.0, _RAISED])


def lane_lines(hdmap: HdMap) -> tuple[Array, Array]:
    """Segments (M, 2, 3) of the lanes' boundaries and of their centrelines, above the ground."""
    lanes = hdmap.lanes.values()
    boundaries = [
        raised(line)
        for lane in lanes
        if not lane.is_intersection
        for line in (lane.left_boundary, lane.right_boundary)
    ]
    return segments(boundaries), segments([raised(lane.centreline) for lane in lanes])


def drivable_mesh(hdmap: HdMap) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) and triangles (F, 3) of the drivable area; none for a map without one."""
    region = drivable_region(hdmap)
    corners: list[Array] = []
    if region is not None and not region.is_empty:
        triangles = shapely.constrained_delaunay_triangles(shapely.simplify(region, 0.1))
        corners = [
            np.asarray(part.exterior.coords)[:3, :2]
            for part in shapely.get_parts(triangles)
            if isinstance(part, shapely.Polygon)
        ]
    if not corners:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    flat = np.concatenate(corners)
    vertices = raised(np.column_stack([flat, heights(hdmap, flat)]))
    return vertices, np.arange(len(flat)).reshape(-1, 3)


def heights(hdmap: HdMap, points: Array) -> Array:
    """Ground heights (N,) under points (N, 2): of the ground, else of the nearest lane point."""
    found = np.full(len(points), np.nan)
    if hdmap.ground is not None:
        found = hdmap.ground.at(points)
    unknown = np.isnan(found)
    if unknown.any() and hdmap.lanes:
        lines = np.concatenate([lane.centreline for lane in hdmap.lanes.values()])
        _, nearest = cKDTree(lines[:, :2]).query(points[unknown])
        found[unknown] = lines[nearest, 2]
    return np.nan_to_num(found)


_EYES = 24
"""Most places of the ego from which colours are looked at."""


@dataclass
class _Part:
    """Gaussians that are sent once, with what decides on which of them."""

    name: str
    gaussians: Gaussians
    eyes: Array
    importance: Array
    sent: bool = False


class SplatNodes:
    """Backgrounds, skies and actors, arm by arm.

    Args:
        server: server that gets the nodes, all of them invisible.
        most: number of Gaussians at most, without the sky, of the arms of one `add`.

    Attributes:
        total: number of Gaussians that there are in the arms so far.
        kept: number of Gaussians that were sent.
    """

    def __init__(self, server: viser.ViserServer, inputs: ViewInputs, most: int) -> None:
        self._server, self._inputs, self._most = server, inputs, most
        self._lock = RLock()
        self._parts: dict[int, _Part] = {}
        self._domes: dict[str, str] = {}
        self._streets: dict[str, tuple[str, str]] = {}
        self._actors: dict[str, dict[str, str]] = {}
        self._coverage: dict[str, dict[str, str]] = {}
        self._handles: dict[str, viser.GaussianSplatHandle] = {}
        self.total = self.kept = 0

    def add(self, arms: Iterable[str]) -> None:
        """Send what arms show, unless it is there.

        Which Gaussians are important enough is decided over all that the arms show; what an earlier
        arm sent stays as it was sent.
        """
        with self._lock:
            new = [arm for arm in arms if arm not in self._coverage]
            shown = {id(part): part for arm in new for part in self._gather(arm)}
            parts = list(shown.values())
            rows = most_important([part.importance for part in parts], self._most)
            for part, row in zip(parts, rows, strict=True):
                if part.sent:
                    continue
                part.sent = True
                self.total += len(part.gaussians)
                self.kept += len(row)
                if len(row):
                    chosen = part.gaussians.select(torch.from_numpy(row))
                    self._add(part.name, baked(chosen, torch.from_numpy(part.eyes).float()))
            for arm in new:
                self._add_coverage(arm)

    def nodes(
        self, arm: str, splats: bool, sky: bool, coverage: bool, poses: Mapping[str, Array]
    ) -> dict[str, Array | None]:
        """Names of the nodes to be seen, with the poses (4, 4) of those that move.

        Args:
            splats, sky, coverage: what is shown; coverage: actors in its colours.
            poses: poses of the actors that are present.
        """
        found: dict[str, Array | None] = {}
        background, dome = self._streets.get(arm, ("", ""))
        if splats and background in self._handles:
            found[background] = None
        if sky and dome in self._handles:
            found[dome] = None
        coloured = self._coverage.get(arm, {}) if coverage else {}
        for track, pose in poses.items() if splats else ():
            name = coloured.get(track, self._actors.get(arm, {}).get(track, ""))
            if name in self._handles:
                found[name] = pose
        return found

    @property
    def handles(self) -> Mapping[str, viser.GaussianSplatHandle]:
        """Handles by name of the node."""
        return self._handles

    def _gather(self, arm: str) -> list[_Part]:
        """What an arm shows."""
        scene = self._inputs.scenes.get(arm)
        if scene is None:
            return []
        parts, drive = self._parts, _first_drive(self._inputs, arm)
        path = np.zeros((0, 3)) if drive.rig is None else drive.rig[:, :3, 3]
        key = id(scene.background)
        if key not in parts:
            name = f"/street/{len(parts)}"
            values = importance(scene.background, path_distances(scene.background, path))
            parts[key] = _Part(name, scene.background, _eyes(path), values)
            self._domes[name] = f"/sky/{len(parts)}"
            self._add(self._domes[name], sky_dome(scene.sky, _middle(path, scene)))
        self._streets[arm] = parts[key].name, self._domes[parts[key].name]
        found, names = [parts[key]], {}
        for track, actor in scene.actors.items():
            key = id(actor.gaussians)
            if key not in parts:
                first = drive.poses.get(track, actor.trajectory.poses)
                there = first[~np.isnan(first[:, 0, 0])]
                pose = there[0] if len(there) else actor.trajectory.poses[0]
                drawn = actor.lit_at(pose).drawn.detach()
                away = np.full(len(drawn), ACTOR_DISTANCE)
                eyes = se3.apply(se3.inverse(pose), path) if len(path) else path
                parts[key] = _Part(
                    f"/actors/{len(parts)}", drawn, _eyes(eyes), importance(drawn, away)
                )
            found.append(parts[key])
            names[track] = parts[key].name
        self._actors[arm] = names
        return found

    def _add(self, name: str, splats: BakedSplats) -> None:
        self._handles[name] = self._server.scene.add_gaussian_splats(
            name,
            splats.centres,
            splats.covariances,
            splats.colours,
            splats.opacities,
            visible=False,
        )

    def _add_coverage(self, arm: str) -> None:
        """Actors with shares in the colours of what was seen, mirrored and invented."""
        self._coverage[arm] = {}
        colours = np.array(list(SHARES.values())) / 255
        for track, actor in self._inputs.actors.get(arm, {}).items():
            if actor.shares is not None:
                name = f"/coverage/{len(self._handles)}"
                coloured = coloured_by_shares(actor, colours.tolist()).gaussians
                self._add(name, baked(coloured, torch.zeros(0, 3)))
                self._coverage[arm][track] = name


def _first_drive(inputs: ViewInputs, arm: str) -> ViewedDrive:
    """The first drive of an arm; of any, where it has none."""
    drives = [drives for drives in inputs.scenarios.values() if drives]
    return next((d[arm] for d in drives if arm in d), next(iter(drives[0].values())))


def _eyes(path: Array) -> Array:
    return path[np.unique(np.linspace(0, len(path) - 1, _EYES).astype(int))] if len(path) else path


def _middle(path: Array, scene: StreetScene) -> Array:
    if len(path):
        return np.asarray(path.mean(axis=0), np.float64)
    if len(scene.background):
        return np.asarray(scene.background.means.detach().double().mean(dim=0).numpy(), np.float64)
    return np.zeros(3)
