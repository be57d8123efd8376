"""What is learned beside the Gaussians: poses, exposures, the sky, and the network that deforms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from recast.arrays import Array, Int64Array
from recast.cameras import PinholeCamera
from recast.logs import Track, Trajectory
from recast.reconstruction.config import SceneConfig
from recast.reconstruction.settings import DEFORMATION, OPTIM, generator
from recast.reconstruction.views import TrainingView, deforms
from recast.scene.actor import exposed_colours
from recast.scene.deformation import Deformation, DeformationNetwork, layer_shapes
from recast.scene.sky import (
    OPAQUE,
    SkyMap,
    fused_composite,
    pixel_coordinates,
    sample_cubemap,
    sky_from_cubemap,
    texel_directions,
)
from recast.scene.street_scene import pose_at, stands, twist_matrix
from recast.splats.adam import BETA1, BETA2, EPSILON


class AdamTable:
    """A parameter table with its own moments and step count a row (Kingma & Ba 2015).

    Attributes:
        value: (R, C) leaf tensor; rows without a gradient rest, moments and all.
    """

    def __init__(self, value: Tensor) -> None:
        self.value = value.detach().clone().requires_grad_()
        self._first = torch.zeros_like(value)
        self._second = torch.zeros_like(value)
        self._steps = value.new_zeros(value.shape[0], 1)

    def to(self, device: torch.device | str) -> None:
        """Move value and moments; `value` is another tensor then."""
        self.value = self.value.detach().to(device).requires_grad_()
        self._first, self._second = self._first.to(device), self._second.to(device)
        self._steps = self._steps.to(device)

    def step(self, lr: float | Tensor) -> None:
        """Move the rows that have a gradient, then forget it.

        Args:
            lr: step size, or one per column (C,).
        """
        gradient = self.value.grad
        if gradient is None:
            return
        rows = gradient.any(dim=1).nonzero()[:, 0]
        gradient = gradient[rows]
        steps = self._steps[rows] + 1
        first = torch.lerp(gradient, self._first[rows], BETA1)
        second = torch.lerp(gradient.square(), self._second[rows], BETA2)
        update = (first / (1 - BETA1**steps)) / ((second / (1 - BETA2**steps)).sqrt() + EPSILON)
        with torch.no_grad():
            self.value[rows] -= lr * update
        self._steps[rows], self._first[rows], self._second[rows] = steps, first, second
        self.value.grad = None

    def state_dict(self) -> dict[str, Tensor]:
        """Everything needed to go on, as plain tensors."""
        return {
            "value": self.value.detach(),
            "first": self._first,
            "second": self._second,
            "steps": self._steps,
        }

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Go on from `state_dict`."""
        with torch.no_grad():
            self.value.copy_(state["value"])
        self._first.copy_(state["first"])
        self._second.copy_(state["second"])
        self._steps.copy_(state["steps"])


class CameraPoses:
    """A twist per training view: camera_from_world = exp(twist) @ logged camera_from_world.

    Twists are (translation in metres, rotation vector in radians) in the camera frame.
    """

    def __init__(self, views: Sequence[TrainingView]) -> None:
        self._rows = {_key(view): row for row, view in enumerate(views)}
        self.table = AdamTable(torch.zeros(len(views), 6))

    def camera_from_world(self, view: TrainingView) -> Tensor:
        """(4, 4) float32, differentiable in the twist, of a training view."""
        logged = torch.from_numpy(view.camera_from_world).float()
        return twist_matrix(self.table.value[self._rows[_key(view)]]) @ logged

    def corrections(self, views: Sequence[TrainingView]) -> dict[str, tuple[Int64Array, Array]]:
        """Learned twists by camera: times (F,) and twists (F, 6), in order of time."""
        twists = self.table.value.detach().numpy().astype(np.float64)
        found = {}
        for name in dict.fromkeys(view.camera_name for view in views):
            own = [v for v in views if v.camera_name == name and _key(v) in self._rows]
            if own:
                times = np.array([view.timestamp_us for view in own], np.int64)
                found[name] = (times, twists[[self._rows[_key(view)] for view in own]])
        return found


class TrackPoses:
    """Offsets (dx, dy, dz, dyaw) of tracks in the world frame, at knots in time.

    world_from_object(t) = translate(d) rotate_z(dyaw) about the box centre, applied to the logged
    pose at t. Knots are the labels that a training view is nearest to. Labels that only a held-out
    image could correct are dropped, but for the first and the last: what their neighbours have
    learned, carried over a fifth of a second, is nearer to the truth than a raw label. What stands
    still has no knots: the median of its labels is good enough (docs/scenes.md).
    """

    def __init__(self, tracks: Mapping[str, Track], views: Sequence[TrainingView]) -> None:
        self._logged: dict[str, Trajectory] = {}
        self._knots: dict[str, Int64Array] = {}
        self._first_row: dict[str, int] = {}
        rows = 0
        for track_id, track in tracks.items():
            trained = _trained_labels(track.trajectory, views)
            knots = track.trajectory.timestamps_us[trained]
            if stands(track.trajectory):
                knots, trained[:] = knots[:0], True
            self._knots[track_id], self._first_row[track_id] = knots, rows
            rows += len(knots)
            trained[[0, -1]] = True
            times, poses = track.trajectory.timestamps_us, track.trajectory.poses
            self._logged[track_id] = Trajectory(times[trained], poses[trained])
        self.table = AdamTable(torch.zeros(rows, 4))
        self._present: dict[int, _Present] = {}

    def world_from_actors(self, timestamp_us: int) -> dict[str, Tensor]:
        """(4, 4) float32, differentiable in the offsets, of the tracks that are there at a time.

        All at once; what does not change is kept for the next time that the view is trained on.
        """
        if timestamp_us not in self._present:
            self._present[timestamp_us] = self._presence(timestamp_us)
        present = self._present[timestamp_us]
        offsets = (present.weights[..., None] * self.table.value[present.rows]).sum(dim=1)
        poses = _offset(present.logged, offsets) if present.names else present.logged
        return dict(zip(present.names, poses.unbind(), strict=True))

    def refined(self, track_id: str) -> Trajectory:
        """The track's trajectory with the offsets applied, at the times of the labels kept."""
        logged = self._logged[track_id]
        with torch.no_grad():
            poses = [
                _offset(torch.from_numpy(pose), self._at(track_id, int(time))).numpy()
                for time, pose in zip(logged.timestamps_us, logged.poses, strict=True)
            ]
        return Trajectory(logged.timestamps_us, np.stack(poses))

    def unevenness(self) -> Tensor:
        """How far tracks are from even motion: mean |x(t + k) + x(t - k) - 2 x(t)|, metres.

        Over labels and k = 1..`smooth_over` labels; 0 without a track of three labels. Labels are
        not all evenly spaced (held-out ones are missing), so the middle is compared with the place
        at its own time between the two others.
        """
        logged, start, middle, end, weight = self._triples
        if len(middle) == 0:
            return torch.zeros(())
        x = logged + self.table.value[:, :3].double()
        between = torch.lerp(x[start], x[end], weight)
        return 2 * (between - x[middle]).abs().sum(dim=1).mean().float()

    @cached_property
    def _triples(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Logged centres (R, 3) of all rows; rows before, in the middle and after, and the share of
        time (T, 1) at which the middle lies between both."""
        parts: list[list[Array | Int64Array]] = [[], [], [], []]
        positions = [np.zeros((0, 3))]
        for name, times in self._knots.items():
            if len(times) == 0:
                continue
            positions.append(self._logged[name].at(times)[:, :3, 3])
            for k in range(1, OPTIM.smooth_over + 1):
                middle = np.arange(k, len(times) - k)
                before, after = times[middle - k], times[middle + k]
                row = self._first_row[name] + middle
                share = (times[middle] - before) / (after - before)
                for part, own in zip(parts, (row - k, row, row + k, share), strict=True):
                    part.append(own)
        none = [np.zeros(0, np.int64)]
        rows = [torch.from_numpy(np.concatenate(none + part)) for part in parts[:3]]
        weight = torch.from_numpy(np.concatenate([np.zeros(0), *parts[3]]))[:, None]
        return torch.from_numpy(np.concatenate(positions)), rows[0], rows[1], rows[2], weight

    def _at(self, track_id: str, timestamp_us: int) -> Tensor:
        """The offset (4,) float64 at a time."""
        rows, weights = self._knots_at(track_id, timestamp_us)
        return torch.tensor(weights, dtype=torch.float64) @ self.table.value[rows].double()

    def _knots_at(self, track_id: str, timestamp_us: int) -> tuple[list[int], list[float]]:
        """The two rows of the table about a time, and the weights of both; none: no weight."""
        knots, row = self._knots[track_id], self._first_row[track_id]
        if len(knots) == 0:
            return [], []
        position = float(np.interp(timestamp_us, knots, np.arange(len(knots))))
        left = min(int(position), max(len(knots) - 2, 0))
        right = min(left + 1, len(knots) - 1)
        return [row + left, row + right], [1 - (position - left), position - left]

    def _presence(self, timestamp_us: int) -> _Present:
        found = {name: pose_at(logged, timestamp_us) for name, logged in self._logged.items()}
        logged = {name: pose for name, pose in found.items() if pose is not None}
        knots = [self._knots_at(name, timestamp_us) for name in logged]
        # What has no knots weighs nothing of some row; without any row in the table nothing has.
        free = ([0, 0], [0.0, 0.0]) if len(self.table.value) else ([], [])
        knots = [own if own[0] else free for own in knots]
        return _Present(
            tuple(logged),
            torch.from_numpy(np.array(list(logged.values())).reshape(-1, 4, 4)).float(),
            torch.tensor([rows for rows, _ in knots], dtype=torch.int64),
            torch.tensor([weights for _, weights in knots], dtype=torch.float32),
        )


@dataclass(frozen=True)
class _Present:
    """The A tracks that are there at a time.

    Attributes:
        names: their ids.
        logged: (A, 4, 4) float32 poses as logged.
        rows, weights: (A, 2) rows of the table of offsets and their weights; (A, 0) where the table
            is empty.
    """

    names: tuple[str, ...]
    logged: Tensor
    rows: Tensor
    weights: Tensor


def _trained_labels(trajectory: Trajectory, views: Sequence[TrainingView]) -> NDArray[np.bool_]:
    """Labels (T,) whose nearest view in time is one to train on."""
    times = np.array([view.timestamp_us for view in views], np.int64)
    held_out = np.array([view.held_out for view in views], bool)
    nearest = np.abs(trajectory.timestamps_us[:, None] - times[None]).argmin(axis=1)
    return ~held_out[nearest]


def _offset(pose: Tensor, offset: Tensor) -> Tensor:
    """Move poses (..., 4, 4) by (dx, dy, dz, dyaw) (..., 4) in the world, each about its origin."""
    cos, sin = offset[..., 3].cos(), offset[..., 3].sin()
    zero, one = torch.zeros_like(cos), torch.ones_like(cos)
    turn = torch.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], dim=-1)
    rotation = turn.unflatten(-1, (3, 3)) @ pose[..., :3, :3]
    translation = pose[..., :3, 3] + offset[..., :3]
    top = torch.cat([rotation, translation[..., None]], dim=-1)
    return torch.cat([top, pose[..., 3:, :]], dim=-2)


def _key(view: TrainingView) -> tuple[str, int]:
    return view.camera_name, view.frame


def _affine(residual: Tensor) -> Tensor:
    return torch.eye(3, 4).to(residual) + residual.view(3, 4)


class Exposures:
    """A transform [I | 0] + residual (3, 4) of the composited colours, at knots in time.

    Each camera has its own knots; a view lies between two of them. Blending is linear: with alpha
    the sum of the weights, A (sum w c + (1 - alpha) sky) + b equals sum w (A c + b) + (1 - alpha)
    (A sky + b). So the mean transform can be written into a scene's colours. It holds while no
    Gaussian's colour is clamped.

    Args:
        apart_s: least time between two knots, seconds; 0 for a knot at each view.

    Attributes:
        table: (K, 12) the residuals, of one camera after the other.
    """

    def __init__(self, views: Sequence[TrainingView], apart_s: float = 0.0) -> None:
        self._knots: dict[str, Int64Array] = {}
        self._first: dict[str, int] = {}
        count = 0
        for name in dict.fromkeys(view.camera_name for view in views):
            times = [view.timestamp_us for view in views if view.camera_name == name]
            kept = times[:1]
            for time in times[1:]:
                if time - kept[-1] >= apart_s * 1e6:
                    kept.append(time)
            self._knots[name], self._first[name] = np.array(kept, np.int64), count
            count += len(kept)
        self.table = AdamTable(torch.zeros(count, 12))

    def applied(self, image: Tensor, view: TrainingView) -> tuple[Tensor, Tensor]:
        """The image (H, W, 3) as the view's camera exposed it, and the mean size of the residual.

        Both are differentiable, the second is what a regulariser weighs.
        """
        knots, first = self._knots[view.camera_name], self._first[view.camera_name]
        place = np.interp(view.timestamp_us, knots, np.arange(len(knots)))
        before = min(int(place), max(len(knots) - 2, 0))
        rows = self.table.value[first + before : first + before + 2]
        share = float(place) - before
        residual = (rows[0] if len(rows) == 1 else torch.lerp(rows[0], rows[1], share)).to(
            image.device
        )
        return exposed_colours(image, _affine(residual)), residual.abs().mean()

    def mean(self) -> Tensor:
        """The mean transform (3, 4)."""
        return _affine(self.table.value.detach().mean(dim=0))

    def learned(self) -> dict[str, tuple[Int64Array, Array]]:
        """What is left of the transforms after their mean: times (F,) and (F, 3, 4) by camera."""
        affines = torch.stack([_affine(row) for row in self.table.value.detach()]).double()
        last = torch.tensor([[[0.0, 0.0, 0.0, 1.0]]], dtype=torch.float64)
        whole = torch.cat([affines, last.expand(len(affines), 1, 4)], dim=1)
        mean = torch.cat([self.mean().double(), last[0]])
        left = (whole @ torch.linalg.inv(mean))[:, :3].numpy()
        return {
            name: (times, left[self._first[name] : self._first[name] + len(times)])
            for name, times in self._knots.items()
        }


class PanoramaSky:
    """An equirectangular map: few cells, and what is learned is what is saved.

    Attributes:
        table: its colours, one row a cell.
    """

    def __init__(self, start: SkyMap) -> None:
        self._shape = start.colours.shape
        self.table = AdamTable(start.colours.reshape(-1, 3))

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """rgb + (1 - alpha) sky, (H, W, 3); pixels above `sky.OPAQUE` are left alone."""
        coordinates = pixel_coordinates(camera, camera_from_world)
        return fused_composite(rgb, alpha, self.table.value.view(self._shape), coordinates)

    def sky_map(self) -> SkyMap:
        """The sky as it stands, copied to the CPU."""
        return SkyMap(self.table.value.detach().view(self._shape).to("cpu", copy=True))


class CubeSky:
    """A cubemap in world axes, as both published trainers learn it (Street Gaussians, OmniRe).

    It is resampled for `sky_map`: the folder of a scene holds one kind of sky.

    Attributes:
        table: its colours, one row a cell.
    """

    def __init__(self, start: SkyMap, face_px: int) -> None:
        self._shape = (6, face_px, face_px, 3)
        self.table = AdamTable(start(texel_directions(face_px).reshape(-1, 3)))

    def behind(
        self, rgb: Tensor, alpha: Tensor, camera: PinholeCamera, camera_from_world: ArrayLike
    ) -> Tensor:
        """As `PanoramaSky.behind`; ValueError if the camera has distortion."""
        flat = alpha.reshape(-1)
        shown = (flat.detach() < OPAQUE).nonzero()[:, 0]
        directions = _world_directions(camera, camera_from_world, shown)
        sky = sample_cubemap(self.table.value.view(self._shape), directions)
        through = 1 - flat.index_select(0, shown)
        return rgb.reshape(-1, 3).index_add(0, shown, through[:, None] * sky).view_as(rgb)

    def sky_map(self) -> SkyMap:
        """The sky as it stands, resampled on the CPU."""
        return sky_from_cubemap(self.table.value.detach().cpu().view(self._shape), torch.eye(3))


def _world_directions(
    camera: PinholeCamera, camera_from_world: ArrayLike, pixels: Tensor
) -> Tensor:
    """Rays (M, 3) float32, depth 1, of flat pixel indices (M,) of a rectified camera."""
    if not camera.is_rectified:
        raise ValueError("the sky needs a rectified camera: use camera.rectified()")
    axes = torch.from_numpy(np.array(camera_from_world, np.float64)[:3, :3]).float()
    axes = axes.to(pixels.device)
    x = (pixels % camera.width + (0.5 - camera.cx)) / camera.fx
    y = (pixels // camera.width + (0.5 - camera.cy)) / camera.fy
    return x[:, None] * axes[0] + y[:, None] * axes[1] + axes[2]


def make_sky(config: SceneConfig, start: SkyMap) -> PanoramaSky | CubeSky:
    """The sky that the configuration asks for, with the colours of `start`."""
    return CubeSky(start, config.sky_face_px) if config.sky == "cubemap" else PanoramaSky(start)


class DeformableNodes:
    """The network and the codes of the actors that deform.

    Weights start as torch's linear layers do, the outputs at zero: all actors start rigid.

    Args:
        tracks: actors that may deform; those that do are taken, see `deforms`.
    """

    def __init__(
        self, config: SceneConfig, tracks: Mapping[str, Track], device: torch.device | str
    ) -> None:
        self._config = config
        self._tracks = {key: track for key, track in tracks.items() if deforms(track, config)}
        self._names = tuple(self._tracks)
        self._tables: dict[str, AdamTable] = {}
        if not self._names:
            return
        rng = generator(config.seed, 0, DEFORMATION)
        shapes = layer_shapes(
            config.deformation_layers,
            config.deformation_width,
            config.deformation_bands,
            config.deformation_time_bands,
            config.deformation_code,
        )
        for number, (rows, columns) in enumerate(shapes):
            bound = (columns - 1) ** -0.5
            first = (2 * torch.rand(rows, columns, generator=rng) - 1) * bound
            last = number == len(shapes) - 1
            self._tables[f"deformation_{number}"] = AdamTable(0 * first if last else first)
        codes = torch.randn(len(self._names), config.deformation_code, generator=rng)
        self._tables["deformation_codes"] = AdamTable(codes)
        for table in self._tables.values():
            table.to(device)

    def __contains__(self, track_id: str) -> bool:
        return track_id in self._tracks

    def tables(self) -> dict[str, AdamTable]:
        """What is learned, by name; empty if nothing deforms."""
        return dict(self._tables)

    def deformation(self, track_id: str) -> Deformation:
        """The actor's deformation, with the graph back to the network and its code."""
        *layers, codes = (table.value for table in self._tables.values())
        config = self._config
        network = DeformationNetwork(
            tuple(layers), config.deformation_bands, config.deformation_time_bands
        )
        reach = float(self._tracks[track_id].size.max()) / 2
        return Deformation(network, codes[self._names.index(track_id)], reach)

    def begun(self, u: float) -> bool:
        """Whether actors deform at a share of the run; before, they are trained as rigid."""
        return u >= self._config.deformation_from

    def step(self, u: float) -> None:
        """Adam on the network, and on the codes of the actors that were drawn."""
        for table in self._tables.values():
            table.step(self._config.deformation_lr * OPTIM.deformation_decay**u)

    def learned(self) -> dict[str, Deformation]:
        """Copies on the CPU by track id; they share one network."""
        found = {name: self.deformation(name) for name in self._names}
        if not found:
            return {}
        first = next(iter(found.values())).network
        layers = tuple(layer.detach().to("cpu", copy=True) for layer in first.layers)
        network = DeformationNetwork(layers, first.bands, first.time_bands)
        return {
            name: Deformation(network, own.code.detach().to("cpu", copy=True), own.reach)
            for name, own in found.items()
        }
