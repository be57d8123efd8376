"""Learned corrections of camera and track poses, and the Adam for small tables that trains them.

Both are small offsets on the logged poses. What no training view sees is interpolated from the
neighbours in time, so that held-out frames and simulated ones get the same treatment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.arrays import Array, Int64Array
from recast.logs import Track, Trajectory
from recast.scene.dynamic import pose_at, stands
from recast.scene.views import TrainingView

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15


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


def corrected(
    camera_from_world: Array,
    corrections: Mapping[str, tuple[Int64Array, Array]],
    camera_name: str,
    timestamp_us: int,
) -> Array:
    """A logged pose (4, 4) with the learned correction at its time.

    Interpolated linearly between the neighbouring training views, held before the first and after
    the last; cameras that were not trained on stay as logged.
    """
    if camera_name not in corrections:
        return camera_from_world
    times, twists = corrections[camera_name]
    twist = [np.interp(timestamp_us, times, twists[:, i]) for i in range(6)]
    moved: Array = twist_matrix(torch.tensor(twist, dtype=torch.float64)).numpy()
    return moved @ camera_from_world


def twist_matrix(twist: Tensor) -> Tensor:
    """Rigid matrix (4, 4) of a twist (6,): rotation by Rodrigues' formula, translation as it is.

    The translation is not multiplied by SO(3)'s left Jacobian: the parametrisation is as good a
    chart near zero, and decoupled.
    """
    rotation = twist[3:]
    theta2 = rotation.dot(rotation)
    small = theta2 < 1e-8
    safe = torch.where(small, torch.ones_like(theta2), theta2)
    theta = safe.sqrt()
    a = torch.where(small, 1 - theta2 / 6, theta.sin() / theta)
    b = torch.where(small, 0.5 - theta2 / 24, (1 - theta.cos()) / safe)
    x, y, z = rotation.unbind()
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).view(3, 3)
    turn = torch.eye(3, dtype=twist.dtype) + a * skew + b * (skew @ skew)
    top = torch.cat([turn, twist[:3, None]], dim=1)
    bottom = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=twist.dtype)
    return torch.cat([top, bottom])


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

    def knots(self) -> list[tuple[int, Int64Array, Array]]:
        """By track that has any: first row in the table, times (K,), logged centres (K, 3)."""
        return [
            (self._first_row[name], times, self._logged[name].at(times)[:, :3, 3])
            for name, times in self._knots.items()
            if len(times)
        ]

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
