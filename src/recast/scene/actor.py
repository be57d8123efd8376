"""An actor of a street: its Gaussians, what changes them with time and place, how it is drawn.

Colours are a Fourier series in the constant harmonic. A share of the actor's time, 0 at its first
label and 1 at its last, stands for t. Vehicles are symmetric, the flip prior of Street Gaussians: a
reflection at the plane between left and right, y -> -y in the box frame, carries a Gaussian to
where an equal one is expected on the side that no camera sees.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import Trajectory
from recast.logs.checks import BOX_SIDE
from recast.scene.deformation import Gait
from recast.splats import (
    CLASSIC,
    FrozenGaussians,
    Gaussians,
    LowPass,
    Rasterization,
    concatenate,
    freeze,
    rasterize,
)
from recast.splats.gaussians import C0, LARGEST


def fourier_basis(share: float, terms: int) -> Tensor:
    """(F,) float32: 1, sin 2 pi t, cos 2 pi t, sin 4 pi t, cos 4 pi t, ... at a share t of time.

    Street Gaussians' basis: cos(pi t k) for even k, sin(pi t (k + 1)) for odd k.
    """
    return torch.tensor(
        [
            math.cos(math.pi * share * k) if k % 2 == 0 else math.sin(math.pi * share * (k + 1))
            for k in range(terms)
        ]
    )


def share_of(trajectory: Trajectory, timestamp_us: int) -> float:
    """The share in [0, 1] of a trajectory's time that has passed."""
    first, last = (int(time) for time in trajectory.timestamps_us[[0, -1]])
    return min(max((timestamp_us - first) / max(last - first, 1), 0.0), 1.0)


def coloured(gaussians: Gaussians, fourier: Tensor, share: float) -> Gaussians:
    """Add the time-dependent part (N, F - 1, 3) to the constant harmonic; differentiable."""
    basis = fourier_basis(share, fourier.shape[1] + 1)[1:].to(fourier)
    constant = gaussians.sh[:, :1] + torch.einsum("k,nkc->nc", basis, fourier)[:, None]
    return replace(gaussians, sh=torch.cat([constant, gaussians.sh[:, 1:]], dim=1))


@dataclass(frozen=True)
class Appearance:
    """How the colours of an actor's Gaussians go on from the moment at which they are stored.

    Attributes:
        fourier: (N, F - 1, 3) coefficients of the basis but its constant.
        frozen_share: share of the actor's time whose colours its Gaussians have: those of every
            use that is tied to no time of the recording.
    """

    fourier: Tensor
    frozen_share: float

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where` of `count` Gaussians."""
        shape = tuple(self.fourier.shape)
        if len(shape) != 3 or shape[0] != count or shape[2] != 3:
            raise ValueError(f"{where}.fourier: expected ({count}, F - 1, 3), got {shape}")
        if not bool((self.fourier.abs() < LARGEST).all()):  # also NaN
            raise ValueError(f"{where}.fourier: a value is not finite, or out of range")
        if not 0 <= self.frozen_share <= 1:
            raise ValueError(f"{where}.frozen_share: {self.frozen_share} is not within [0, 1]")

    def at(self, frozen: Gaussians, share: float) -> Gaussians:
        """The Gaussians with the colours of another share of the time."""
        return coloured(coloured(frozen, -self.fourier, self.frozen_share), self.fourier, share)


def frozen(
    gaussians: Gaussians, fourier: Tensor, share: float
) -> tuple[Gaussians, Appearance | None]:
    """Gaussians with the colours of a share of the time, and how those go on, if they change."""
    if fourier.shape[1] == 0:
        return gaussians, None
    return coloured(gaussians, fourier, share), Appearance(fourier, share)


def mirrored(gaussians: Gaussians, chosen: Tensor) -> Gaussians:
    """Reflect the rows of a (N,) bool mask at the plane y = 0; differentiable.

    A reflection is no rotation, but diag(-1, 1, -1), the half turn about y, makes the same
    covariance of every Gaussian as diag(1, -1, 1). View-dependent colour is reflected too: of the
    real harmonics those of negative order are odd in y.
    """
    sign = torch.where(chosen, -1.0, 1.0).to(gaussians.means)
    one = torch.ones_like(sign)
    w, x, y, z = gaussians.quats.unbind(-1)
    turned = torch.stack([-y, z, w, -x], dim=-1)  # (0, 0, 1, 0) times the quaternion
    return replace(
        gaussians,
        means=gaussians.means * torch.stack([one, sign, one], dim=-1),
        quats=torch.where(chosen[:, None], turned, gaussians.quats),
        sh=torch.where(chosen[:, None, None], gaussians.sh * _parity(gaussians), gaussians.sh),
    )


def with_other_side(gaussians: Gaussians) -> Gaussians:
    """The side with more Gaussians, and its reflection beside all that was there."""
    left = gaussians.means[:, 1] > 0
    side = left if int(left.sum()) * 2 >= len(left) else ~left
    fuller = gaussians.select(side)
    everywhere = torch.ones(len(fuller), dtype=torch.bool, device=side.device)
    return concatenate([gaussians, mirrored(fuller, everywhere)])


def _parity(gaussians: Gaussians) -> Tensor:
    """(K, 1) factors of the harmonics under y -> -y: -1 for orders below zero."""
    degrees = range(gaussians.sh_degree + 1)
    orders = [order for degree in degrees for order in range(-degree, degree + 1)]
    return torch.tensor([-1.0 if order < 0 else 1.0 for order in orders]).to(gaussians.sh)[:, None]


def exposed_colours(colours: Tensor, affine: Tensor) -> Tensor:
    """Colours (..., 3) after the transform (3, 4)."""
    return colours @ affine[:, :3].T + affine[:, 3]


def exposed(gaussians: Gaussians, affine: Tensor) -> Gaussians:
    """The Gaussians with the colours' transform (3, 4) in their harmonics."""
    sh = gaussians.sh @ affine[:, :3].T
    # A colour is 0.5 + C0 constant + ...: what A makes of the half goes to the constant as well.
    shift = exposed_colours(torch.full((3,), 0.5), affine) - 0.5
    constant = sh[:, :1] + shift / C0
    return replace(gaussians, sh=torch.cat([constant, sh[:, 1:]], dim=1))


BLACK = (-0.5, -0.5, -0.5)
"""Far below black, since colours are clamped at zero: no rounding makes it shine."""


def painted(gaussians: Gaussians, colour: Sequence[float] | Tensor) -> Gaussians:
    """Gaussians of one colour (3,), or of one each (N, 3), in [0, 1] from all sides."""
    sh = (torch.as_tensor(colour).to(gaussians.means) - 0.5) / C0
    return replace(gaussians.detach(), sh=sh.expand(len(gaussians), 3)[:, None].clone())


def painted_actor(
    actor: SceneActor, colour: Sequence[float] | Tensor, shadow: Sequence[float]
) -> SceneActor:
    """An actor of one colour, in no light and of one shape but for its gait, with a shadow of
    another; see `painted`."""
    actor = actor.shaped_at(None)
    return replace(
        actor,
        gaussians=painted(actor.gaussians, colour),
        shadow=None if actor.shadow is None else painted(actor.shadow, shadow),
        appearance=None,
        light=None,
    )


PLACE_M, TURN = 0.1, 0.005
"""Grid on which light is worked out: metres, and a quaternion's components (half a degree)."""
_DISTANCE = 2.1  # of the camera that goes around, in diagonals of the box


class Lighting(Protocol):
    """What lights an actor anew, wherever it stands; see `recast.scene.light`."""

    @property
    def shadow_room(self) -> int:
        """Most Gaussians that the lit actor's shadow has."""

    def lit(self, actor: SceneActor, pose: Array) -> SceneActor:
        """The actor in the light of `pose` (4, 4) `world_from_actor`, its `light` taken off.

        Colours and shadow are others; shapes and opacities stay.
        """


class Deforming(Protocol):
    """What moves the Gaussians of an actor within its box; see `recast.scene.deformation`."""

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where` of `count` Gaussians."""

    def at(self, gaussians: Gaussians, trajectory: Trajectory, timestamp_us: int) -> Gaussians:
        """The Gaussians as they are at a time of the recording; outside of it, at its end."""


@dataclass(frozen=True)
class SceneActor:
    """One moving object.

    Attributes:
        gaussians: actor-local frame (box centre, x forward, y left, z up).
        size: (3,) length, width, height in metres.
        trajectory: refined `world_from_actor` as logged.
        shadow: actor-local Gaussians on the ground, drawn with the actor, or None.
        appearance: how the Gaussians' colours change over the trajectory's time, or None.
        deformation: how the Gaussians move within the box over the trajectory's time, or None for a
            rigid actor.
        low_pass: the filter that the Gaussians were made for, see `recast.splats.refiltered`.
        light: what lights it anew where it stands, or None for an actor that keeps the light it was
            recorded in. Not saved with a scene.
        gait: how a person's body moves with the way that it goes, or None. Likewise.
    """

    track_id: str
    gaussians: Gaussians
    size: Array
    trajectory: Trajectory
    shadow: Gaussians | None = None
    appearance: Appearance | None = None
    deformation: Deforming | None = None
    low_pass: LowPass = CLASSIC
    light: Lighting | None = None
    gait: Gait | None = None

    def validate(self, where: str) -> None:
        """Raise ValueError naming the member of `where` at fault."""
        least, most = BOX_SIDE
        if self.size.shape != (3,) or not np.all((self.size >= least) & (self.size <= most)):
            raise ValueError(f"{where}.size: three metres of {least} to {most}, got {self.size}")
        self.trajectory.validate(where)
        check_gaussians(f"{where}.gaussians", self.gaussians)
        if self.shadow is not None:
            check_gaussians(f"{where}.shadow", self.shadow)
        if self.appearance is not None:
            self.appearance.validate(where, len(self.gaussians))
        if self.deformation is not None:
            self.deformation.validate(f"{where}.deformation", len(self.gaussians))
        if self.gait is not None:
            self.gait.validate(f"{where}.gait", len(self.gaussians))

    def coloured_at(self, timestamp_us: int) -> SceneActor:
        """The actor with the colours that it had at a time of the recording."""
        if self.appearance is None:
            return self
        share = share_of(self.trajectory, timestamp_us)
        return replace(self, gaussians=self.appearance.at(self.gaussians, share), appearance=None)

    def shaped_at(self, timestamp_us: int | None) -> SceneActor:
        """The actor with the shape that it had at a time of the recording, and rigid.

        Args:
            timestamp_us: time of the recording; None for the middle of the actor's time.
        """
        if self.deformation is None:
            return self
        first, last = (int(time) for time in self.trajectory.timestamps_us[[0, -1]])
        time = (first + last) // 2 if timestamp_us is None else timestamp_us
        with torch.no_grad():
            shaped = self.deformation.at(self.gaussians, self.trajectory, time)
        return replace(self, gaussians=shaped, deformation=None)

    def lit_at(self, pose: Array) -> SceneActor:
        """The actor in the light of `pose` (4, 4) `world_from_actor`."""
        return self if self.light is None else self.light.lit(self, pose)

    def stepped_at(self, pose: Array) -> SceneActor:
        """The actor with the limbs that it has at `pose` (4, 4) `world_from_actor`, and rigid."""
        if self.gait is None:
            return self
        return replace(self, gaussians=self.gait.at(self.gaussians, pose), gait=None)

    @property
    def drawn(self) -> Gaussians:
        """Gaussians and shadow together, actor-local; a deformable actor as `shaped_at(None)`."""
        gaussians = self.shaped_at(None).gaussians
        return gaussians if self.shadow is None else concatenate([gaussians, self.shadow])

    def exposed(self, affine: Tensor) -> SceneActor:
        """The actor with the colours' transform (3, 4), at all its times."""
        appearance = self.appearance
        if appearance is not None:
            appearance = replace(appearance, fourier=appearance.fourier @ affine[:, :3].T)
        return replace(self, gaussians=exposed(self.gaussians, affine), appearance=appearance)

    def frozen(self, device: torch.device) -> list[FrozenGaussians]:
        """What is drawn of it on a device as it stands: vehicle and shadow, actor-local."""
        return [freeze(self.gaussians.to(device), self.low_pass), *self._frozen_shadow(device)]

    def recoloured(
        self, parts: list[FrozenGaussians], device: torch.device
    ) -> list[FrozenGaussians]:
        """`frozen`, of parts that differ from it in their colours and their shadow alone."""
        return [parts[0].recoloured(self.gaussians.sh.to(device)), *self._frozen_shadow(device)]

    def _frozen_shadow(self, device: torch.device) -> list[FrozenGaussians]:
        return [] if self.shadow is None else [freeze(self.shadow.to(device))]


class DrawnActor:
    """An actor as it is drawn again and again: what does not change is worked out once.

    Several cameras share light and shape of one place and time; the last ones are kept.
    """

    def __init__(self, actor: SceneActor, device: torch.device) -> None:
        self._actor, self._device = actor, device
        self._parts = actor.frozen(device)
        self._lit: tuple[Array, list[FrozenGaussians]] | None = None
        self._shaped: tuple[int | None, int | None, list[FrozenGaussians]] | None = None

    def at(
        self, pose: Array, colours_us: int | None, shapes_us: int | None
    ) -> list[FrozenGaussians]:
        """What is drawn at a pose (4, 4) `world_from_actor`, actor-local.

        Args:
            colours_us, shapes_us: times of the recording, see `SceneRasterizer.draw`.
        """
        actor = self._actor
        if actor.deformation is not None:
            if self._shaped is None or self._shaped[:2] != (colours_us, shapes_us):
                if colours_us is not None:
                    actor = actor.coloured_at(colours_us)
                parts = actor.shaped_at(shapes_us).frozen(self._device)
                self._shaped = colours_us, shapes_us, parts
            return self._shaped[2]
        if actor.light is not None or actor.gait is not None:
            place = rounded(pose)
            same_for = place if actor.gait is None else np.array(pose)
            if self._lit is None or not np.array_equal(self._lit[0], same_for):
                lit = actor.lit_at(place)
                if actor.gait is None:
                    parts = lit.recoloured(self._parts, self._device)
                else:
                    parts = lit.stepped_at(pose).frozen(self._device)
                self._lit = same_for, parts
            return self._lit[1]
        if colours_us is not None and actor.appearance is not None:
            return actor.coloured_at(colours_us).recoloured(self._parts, self._device)
        return self._parts


def rounded(pose: Array) -> Array:
    """A pose (4, 4) on a grid of 10 cm and half a degree: light is worked out once for each."""
    quat = np.round(se3.matrix_to_quat(pose[:3, :3]) / TURN) * TURN
    place = np.round(pose[:3, 3] / PLACE_M) * PLACE_M
    return se3.from_rotation_translation(se3.quat_to_matrix(quat), place)


def check_gaussians(where: str, gaussians: Gaussians) -> None:
    """Raise ValueError naming the member of `where` at fault, see `Gaussians.fault`."""
    fault = gaussians.fault()
    if fault is not None:
        raise ValueError(f"{where}.{fault[0]}: {fault[1]}")


def draw(
    gaussians: Gaussians,
    camera_from_object: Array | Tensor,
    camera: PinholeCamera,
    low_pass: LowPass = CLASSIC,
    background: Sequence[float] | None = None,
) -> Rasterization:
    """Gaussians drawn through the filter `low_pass` that they were made for; differentiable.

    Args:
        gaussians: object frame.
        camera_from_object: (4, 4).
        camera: rectified camera.
        background: display colour; black if None.
    """
    return rasterize(
        gaussians,
        torch.as_tensor(np.array(camera_from_object)).float()
        if isinstance(camera_from_object, np.ndarray)  # which may be read-only
        else camera_from_object.float(),
        torch.from_numpy(camera.matrix).float(),
        camera.width,
        camera.height,
        background=None if background is None else torch.tensor(background),
        eps2d=low_pass.variance,
        antialiased=low_pass.antialiased,
    )


def orbit(
    gaussians: Gaussians,
    size: Array,
    *,
    views: int,
    width: int,
    height: int,
    elevation: float = float(np.radians(10.0)),
    background: tuple[float, float, float] = (0.55, 0.56, 0.58),
    low_pass: LowPass = CLASSIC,
) -> list[NDArray[np.uint8]]:
    """Render Gaussians about the origin from azimuths evenly around the z axis, the first from +x.

    Args:
        gaussians: z up, any unit.
        size: (3,) extents of what should fill the picture, same unit.
        views: number of pictures, counter-clockwise seen from above.
        width, height: pixels.
        elevation: elevation of the camera above the origin, radians.
        background: display colour behind it.
        low_pass: the filter that they were made for.

    Returns:
        `views` images (height, width, 3) uint8.
    """
    gaussians = gaussians.detach()
    camera = framing_camera(size, width, height)
    distance = _DISTANCE * float(np.linalg.norm(size))
    images = []
    for azimuth in np.arange(views) * 2 * np.pi / views:
        direction = se3.direction(azimuth, elevation)
        pose = look_at(distance * direction, np.zeros(3))
        with torch.no_grad():
            picture = draw(gaussians, pose, camera, low_pass, background)
        images.append((picture.rgb.clamp(0, 1) * 255).round().to(torch.uint8).numpy())
    return images


def framing_camera(size: Array, width: int, height: int) -> PinholeCamera:
    """A camera that sees the whole box from `turntable`'s distance in every direction."""
    distance = _DISTANCE * float(np.linalg.norm(size))
    radius = 0.5 * float(np.linalg.norm(size[:2]))
    # the widest part is about as far as the middle, the lowest visible one half a radius nearer
    across = width / 2 / (1.08 * radius) * distance
    upright = height / (size[2] + 0.45 * radius) * (distance - 0.5 * radius)
    focal = 0.9 * min(across, upright)
    return PinholeCamera(width, height, focal, focal, width / 2, height / 2)


def look_at(eye: Array, target: Array) -> Array:
    """`camera_from_object` (4, 4) of a level OpenCV camera at `eye` that looks at `target`."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return se3.from_rotation_translation(rotation, -rotation @ eye)
