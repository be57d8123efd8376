"""Put an actor in the place of a scene's own model of a track; draw it alone, and beside its crop.

What the log showed of a vehicle has the light of the places where it was seen. What is mirrored has
the light of the other side. What a generator invented has the colours of the sides that were seen,
in a light that is the same from all around.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from recast.actors.actor import Actor, Shares
from recast.actors.icp import outer_surface, thinned
from recast.actors.observation import Observation
from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import Trajectory
from recast.scene import StreetScene
from recast.scene.actor import draw, orbit
from recast.scene.light import (
    ActorLight,
    CastShadow,
    LitSurface,
    SceneLight,
    SeenShadow,
    recorded_light,
)
from recast.scene.street_scene import pose_at
from recast.splats import Gaussians, LowPass, concatenate
from recast.splats.gaussians import C0, quat_to_matrix

_SHADE = 0.55  # brightness of what lies flat against what stands upright
_RENDER_WIDTH = 160  # pixels: enough to tell lamps from grilles
_GAINS = (0.3, 3.0)  # of the light, where colours are compared


def turntable(
    actor: Actor,
    *,
    views: int = 8,
    width: int = 640,
    height: int = 360,
    elevation: float = float(np.radians(10.0)),
    background: tuple[float, float, float] = (0.55, 0.56, 0.58),
    with_shadow: bool = True,
) -> list[NDArray[np.uint8]]:
    """Render an actor from azimuths evenly around it, with its contact shadow or without.

    The first view faces its front; see `orbit`.
    """
    parts = [actor.gaussians, actor.shadow] if with_shadow else [actor.gaussians]
    return orbit(
        concatenate(parts),
        actor.size,
        views=views,
        width=width,
        height=height,
        elevation=elevation,
        background=background,
        low_pass=actor.low_pass,
    )


def coloured_by_shares(actor: Actor, colours: Sequence[Sequence[float]]) -> Actor:
    """The actor in the colours of its shares, shaded by which way its surface faces.

    Args:
        actor: refined actor.
        colours: colours of what was seen, mirrored and invented, three times RGB in [0, 1].

    Raises:
        ValueError: the actor has no shares.
    """
    if actor.shares is None:
        raise ValueError("coloured_by_shares: the actor has no shares")
    gaussians = actor.gaussians.detach()
    thin = gaussians.log_scales.argmin(dim=1)
    up = quat_to_matrix(gaussians.quats)[torch.arange(len(gaussians)), 2, thin].abs()
    mixed = actor.shares.columns @ torch.tensor(colours, dtype=torch.float32)
    mixed = mixed * (1 - (1 - _SHADE) * (1 - up))[:, None]
    return replace(actor, gaussians=replace(gaussians, sh=((mixed - 0.5) / C0)[:, None]))


@dataclass(frozen=True)
class Pictures:
    """An asset as the crop's camera sees it, beside the crop, both at most 160 pixels wide."""

    shown: Array  # (H, W, 3) display values on black; alpha: (H, W) of the asset
    alpha: Array
    wanted: Array  # (H, W, 3) display values of the crop; mask: (H, W) of the vehicle in it
    mask: NDArray[np.bool_]


def draw_beside(gaussians: Gaussians, low_pass: LowPass, observation: Observation) -> Pictures:
    """Draw an asset placed in the actor frame (metres) where the observation was made from.

    Args:
        low_pass: the filter that the Gaussians were made for.
        observation: crop, mask and camera.
    """
    height, width = observation.rgba.shape[:2]
    small = (min(width, _RENDER_WIDTH), max(1, round(height * min(1.0, _RENDER_WIDTH / width))))
    camera = observation.camera.resized(*small)
    with torch.no_grad():
        picture = draw(gaussians, observation.camera_from_object, camera, low_pass)
    crop = cv2.resize(observation.rgba, small, interpolation=cv2.INTER_AREA)
    return Pictures(
        picture.rgb.numpy().astype(np.float64),
        picture.alpha.numpy().astype(np.float64),
        crop[..., :3].astype(np.float64) / 255,
        crop[..., 3] > 127,
    )


def compare_views(
    gaussians: Gaussians, low_pass: LowPass, observation: Observation
) -> tuple[float, float]:
    """Silhouette overlap and colour difference of an asset; see `draw_beside`, `agree`."""
    return agree(draw_beside(gaussians, low_pass, observation))


def agree(pictures: Pictures) -> tuple[float, float]:
    """Intersection over union of the silhouettes, and `colour_difference` where both are."""
    alpha, mask = pictures.alpha > 0.5, pictures.mask
    union = int((alpha | mask).sum())
    both = alpha & mask
    if union == 0 or both.sum() < 20:
        return 0.0, 1.0
    overlap = float(both.sum() / union)
    return overlap, colour_difference(pictures.shown[both], pictures.wanted[both])


def colour_difference(shown: Array, wanted: Array) -> float:
    """Mean absolute difference of display values (N, 3), after the best gain of each channel."""
    gain = np.sum(wanted * shown, axis=0) / np.maximum(np.sum(shown * shown, axis=0), 1e-6)
    return float(np.abs(wanted - np.clip(shown * np.clip(gain, *_GAINS), 0, 1)).mean())


_NEIGHBOURS = 6
_SPINE = 0.6  # share of the half length over which a vehicle's middle line runs
_EVEN = 0.6  # light that generators give to what faces sideways, over what faces up
_LOOK_DOWN = 0.25  # of the direction to a logged camera, vertical over level
_POSES = 8  # of a trajectory, at most
_LEAST_SEEN = 1e-3
_SPACING = 0.14  # metres between Gaussians
_DARKNESS = 0.45  # peak opacity of one; neighbours overlap to about 0.9
_FADE = 0.32  # metres over which the shadow fades out around the footprint
_LIFT = 0.06  # metres: splats of the road are thick and sort by centre, lower ones hide the shadow
_THICKNESS = 0.003


def insert(scene: StreetScene, actor: Actor, *, relit: bool = True) -> StreetScene:
    """The scene with the track's Gaussians replaced, and its poses if the actor has refined ones.

    Vehicle and contact shadow are both actor-local and so move under one transform.

    Args:
        relit: whether the actor gets the light of where it stands; if not, it keeps the light that
            it was recorded in, wherever it goes.

    Raises:
        InputError: the scene has no model of the track.
        ValueError: the actor is to be lit and has no surface, see `outer_surface`.
    """
    require_model(scene, actor.track_id)
    native = scene.actors[actor.track_id]
    trajectory = actor.trajectory or native.trajectory
    light = None
    if relit:
        street = SceneLight.of(scene)
        if actor.sun is not None:  # what the actor's own shadow says of the sun
            street = replace(street, sun=street.sun.given(actor.sun))
        light = actor_light(street, actor, trajectory)
    return scene.with_actor(
        replace(
            native,
            gaussians=actor.gaussians,
            size=actor.size,
            trajectory=trajectory,
            shadow=actor.shadow if actor.seen_shadow is None else actor.seen_shadow,
            appearance=None,
            deformation=None,
            low_pass=actor.low_pass,
            light=light,
            gait=actor.gait,
        )
    )


def require_model(scene: StreetScene, track_id: str) -> None:
    """Refuse a scene that has no model of a track. Raises InputError: it has none."""
    if track_id not in scene.actors:
        known = ", ".join(scene.actors) or "none"
        raise InputError(
            scene.log_name or "scene",
            f"track {track_id}",
            f"is not an actor of the scene (actors: {known})",
            "train the scene with the track in force_dynamic",
        )


def actor_light(scene: SceneLight, actor: Actor, trajectory: Trajectory) -> ActorLight:
    """What is needed to light an actor anew in a street.

    Args:
        trajectory: trajectory of the track when the log saw it. For an actor that follows all
            images every pose counts the same; for one made of one image, the pose at that image.

    Raises:
        ValueError: the actor has no surface, see `outer_surface`.
    """
    hull = outer_surface(actor.gaussians)
    if actor.gait is None:
        normals = _normals(actor.gaussians, hull.points, hull.normals)
    else:  # flat patches of a body, their third axis outward
        normals = quat_to_matrix(actor.gaussians.quats)[:, :, 2].float()
    shares = actor.shares or _shares_of_view(normals, actor.provenance.azimuth)
    poses = list(thinned(trajectory.poses, _POSES))
    if actor.shares is None:
        pose = pose_at(trajectory, actor.provenance.timestamp_us)
        poses = poses if pose is None else [pose]
    surface = LitSurface.of(normals, actor.gaussians.means, actor.size)
    recorded = _recorded(scene, actor, surface, shares, poses)
    shadow = CastShadow(hull.points, actor.shadow, actor.size) if len(actor.shadow) else None
    seen = None
    if actor.seen_shadow is not None:
        yaws = np.array([se3.yaw(pose) for pose in poses])
        sun = float(np.mean([scene.place(pose, actor.size).sun.mean() for pose in poses]))
        seen = SeenShadow(actor.seen_shadow, yaws, sun)
    return ActorLight(scene, actor.gaussians, surface, recorded, shadow, seen)


def _normals(gaussians: Gaussians, points: Array, normals: Array) -> Tensor:
    """Outward normals (N, 3) of all Gaussians: means over the nearest of the outer surface."""
    half = np.abs(points).max(axis=0)
    spine = np.stack(
        [
            np.clip(points[:, 0], -_SPINE * half[0], _SPINE * half[0]),
            0 * points[:, 1],
            np.minimum(points[:, 2], 0),
        ],
        axis=-1,
    )
    outward = normals * np.where(np.sum(normals * (points - spine), axis=1) < 0, -1.0, 1.0)[:, None]
    centres = gaussians.means.detach().cpu().numpy().astype(np.float64)
    near = outward[cKDTree(points).query(centres, k=_NEIGHBOURS)[1]].mean(axis=1)
    near /= np.maximum(np.linalg.norm(near, axis=1, keepdims=True), 1e-9)
    return torch.from_numpy(near).float()


def _shares_of_view(normals: Tensor, azimuth: float) -> Shares:
    """Shares of a vehicle made of one image: what faced the camera was seen."""
    look = torch.tensor([np.cos(azimuth), np.sin(azimuth), _LOOK_DOWN], dtype=torch.float32)
    look = look / look.norm()
    seen = (normals @ look).clamp(0, 1)
    return Shares(seen, (1 - seen) * (_mirror(normals) @ look).clamp(0, 1))


def _recorded(
    scene: SceneLight, actor: Actor, surface: LitSurface, shares: Shares, poses: Sequence[Array]
) -> Tensor:
    """Light (N,) that each Gaussian's colour was recorded in."""
    own = recorded_light(scene, surface, actor.size, poses)
    if float(shares.seen.sum()) < _LEAST_SEEN:
        return own
    other = LitSurface.of(_mirror(surface.normals), actor.gaussians.means, actor.size)
    twin = recorded_light(scene, other, actor.size, poses)
    even = _EVEN + (1 - _EVEN) * surface.normals[:, 2]
    level = (shares.seen * own / even).sum() / shares.seen.sum()
    return shares.seen * own + shares.mirrored * twin + shares.invented * level * even


def _mirror(normals: Tensor) -> Tensor:
    return normals * torch.tensor([1.0, -1.0, 1.0])


_LIMBS = 0.5  # of a person's extents, its trunk's: limbs hide little of the sky


def shadow_below(gaussians: Gaussians, size: Array) -> Gaussians:
    """The contact shadow of a person in a box of `size` (3,) metres, actor-local."""
    points = gaussians.means.double().numpy()
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, _LIMBS * (high - low) / 2
    return contact_shadow(middle - half, middle + half, floor=-float(size[2]) / 2)


def contact_shadow(low: Array, high: Array, floor: float) -> Gaussians:
    """A soft-edged sheet under the footprint, actor-local, black from every side.

    Args:
        low, high: (3,) bounds of the vehicle in the actor frame, metres.
        floor: height of the ground plane in the actor frame.
    """
    half = (high[:2] - low[:2]) / 2
    centre = (high[:2] + low[:2]) / 2
    axes = []
    for reach in half + _FADE:
        count = max(2, int(np.ceil(2 * reach / _SPACING)) + 1)
        axes.append(np.linspace(-reach, reach, count))
    x, y = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
    # distance to a rounded rectangle somewhat inside the footprint, negative within
    inset = 0.12
    beyond = np.stack([np.abs(x) - half[0] + 0.3 + inset, np.abs(y) - half[1] + 0.3 + inset], -1)
    distance = (
        np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0) - 0.3
    )
    t = np.clip(1 - (distance + inset) / (_FADE + inset), 0.0, 1.0)
    opacity = _DARKNESS * t * t * (3 - 2 * t)
    kept = opacity > 0.01
    count = int(kept.sum())
    deviations = np.log([0.85 * _SPACING, 0.85 * _SPACING, _THICKNESS])
    means = np.stack(
        [centre[0] + x[kept], centre[1] + y[kept], np.full(count, floor + _LIFT)], axis=-1
    )
    logits = np.log(opacity[kept] / (1 - opacity[kept]))
    quats, log_scales = (np.tile(row, (count, 1)) for row in ([1.0, 0, 0, 0], deviations))
    parts = means, quats, log_scales, logits, np.full((count, 1, 3), -0.5 / C0)
    return Gaussians(*(torch.as_tensor(part, dtype=torch.float32) for part in parts))
