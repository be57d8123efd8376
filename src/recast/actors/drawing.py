"""Pictures of a vehicle: drawn alone, beside the crop that it was made from, from all around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors.actor import Actor
from recast.actors.observation import Observation
from recast.arrays import Array
from recast.scene.actor import draw, orbit
from recast.splats import Gaussians, LowPass, concatenate
from recast.splats.gaussians import quat_to_matrix
from recast.splats.sh import C0

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
