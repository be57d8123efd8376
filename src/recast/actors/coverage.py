"""Where a vehicle's looks come from, seen, mirrored or invented, and what a camera sees of each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.arrays import Array
from recast.cameras import PinholeCamera, box_rectangle
from recast.geometry import se3
from recast.scene import StreetScene
from recast.scene.actor import SceneActor
from recast.splats import (
    Gaussians,
    freeze,
    morton_order,
    pick_device,
    rasterize_frozen,
)
from recast.splats.sh import C0

LEAST_PIXELS = 1.0
"""A vehicle of which an image shows less than this is not visible there."""
_REACH = 3.5  # deviations: at 3.33 even an opaque Gaussian falls below the 1/255 that is drawn
_MARGIN = 3  # pixels by which the low-pass filter may widen a Gaussian
_LEAST_FAR = 1.0  # metres: beyond the near plane, also for what is behind the camera


@dataclass(frozen=True)
class Shares:
    """Where each of N Gaussians comes from; with the invented share they add up to one."""

    seen: Tensor  # (N,) float32 in [0, 1], share from images of the Gaussian's own side
    mirrored: Tensor  # (N,) float32 in [0, 1], share from images of the other side

    def __len__(self) -> int:
        return len(self.seen)

    @property
    def invented(self) -> Tensor:
        """(N,) float32 in [0, 1], from the generator alone."""
        return (1 - self.seen - self.mirrored).clamp(0, 1)

    @property
    def columns(self) -> Tensor:
        """(N, 3) seen, mirrored, invented: as colours, red, green and blue."""
        return torch.stack([self.seen, self.mirrored, self.invented], dim=-1)

    def select(self, index: Tensor) -> Shares:
        """Those of the Gaussians at `index`: (M,) int64 or a (N,) bool mask."""
        return Shares(self.seen[index], self.mirrored[index])

    def fault(self, count: int) -> tuple[str, str] | None:
        """The field at fault and what is wrong with it; None for shares of `count` Gaussians."""
        for name in ("seen", "mirrored"):
            value: Tensor = getattr(self, name)
            if tuple(value.shape) != (count,) or value.dtype != torch.float32:
                return (
                    name,
                    f"shape {tuple(value.shape)} {value.dtype}, expected ({count},) float32",
                )
            if not bool(((value >= 0) & (value <= 1)).all()):  # also NaN
                return name, "holds values outside [0, 1]"
        if not bool((self.seen + self.mirrored <= 1 + 1e-5).all()):
            return "mirrored", "the sum of seen and mirrored exceeds 1"
        return None


@dataclass(frozen=True)
class Coverage:
    """Where the looks of a visible vehicle come from."""

    pixels: float  # visible area of the vehicle, 0 or at least `LEAST_PIXELS`
    # seen, mirrored, invented: means over that area; they add up to 1, or are 0 where pixels is.
    seen: float
    mirrored: float
    invented: float

    @classmethod
    def of(cls, areas: Array) -> Coverage:
        """Of the areas (3,) in pixels that come from each."""
        pixels = float(areas.sum())
        if pixels < LEAST_PIXELS:
            return NOTHING
        return cls(pixels, *(float(area) / pixels for area in areas))

    @classmethod
    def mean(cls, several: Iterable[Coverage]) -> Coverage:
        """Of several images: mean area, and shares of all their area, over those that show it."""
        rows = np.array([astuple(one) for one in several if one.pixels > 0]).reshape(-1, 4)
        return NOTHING if len(rows) == 0 else cls.of((rows[:, :1] * rows[:, 1:]).mean(axis=0))


NOTHING = Coverage(0.0, 0.0, 0.0, 0.0)
"""Of an image that does not show the vehicle."""


class CoverageMeter:
    """Measures the coverage of a vehicle in images of a scene, without drawing the images.

    The vehicle is drawn with its shares as colours, behind black: what lies nearer to the camera in
    the scene. Only the part of the image that shows the vehicle is drawn, and nothing beyond it.

    Args:
        scene: scene with the vehicle, see `recast.actors.insert`.
        track_id, shares: the vehicle, and the shares of its Gaussians.
        device: device to draw on, see `recast.splats.pick_device`.

    Raises:
        InputError: there is no such device, or gsplat is missing.
        ValueError: the scene has no such vehicle, or one of another number of Gaussians.
    """

    def __init__(
        self, scene: StreetScene, track_id: str, shares: Shares, device: str = "auto"
    ) -> None:
        if track_id not in scene.actors or len(scene.actors[track_id].gaussians) != len(shares):
            raise ValueError(f"CoverageMeter: {len(shares)} shares of track {track_id}")
        place = pick_device(device)
        vehicle = scene.actors[track_id]
        self._track_id, self._standing = track_id, scene.standing
        coloured = ((shares.columns - 0.5) / C0)[:, None]
        gaussians = replace(vehicle.gaussians.detach(), sh=coloured)
        painted = replace(_black_actor(vehicle), gaussians=gaussians)
        self._means = gaussians.means.to(place)
        self._centre, self._size = _bounds(gaussians)
        background = _black(scene.background)
        self._street = freeze(background.select(morton_order(background.means)).to(place))
        self._parts = {
            key: (painted if key == track_id else _black_actor(actor)).frozen(place)
            for key, actor in scene.actors.items()
        }

    def measure(
        self,
        camera: PinholeCamera,
        camera_from_world: Array,
        poses: Mapping[str, Array],
        shown: NDArray[np.bool_] | None = None,
    ) -> Coverage:
        """Coverage in one image.

        Args:
            camera: rectified camera.
            camera_from_world: (4, 4).
            poses: `world_from_actor` (4, 4) by track id; parked vehicles that it does not name
                stand where they are.
            shown: (H, W), pixels that are not black whatever is there; all if None.
        """
        poses = {**self._standing, **poses}
        camera_from_vehicle = np.asarray(camera_from_world) @ poses[self._track_id]
        box = camera_from_vehicle @ se3.from_rotation_translation(np.eye(3), self._centre)
        outline = box_rectangle(self._size, box, camera)
        if outline is None:
            return NOTHING
        limits = [camera.width, camera.height]
        left, top = (int(v) for v in np.floor(outline[:2] - _MARGIN).clip(0, limits))
        right, bottom = (int(v) for v in np.ceil(outline[2:] + _MARGIN).clip(0, limits))
        if left >= right or top >= bottom:
            return NOTHING
        areas = self._areas(
            camera.cropped(left, top, right - left, bottom - top),
            np.asarray(camera_from_world),
            poses,
        )
        if shown is not None:
            areas = areas * torch.from_numpy(shown[top:bottom, left:right, None]).to(areas)
        return Coverage.of(areas.sum(dim=(0, 1)).double().cpu().numpy())

    def _areas(
        self, camera: PinholeCamera, camera_from_world: Array, poses: Mapping[str, Array]
    ) -> Tensor:
        """(H, W, 3) share of each pixel that shows what was seen, mirrored, invented."""
        view = torch.from_numpy(np.asarray(camera_from_world, np.float64))
        row = view[2] @ torch.from_numpy(np.array(poses[self._track_id], np.float64))
        depths = self._means @ row[:3].to(self._means) + float(row[3])
        # Of this depth's rounding in float32.
        farthest = max(float(depths.max()) * (1 + 1e-5), _LEAST_FAR)
        parts = [(self._street, torch.eye(4, dtype=torch.float64))]
        for key, pose in poses.items():
            place = torch.from_numpy(np.array(pose, np.float64))
            parts += [(part, place) for part in self._parts.get(key, ())]
        K = torch.from_numpy(camera.matrix).float()
        return rasterize_frozen(parts, view, K, camera.width, camera.height, far=farthest).rgb


def _black(gaussians: Gaussians) -> Gaussians:
    # Far below black, since colours are clamped at zero.
    return replace(gaussians.detach(), sh=gaussians.sh.new_full((len(gaussians), 1, 3), -1 / C0))


def _black_actor(actor: SceneActor) -> SceneActor:
    shadow = None if actor.shadow is None else _black(actor.shadow)
    actor = actor.shaped_at(None)
    return replace(actor, gaussians=_black(actor.gaussians), shadow=shadow)


def _reach(gaussians: Gaussians) -> Tensor:
    """(N,) metres from its centre beyond which a Gaussian is not drawn."""
    return _REACH * gaussians.log_scales.max(dim=1).values.exp()


def _bounds(gaussians: Gaussians) -> tuple[Array, Array]:
    """Centre (3,) and size (3,) of the box around all that is drawn."""
    reach = _reach(gaussians)[:, None]
    low = (gaussians.means - reach).amin(dim=0).double().cpu().numpy()
    high = (gaussians.means + reach).amax(dim=0).double().cpu().numpy()
    return (low + high) / 2, high - low
