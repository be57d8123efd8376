"""Actors whose Gaussians move within their box: deformable nodes, and bodies on a skeleton."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from recast.arrays import Array
from recast.geometry import se3
from recast.geometry.se2 import Polyline, from_se3
from recast.logs import Trajectory
from recast.logs.checks import check_times
from recast.splats import Gaussians
from recast.splats.gaussians import LARGEST, quat_multiply

OUTPUTS = 7
"""Metres along x, y and z, and what is added to the quaternion."""
TIME_UNIT_US = 20_000_000
"""Microseconds after the first label that are 1 for the network: the length of Waymo's segments, of
which OmniRe's time is a share, so that its octaves are the same frequencies."""
MOST_LAYERS, MOST_WIDTH, MOST_BANDS, MOST_CODE = 16, 1024, 16, 256
"""Limits of the deformation network."""
MOST_JOINTS, MOST_POSES = 256, 1_000_000
UNIT_TOLERANCE = 1e-3
"""How far the weights of a Gaussian may be from adding up to 1, and a quaternion from length 1."""


@dataclass(frozen=True)
class DeformationNetwork:
    """Offsets of Gaussians by their canonical place, a time and a code.

    Attributes:
        layers: weights (out, in + 1), the last column being the bias: hidden layers with ReLU, all
            of one width, then the outputs. The inputs are joined to what enters the layer after the
            one in the middle (the sixth of eight), if that is a hidden one.
        bands: octaves of sines and cosines of each coordinate.
        time_bands: octaves of the time.
    """

    layers: Sequence[Tensor]
    bands: int
    time_bands: int

    @property
    def code_size(self) -> int:
        """Length of an actor's code."""
        return int(self.layers[0].shape[1]) - 1 - encoded_size(self.bands, self.time_bands)

    def __call__(self, places: Tensor, time: float, code: Tensor) -> Tensor:
        """Offsets (N, 7) at places (N, 3), in units of the box, and a time in `TIME_UNIT_US`."""
        octaves = encoded(places.new_full((1, 1), time), self.time_bands)
        context = torch.cat([octaves, code.to(places)[None]], dim=1).expand(len(places), -1)
        inputs = torch.cat([encoded(places, self.bands), context], dim=1)
        hidden, joined = inputs, joining_layer(len(self.layers) - 1)
        for number, layer in enumerate(self.layers[:-1]):
            if number == joined:
                hidden = torch.cat([inputs, hidden], dim=1)
            hidden = functional.relu(_linear(hidden, layer))
        return _linear(hidden, self.layers[-1])

    def to(self, device: torch.device | str) -> DeformationNetwork:
        """The same network elsewhere."""
        return replace(self, layers=tuple(layer.to(device) for layer in self.layers))

    def fault(self) -> str | None:
        """What is wrong with the layers' shapes or values, or None."""
        count = len(self.layers)
        if not 2 <= count <= MOST_LAYERS + 1:
            return f"{count} layers, 2 to {MOST_LAYERS + 1} are possible"
        if not (0 <= self.bands <= MOST_BANDS and 0 <= self.time_bands <= MOST_BANDS):
            return f"{self.bands} and {self.time_bands} bands, at most {MOST_BANDS} are possible"
        if any(layer.ndim != 2 or layer.dtype != torch.float32 for layer in self.layers):
            return "a layer is not a float32 matrix"
        width, code = int(self.layers[0].shape[0]), self.code_size
        if not (1 <= width <= MOST_WIDTH and 1 <= code <= MOST_CODE):
            return f"a width of {width} and a code of {code}"
        shapes = layer_shapes(count - 1, width, self.bands, self.time_bands, code)
        for number, (layer, shape) in enumerate(zip(self.layers, shapes, strict=True)):
            if tuple(layer.shape) != shape:
                return f"layer {number}: expected {shape}, got {tuple(layer.shape)}"
            if not bool((layer.abs() < LARGEST).all()):  # also NaN
                return f"layer {number}: a value is not finite, or out of range"
        return None


@dataclass(frozen=True)
class Deformation:
    """How the Gaussians of one actor move over its time.

    Attributes:
        network: network of all deformable actors of the scene.
        code: (E,) float32 code of this actor.
        reach: metres that are one unit of the network's places.
    """

    network: DeformationNetwork
    code: Tensor
    reach: float

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where`."""
        del count
        fault = self.network.fault()
        if fault is not None:
            raise ValueError(f"{where}.network: {fault}")
        if tuple(self.code.shape) != (self.network.code_size,):
            expected = f"expected ({self.network.code_size},)"
            raise ValueError(f"{where}.code: {expected}, got {tuple(self.code.shape)}")
        if not bool((self.code.abs() < LARGEST).all()):
            raise ValueError(f"{where}.code: a value is not finite, or out of range")
        if not 1e-3 <= self.reach <= 1e3:  # also NaN
            raise ValueError(f"{where}.reach: {self.reach} is not 0.001 to 1000 m")

    def at(self, gaussians: Gaussians, trajectory: Trajectory, timestamp_us: int) -> Gaussians:
        """The Gaussians as they are at a time; before the first and after the last label, as then.

        Differentiable. The network sees where Gaussians are and does not move them by that
        (Deformable 3DGS).
        """
        first, last = (int(time) for time in trajectory.timestamps_us[[0, -1]])
        time = (min(max(timestamp_us, first), last) - first) / TIME_UNIT_US
        places = gaussians.means.detach() / self.reach
        change = self.network(places, time, self.code)
        return replace(
            gaussians,
            means=gaussians.means + change[:, :3],
            quats=gaussians.quats + change[:, 3:],
        )


def encoded(values: Tensor, bands: int) -> Tensor:
    """(N, D (1 + 2 bands)): values (N, D), then sines and cosines of 1, 2, 4, ... times them.

    Mildenhall et al. 2020, section 5.1, without pi, as Deformable 3DGS encodes.
    """
    powers = [2.0**k for k in range(bands)]
    octaves = [wave(values * power) for power in powers for wave in (torch.sin, torch.cos)]
    return torch.cat([values, *octaves], dim=1)


def encoded_size(bands: int, time_bands: int) -> int:
    """Number of inputs that a place and a time make."""
    return 3 * (1 + 2 * bands) + 1 + 2 * time_bands


def joining_layer(hidden: int) -> int | None:
    """Number of the hidden layer that gets the inputs once more, of so many; None for none."""
    number = hidden // 2 + 1
    return number if number < hidden else None


def layer_shapes(
    hidden: int, width: int, bands: int, time_bands: int, code: int
) -> list[tuple[int, int]]:
    """Shapes of the hidden layers and of the outputs."""
    inputs, joined = encoded_size(bands, time_bands) + code, joining_layer(hidden)
    entering = [inputs if k == 0 else width + inputs * (k == joined) for k in range(hidden)]
    return [(width, size + 1) for size in entering] + [(OUTPUTS, width + 1)]


def _linear(values: Tensor, layer: Tensor) -> Tensor:
    return functional.linear(values, layer[:, :-1], layer[:, -1])


@dataclass(frozen=True)
class Skinning:
    """How the Gaussians of one body move over its time.

    Gaussians are in the body's rest frame; `at` puts them into the box frame of their actor.

    Attributes:
        weights: (N, J) float32, of the joints in each Gaussian's motion; rows add up to 1.
        joints: (J, 3) float64 rest places, metres.
        parents: (J,) int64, -1 for the first joint and an earlier joint for all others.
        timestamps_us: (T,) int64.
        rotations: (T, J, 4) float64 quaternions wxyz of the joints in their parents' frames; the
            first is `box_from_body`.
        translations: (T, 3) float64 metres in the box frame, added to all.
    """

    weights: Tensor
    joints: Array
    parents: NDArray[np.int64]
    timestamps_us: NDArray[np.int64]
    rotations: Array
    translations: Array

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where` of `count` Gaussians."""
        joints, times = len(self.parents), len(self.timestamps_us)
        if not 1 <= joints <= MOST_JOINTS or not 1 <= times <= MOST_POSES:
            raise ValueError(f"{where}: {joints} joints and {times} poses")
        shapes = {
            "weights": (count, joints),
            "joints": (joints, 3),
            "parents": (joints,),
            "timestamps_us": (times,),
            "rotations": (times, joints, 4),
            "translations": (times, 3),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if tuple(value.shape) != shape:
                raise ValueError(f"{where}.{name}: expected {shape}, got {tuple(value.shape)}")
        check_times(f"{where}.timestamps_us", self.timestamps_us)
        check_tree(where, self.parents)
        check_weights(where, self.weights.detach().double().numpy())
        for name in ("joints", "translations"):
            if not np.all(np.abs(getattr(self, name)) < LARGEST):  # also NaN
                raise ValueError(f"{where}.{name}: a value is not finite, or out of range")
        norms = np.linalg.norm(self.rotations, axis=2)
        if not np.all(np.abs(norms - 1) < UNIT_TOLERANCE):
            raise ValueError(f"{where}.rotations: a quaternion is not of length 1")

    def at(self, gaussians: Gaussians, trajectory: Trajectory, timestamp_us: int) -> Gaussians:
        """The Gaussians in the box frame at a time; before the first and after the last, as then.

        See `skinned`.
        """
        del trajectory
        moved, turns = self._joints_at(timestamp_us)
        return skinned(gaussians, self.weights, moved, turns)

    def _joints_at(self, timestamp_us: int) -> tuple[Array, Array]:
        """Rest-to-box transforms (J, 3, 4) of the joints, and their rotations (J, 4)."""
        place = np.interp(timestamp_us, self.timestamps_us, np.arange(len(self.timestamps_us)))
        left = min(int(place), max(len(self.timestamps_us) - 2, 0))
        right, share = min(left + 1, len(self.timestamps_us) - 1), place - left
        rotations = se3.slerp(self.rotations[left], self.rotations[right], share)
        shift = (1 - share) * self.translations[left] + share * self.translations[right]
        poses = joint_poses(se3.quat_to_matrix(rotations), self.joints, self.parents)
        poses[:, :3, 3] += shift
        rest = np.einsum("jab,jb->ja", poses[:, :3, :3], self.joints)
        moved = np.concatenate([poses[:, :3, :3], (poses[:, :3, 3] - rest)[..., None]], axis=2)
        return moved, se3.matrix_to_quat(poses[:, :3, :3])


def skinned(gaussians: Gaussians, weights: Tensor, moved: Array, turns: Array) -> Gaussians:
    """Gaussians moved by several rigid motions (linear blend skinning); differentiable in them.

    Their rotation is the weighted mean of the motions' quaternions. View-dependent colour does not
    turn with the limbs.

    Args:
        weights: (N, J) of the motions; rows add up to 1.
        moved: (J, 3, 4) the motions.
        turns: (J, 4) their rotations, quaternions wxyz.
    """
    weights = weights.to(gaussians.means)
    motions = torch.from_numpy(moved).to(gaussians.means)
    quats = torch.from_numpy(turns).to(gaussians.means)
    blend = (weights @ motions.flatten(1)).view(-1, 3, 4)
    means = (blend[:, :, :3] @ gaussians.means[:, :, None])[..., 0] + blend[:, :, 3]
    # A quaternion and its negative are one rotation: all take the sign nearest to the heaviest.
    heaviest = quats[weights.argmax(dim=1)]
    signs = torch.sign(heaviest @ quats.T + 1e-9)
    turn = functional.normalize((weights * signs) @ quats, dim=1)
    return replace(gaussians, means=means, quats=quat_multiply(turn, gaussians.quats))


@dataclass(frozen=True)
class Gait:
    """How a body moves with the way that it goes: legs that walk, wheels that turn.

    Gaussians are in the box frame of their actor, in the pose of the first phase.

    Attributes:
        weights: (N, J) float32, of the parts in each Gaussian's motion; rows add up to 1.
        rotations: (T, J, 4) float64 quaternions wxyz of the parts at T phases, evenly spaced over
            a cycle, from the first one's.
        translations: (T, J, 3) float64 metres, likewise.
        cycle: metres of way in a cycle.
        phase: shares of a cycle that have passed where the way begins.
        way: (K, 2) float64 places of the logged way, two or more, metres, world frame.
    """

    weights: Tensor
    rotations: Array
    translations: Array
    cycle: float
    phase: float
    way: Array

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where` of `count` Gaussians."""
        phases, parts = self.rotations.shape[:2] if self.rotations.ndim == 3 else (0, 0)
        if not (1 <= parts <= MOST_JOINTS and 1 <= phases <= MOST_POSES):
            raise ValueError(f"{where}.rotations: shape {self.rotations.shape}")
        shapes = {
            "weights": (count, parts),
            "rotations": (phases, parts, 4),
            "translations": (phases, parts, 3),
            "way": (len(self.way), 2),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if tuple(value.shape) != shape or shape[0] == 0:
                raise ValueError(f"{where}.{name}: expected {shape}, got {tuple(value.shape)}")
        check_weights(where, self.weights.detach().double().numpy())
        for name in ("translations", "way"):
            if not np.all(np.abs(getattr(self, name)) < LARGEST):  # also NaN
                raise ValueError(f"{where}.{name}: a value is not finite, or out of range")
        if not np.all(np.abs(np.linalg.norm(self.rotations, axis=2) - 1) < UNIT_TOLERANCE):
            raise ValueError(f"{where}.rotations: a quaternion is not of length 1")
        if np.linalg.norm(self.way - self.way[0], axis=1).max() < 1e-3:
            raise ValueError(f"{where}.way: all places are the same")
        if not 0.05 <= self.cycle <= 50 or not abs(self.phase) < LARGEST:
            raise ValueError(f"{where}.cycle: {self.cycle} m, phase {self.phase}")

    def at(self, gaussians: Gaussians, pose: Array) -> Gaussians:
        """The Gaussians at a pose (4, 4) `world_from_actor`."""
        return self.posed(gaussians, self.phase_at(pose))

    def posed(self, gaussians: Gaussians, phase: float) -> Gaussians:
        """The Gaussians at a phase in cycles; see `skinned`."""
        count = len(self.rotations)
        place = phase % 1.0 * count
        left = int(place) % count
        right, share = (left + 1) % count, place - int(place)
        turns = se3.slerp(self.rotations[left], self.rotations[right], share)
        shift = (1 - share) * self.translations[left] + share * self.translations[right]
        moved = np.concatenate([se3.quat_to_matrix(turns), shift[..., None]], axis=2)
        return skinned(gaussians, self.weights, moved, turns)

    def phase_at(self, pose: Array) -> float:
        """Phase in cycles at a pose (4, 4) `world_from_actor`."""
        return self.phase_after(self.gone_at(pose))

    def phase_after(self, gone: float) -> float:
        """Phase in cycles after so many metres of the way."""
        return self.phase + gone / self.cycle

    def gone_at(self, pose: Array) -> float:
        """Metres of the way at a pose (4, 4) `world_from_actor`; see `Polyline.gone`."""
        return self._line.gone(from_se3(pose))

    @cached_property
    def _line(self) -> Polyline:
        return Polyline.from_points(self.way)


def joint_poses(rotations: Array, joints: Array, parents: NDArray[np.int64]) -> Array:
    """Poses (J, 4, 4) `body_from_joint` of a skeleton.

    Args:
        rotations: (J, 3, 3) in the parents' frames.
        joints: (J, 3) rest places.
        parents: (J,), see `Skinning`.
    """
    poses = np.tile(np.eye(4), (len(joints), 1, 1))
    for joint, parent in enumerate(parents):
        poses[joint, :3, :3] = rotations[joint]
        poses[joint, :3, 3] = joints[joint] - (0 if parent < 0 else joints[parent])
        if parent >= 0:
            poses[joint] = poses[parent] @ poses[joint]
    return poses


def check_tree(where: str, parents: NDArray[np.int64]) -> None:
    """Raise ValueError unless the first joint has no parent and all others an earlier one."""
    numbers = np.arange(len(parents))
    if parents[0] != -1 or np.any(parents[1:] < 0) or np.any(parents[1:] >= numbers[1:]):
        raise ValueError(f"{where}.parents: -1, then for each joint an earlier one, got {parents}")


def check_weights(where: str, weights: Array) -> None:
    """Raise ValueError unless weights (N, J) are not negative and add up to 1."""
    if not (np.all(weights >= -UNIT_TOLERANCE) and np.all(weights <= 1 + UNIT_TOLERANCE)):
        raise ValueError(f"{where}.weights: a value is not within 0 and 1")
    if not np.all(np.abs(weights.sum(axis=1) - 1) < UNIT_TOLERANCE):
        raise ValueError(f"{where}.weights: a row does not add up to 1")
