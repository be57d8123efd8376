"""Sample sheets: held-out vehicles as the model makes them now, from three sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import se3
from recast.recar.camera import ELEVATION_DEG, FOV_DEG, camera_pose, pinhole
from recast.recar.picture import Image
from recast.splats import Gaussians, rasterize
from recast.trellis import GenerationLimits, ImageTo3D, generate

SIDES = (("front", 0.0), ("left", 90.0), ("rear", 180.0))
_TILE = 160
_CAPTION = 18
_DISTANCE = 1.9  # the unit cube's inside fills the picture through a lens of 40 degrees
_GREY = 0.55  # behind the vehicles, so that black ones are seen too


@dataclass(frozen=True)
class SheetRow:
    """One held-out vehicle.

    Attributes:
        name: of it.
        crop: (S, S, 3) what the encoder sees.
        rgba: the picture.
        truth: what the target decodes to.
    """

    name: str
    crop: Image
    rgba: Image
    truth: Gaussians


def sample_sheet(model: ImageTo3D, rows: Sequence[SheetRow], seed: int) -> Image:
    """(H, W, 3) uint8; a row for every vehicle: input, three sides as sampled, and the target's.

    A vehicle whose structure is empty or too large shows as such.

    Args:
        model: whose networks may be in training.
        rows: the vehicles.
        seed: of the noise, the same for each sheet.
    """
    sheet = []
    for row in rows:
        tiles = [_captioned(_scaled(row.crop), f"input {row.name}")]
        try:
            made = generate(
                model, [[row.rgba]], [seed], names=[row.name], limits=GenerationLimits()
            ).vehicles[0]
            tiles += _sides(made.gaussians, f"sampled ({len(made.coords)} voxels)")
        except InputError as error:
            blank = np.full((_TILE, _TILE, 3), round(255 * _GREY), np.uint8)
            tiles += [_captioned(blank, error.problem)] + [_captioned(blank, "")] * 2
        tiles += _sides(row.truth, "target")
        sheet.append(np.hstack(tiles))
    found: Image = np.vstack(sheet)
    return found


def _sides(gaussians: Gaussians, what: str) -> list[Image]:
    captions = [f"{name}: {what}" if i == 0 else name for i, (name, _) in enumerate(SIDES)]
    return [
        _captioned(render_side(gaussians, azimuth, _TILE), caption)
        for caption, (_, azimuth) in zip(captions, SIDES, strict=True)
    ]


@torch.no_grad()
def render_side(gaussians: Gaussians, azimuth_deg: float, pixels: int) -> NDArray[np.uint8]:
    """A vehicle in the unit cube from 15 degrees above, before grey: (pixels, pixels, 3)."""
    camera = pinhole(pixels, pixels, FOV_DEG)
    pose = se3.inverse(camera_pose(azimuth_deg, ELEVATION_DEG, _DISTANCE))
    picture = rasterize(
        gaussians.to("cpu"), torch.from_numpy(pose).float(),
        torch.from_numpy(camera.matrix).float(), pixels, pixels,
        background=torch.full((3,), _GREY),
    )  # fmt: skip
    return np.asarray((picture.rgb.clamp(0, 1).numpy() * 255).round(), np.uint8)


def _scaled(image: Image) -> Image:
    return np.asarray(cv2.resize(image, (_TILE, _TILE), interpolation=cv2.INTER_AREA), np.uint8)


def _captioned(tile: Image, caption: str) -> Image:
    """A tile under its caption, with a white edge."""
    sheet = np.full((_TILE + _CAPTION + 4, _TILE + 4, 3), 255, np.uint8)
    sheet[_CAPTION : _CAPTION + _TILE, :_TILE] = tile
    cv2.putText(
        sheet, caption[:30], (2, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.34, (40, 40, 40), 1, cv2.LINE_AA
    )
    return sheet
