"""Sample sheets of a stage in training: the same held-out vehicles, views and noise throughout."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.files import write_bytes
from recast.geometry import se3
from recast.logs.images import encode
from recast.recar.targets import TargetCache
from recast.recar.training.conditions import ConditionTokens, ConditionView
from recast.recar.views import ELEVATION_DEG, FOV_DEG, camera_pose, pinhole, write_words
from recast.splats import Gaussians, rasterize
from recast.training.state import TrainingState
from recast.trellis import GenerationLimits, ImageTo3D, generate
from recast.trellis.sparse import SparseTensor

SIDES = (("front", 0.0), ("left", 90.0), ("rear", 180.0))
_TILE = 160
_CAPTION = 18
_DISTANCE = 1.9  # the unit cube's inside fills the picture through a lens of 40 degrees
_GREY = 0.55  # behind the vehicles, so that black ones are seen too
_SEED = 20_260


@dataclass(frozen=True)
class ProgressRow:
    """A held-out vehicle: `crop` (S, S, 3) for the encoder, picture, what the target decodes to."""

    name: str
    crop: Image
    rgba: Image
    truth: Gaussians


def sample_sheet(model: ImageTo3D, rows: Sequence[ProgressRow], seed: int) -> Image:
    """(H, W, 3) uint8; a row for every vehicle: input, three sides as sampled, and the target's.

    A vehicle whose structure is empty or too large shows as such. The model's networks may be in
    training; `seed` is of the noise, the same for each sheet.
    """
    sheet = []
    for row in rows:
        seen = cv2.resize(row.crop, (_TILE, _TILE), interpolation=cv2.INTER_AREA)
        tiles = [_captioned(np.asarray(seen, np.uint8), f"input {row.name}")]
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
    return np.vstack(sheet)


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
        gaussians.to("cpu"),
        torch.from_numpy(pose).float(),
        torch.from_numpy(camera.matrix).float(),
        pixels,
        pixels,
        background=torch.full((3,), _GREY),
    )
    return np.asarray((picture.rgb.clamp(0, 1).numpy() * 255).round(), np.uint8)


def _captioned(tile: Image, caption: str) -> Image:
    """A tile under its caption, with a white edge."""
    sheet = np.full((_TILE + _CAPTION + 4, _TILE + 4, 3), 255, np.uint8)
    sheet[_CAPTION : _CAPTION + _TILE, :_TILE] = tile
    write_words(sheet, caption[:30], (2, 13), 0.34)
    return sheet


class StageSheets:
    """Draws a sheet after every so many steps, with the weights that would be written then.

    Args:
        model: model whose flow is in training.
        targets: cache of targets.
        identities: held-out vehicles, a row each.
        tokens: tokens of their pictures.
        stem: stem of the files: path without the step.
        every: number of steps between sheets.
        average: whether the moving average is what is written.
    """

    def __init__(
        self,
        model: ImageTo3D,
        targets: TargetCache,
        identities: Sequence[str],
        tokens: ConditionTokens,
        stem: Path,
        every: int,
        average: bool,
    ) -> None:
        self._model, self._targets, self._tokens = model, targets, tokens
        self._stem, self._every, self._average = stem, every, average
        rng = np.random.default_rng(_SEED)
        self._rows = [self._row(one, rng) for one in identities]

    def __call__(self, state: TrainingState) -> None:
        """Draw a sheet where one is due."""
        if state.step % self._every:
            return
        with _written_weights(state, average=self._average):
            sheet = sample_sheet(self._model, self._rows, _SEED)
        path = self._stem.with_name(f"{self._stem.name}-{state.step:07d}.png")
        write_bytes(path, encode(sheet))

    def _row(self, identity: str, rng: np.random.Generator) -> ProgressRow:
        source = self._tokens.source
        view = ConditionView(identity, int(rng.integers(source.count(identity))))
        target, device = self._targets.target(identity), self._model.device
        latent = SparseTensor.stack(
            [torch.from_numpy(target.coords).to(device)],
            [torch.from_numpy(target.latent).to(device)],
        )
        return ProgressRow(
            identity,
            self._tokens.crop(view, None, rng),
            source.picture(identity, view.index),
            self._model.decode(latent)[0].to("cpu"),
        )


@contextmanager
def _written_weights(state: TrainingState, *, average: bool) -> Iterator[None]:
    """The weights that would be written now; those in training are put back to the bit."""
    if not average:
        yield
        return
    kept = {n: {k: v.clone() for k, v in m.state_dict().items()} for n, m in state.modules.items()}
    for name, one in state.averages.items():
        one.copy_to(state.modules[name])
    try:
        yield
    finally:
        for name, module in state.modules.items():
            module.load_state_dict(kept[name])
