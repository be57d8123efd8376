"""The Gaussians of all arms as nodes of a viser scene, each set of Gaussians sent once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np
import torch

from recast.actors.drawing import coloured_by_shares
from recast.arrays import Array
from recast.geometry import se3
from recast.reporting.palette import SHARES
from recast.scene import StreetScene
from recast.splats import Gaussians
from recast.viewer.bake import (
    ACTOR_DISTANCE,
    BakedSplats,
    baked,
    importance,
    most_important,
    path_distances,
    sky_dome,
)
from recast.viewer.inputs import ViewedDrive, ViewInputs

if TYPE_CHECKING:
    import viser


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
