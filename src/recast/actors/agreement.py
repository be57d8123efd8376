"""Which end is the front: how an asset, turned one way or the other, explains what was seen."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors.icp import Fit
from recast.actors.observation import Observation
from recast.arrays import Array
from recast.logs import Track
from recast.splats import Gaussians, LowPass, rasterize

_RENDER_WIDTH = 160  # pixels: enough to tell lamps from grilles


@dataclass(frozen=True)
class Agreement:
    """How a turned asset agrees with the observation.

    Attributes:
        lidar: fit to the LiDAR points after a short alignment; None where there are none.
        silhouette: intersection over union of its outline, seen from the crop's camera, and the
            mask.
        colour: mean absolute difference to the crop where both are, display values, after the best
            gain a channel.
    """

    lidar: Fit | None
    silhouette: float
    colour: float


# Differences that count as one unit of evidence, and the weight of the declared forward axis.
_LIDAR_UNIT = 0.015
_SILHOUETTE_UNIT = 0.03
_COLOUR_UNIT = 0.02
_AXES_WEIGHT = 1.5
_LIMIT = 4.0


@dataclass(frozen=True)
class Pictures:
    """An asset as the crop's camera sees it, beside the crop, both at most 160 pixels wide.

    Attributes:
        shown: (H, W, 3) display values on black; alpha: (H, W) of the asset.
        wanted: (H, W, 3) display values of the crop; mask: (H, W) of the vehicle in it.
    """

    shown: Array
    alpha: Array
    wanted: Array
    mask: NDArray[np.bool_]


def draw_beside(gaussians: Gaussians, low_pass: LowPass, observation: Observation) -> Pictures:
    """Draw an asset placed in the actor frame where the observation was made from.

    Args:
        gaussians: actor frame, metres.
        low_pass: the filter that they were made for.
        observation: crop, mask and camera.
    """
    height, width = observation.rgba.shape[:2]
    small = (min(width, _RENDER_WIDTH), max(1, round(height * min(1.0, _RENDER_WIDTH / width))))
    camera = observation.camera.resized(*small)
    with torch.no_grad():
        picture = rasterize(
            gaussians,
            torch.from_numpy(observation.camera_from_object).float(),
            torch.from_numpy(camera.matrix).float(),
            camera.width,
            camera.height,
            eps2d=low_pass.variance,
            antialiased=low_pass.antialiased,
        )
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
    """Overlap of the silhouettes, and mean difference of colours after the best gain a channel."""
    alpha, mask = pictures.alpha > 0.5, pictures.mask
    union = int((alpha | mask).sum())
    both = alpha & mask
    if union == 0 or both.sum() < 20:
        return 0.0, 1.0
    wanted, shown = pictures.wanted[both], pictures.shown[both]
    gain = np.sum(wanted * shown, axis=0) / np.maximum(np.sum(shown * shown, axis=0), 1e-6)
    difference = np.abs(wanted - np.clip(shown * np.clip(gain, 0.3, 3.0), 0, 1))
    return float(both.sum() / union), float(difference.mean())


def heading_agreement(track: Track) -> float:
    """Cosine between the track's heading and its motion, averaged over the way; 0 when it stands.

    Labels may be reversed: then the box's front is not the vehicle's.
    """
    positions = track.trajectory.poses[:, :2, 3]
    steps = np.diff(positions, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if np.linalg.norm(positions[-1] - positions[0]) < 2.0:
        return 0.0
    headings = track.trajectory.poses[:-1, :2, 0]
    return float(np.sum(steps * headings) / max(float(lengths.sum()), 1e-9))


def front_votes(
    as_is: Agreement, turned: Agreement, declared: bool, heading: float
) -> dict[str, float]:
    """Evidence, in units, for the first of two orientations half a turn apart; each at most 4.

    Args:
        as_is: agreement with the asset's forward axis along the box's.
        turned: agreement after half a turn.
        declared: whether the asset's axis convention says where its front is.
        heading: from `heading_agreement`.
    """

    def vote(difference: float, unit: float) -> float:
        return float(np.clip(difference / unit, -_LIMIT, _LIMIT))

    # a box labelled back to front makes the declared front the wrong one; a standing vehicle's
    # label is believed a little
    direction = heading if heading != 0.0 else 0.5
    lidar = {}
    if as_is.lidar is not None and turned.lidar is not None:
        lidar["lidar"] = vote(turned.lidar.mean - as_is.lidar.mean, _LIDAR_UNIT)
    return lidar | {
        "silhouette": vote(as_is.silhouette - turned.silhouette, _SILHOUETTE_UNIT),
        "colour": vote(turned.colour - as_is.colour, _COLOUR_UNIT),
        "heading": _AXES_WEIGHT * direction if declared else 0.0,
    }
