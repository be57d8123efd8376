"""Flow matching towards cached targets, given one picture of each vehicle; and sample sheets."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.files import write_bytes
from recast.core.images import draw_text
from recast.logs.images import encode
from recast.recar.target_cache import Target, TargetCache
from recast.recar.target_views import Viewpoint, render
from recast.recar.training_conditions import (
    ConditionTokens,
    ConditionView,
    Perturb,
    balanced_parts,
    draw_identities,
)
from recast.recar.training_config import FlowObjective
from recast.splats import Gaussians
from recast.training.loop import StepLoss, StepRandom
from recast.training.state import TrainingState
from recast.trellis import GenerationLimits, ImageTo3D, generate
from recast.trellis.flow_transformer import SLatFlowModel, SparseStructureFlowModel
from recast.trellis.sampler import (
    FlowLoss,
    FlowMatching,
    Velocity,
    drop_condition,
    sample_timesteps,
)
from recast.trellis.sparse import SparseTensor

_SEED = 20_260


@dataclass(frozen=True)
class FlowData:
    """A batch: dense `x0` (B, ...), or sparse (T, C) with the sample of each row, `batch` (T,).

    `velocity` is the network on this batch.
    """

    x0: Tensor
    batch: Tensor | None
    velocity: Velocity


@dataclass(frozen=True)
class StructureFlow:
    """Structure latents as sampled, whatever their spread: the published are not normalised."""

    model: SparseStructureFlowModel

    def load(self, voxels: int) -> int:
        """All alike."""
        return 1

    def data(self, targets: Sequence[Target]) -> FlowData:
        """Dense (B, C, r, r, r).

        Raises:
            InputError: a target's structure is of another shape.
        """
        config = self.model.config
        shape = (config.in_channels, *[config.resolution] * 3)
        for one in targets:
            if one.structure.shape != shape:
                problem = f"is {one.structure.shape}, but the network takes {shape}"
                mend = "make the targets with a model of the same size"
                raise InputError("targets", "structure", problem, mend)
        stacked = torch.stack([torch.from_numpy(one.structure) for one in targets])
        return FlowData(stacked.to(self.model.device), None, self.model)


@dataclass(frozen=True)
class LatentFlow:
    """Structured latents on the voxels of the target, normalised as the checkpoint says.

    Attributes:
        mean, std: (C,) mean and standard deviation of the latents, as the checkpoint gives them.
    """

    model: SLatFlowModel
    mean: Tensor
    std: Tensor

    def load(self, voxels: int) -> int:
        """Voxels."""
        return voxels

    def data(self, targets: Sequence[Target]) -> FlowData:
        """Sparse (T, C), the voxels of all samples one after another."""
        raw = SparseTensor.stack(
            [torch.from_numpy(one.coords).int() for one in targets],
            [torch.from_numpy(one.latent) for one in targets],
        ).to(self.model.device)
        start = raw.with_feats((raw.feats - self.mean) / self.std)

        def velocity(x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
            out: SparseTensor = self.model(start.with_feats(x), t, cond)
            return out.feats

        return FlowData(start.feats, start.batch, velocity)


Flow = StructureFlow | LatentFlow


@dataclass(frozen=True)
class FlowTask:
    """Trains one flow: the published objective, conditioned on one randomly drawn view.

    A batch holds different vehicles. It is drawn as a whole and then split into the parts that are
    accumulated or go to other processes, balanced by voxels.

    Attributes:
        identities: vehicles to train on; each has pictures.
        perturb: function that alters the picture of a condition; None leaves all clean.
        clean_share: probability rho that a condition is left clean all the same.
        encoder: encoder that is trained with the flow under the name "image_encoder"; its tokens
            then carry gradients.

    Raises:
        InputError: fewer than two identities.
    """

    flow: Flow
    targets: TargetCache
    identities: Sequence[str]
    tokens: ConditionTokens
    objective: FlowObjective
    perturb: Perturb | None = None
    clean_share: float = 0.2
    encoder: nn.Module | None = None

    def __post_init__(self) -> None:
        if len(self.identities) < 2:
            problem = f"{len(self.identities)} can be used, at least two are needed"
            mend = "accept more targets, or name the set that they were made from"
            raise InputError(self.targets.folder, "train identities", problem, mend)

    @property
    def modules(self) -> Mapping[str, nn.Module]:
        """See `TrainingTask.modules`."""
        own = {"flow": self.flow.model}
        return own if self.encoder is None else {**own, "image_encoder": self.encoder}

    def loss(self, step: int, random: StepRandom) -> StepLoss:
        """Loss of one part of the batch of a step, and its means by tenth of time."""
        views, targets = self._part(random)
        clean = random.numpy.random(len(views)) < self.clean_share
        alters = [None if one else self.perturb for one in clean]
        cond = self.tokens.of(views, alters, random.numpy)
        cond, dropped = drop_condition(cond, self.objective.condition_drop, random.torch)
        found = self.flow_loss(targets, cond, random.torch)
        logs = {f"t{i}": float(v) for i, v in enumerate(found.bins)}
        logs["altered"] = float(np.mean([alter is not None for alter in alters]))
        logs["dropped"] = float(dropped.float().mean())
        return StepLoss(found.loss, logs)

    def flow_loss(
        self, targets: Sequence[Target], cond: Tensor, generator: torch.Generator
    ) -> FlowLoss:
        """Loss at random times and with random noise, given the targets' tokens `cond` (B, L, C).

        The generator is on the CPU, so that every device sees the same times and noise.
        """
        objective, data = self.objective, self.flow.data(targets)
        t = sample_timesteps(len(targets), generator, objective.time_mean, objective.time_std)
        noise = torch.randn(data.x0.shape, generator=generator)
        device = data.x0.device
        with autocast(device, objective.autocast):
            return FlowMatching(objective.sigma_min).loss(
                data.velocity, data.x0, cond, t.to(device), noise.to(device), data.batch
            )

    def _part(self, random: StepRandom) -> tuple[list[ConditionView], list[Target]]:
        """Views and targets of this part of the step's batch."""
        rng = random.whole()
        batch = draw_identities(self.identities, self.objective.batch, rng)
        numbers = [int(rng.integers(self.tokens.source.count(one))) for one in batch]
        loads = [self.flow.load(self.targets.records[one].voxels) for one in batch]
        mine = balanced_parts(loads, random.parts)[random.part]
        targets = [self.targets.target(batch[i]) for i in mine]
        return [ConditionView(batch[i], numbers[i]) for i in mine], targets


def autocast(device: torch.device, dtype: str | None) -> contextlib.AbstractContextManager[object]:
    """Compute in bfloat16 where asked for; weights and their gradients stay float32."""
    if dtype is None:
        return contextlib.nullcontext()
    return torch.autocast(device.type, getattr(torch, dtype))


class ConditionGap:
    """Losses of fixed held-out vehicles, always at the same times and with the same noise.

    A flow that ignores its picture has the same loss when every vehicle is given that of another:
    a gap of zero. Small flows fall into that for good, so it is watched from the start.

    Args:
        tokens: tokens of held-out pictures.
        identities: held-out vehicles, at least two.
    """

    def __init__(self, task: FlowTask, tokens: ConditionTokens, identities: Sequence[str]) -> None:
        rng = np.random.default_rng(_SEED)
        self._task = task
        self._tokens = tokens
        self._targets = [task.targets.target(one) for one in identities]
        self._views = [
            ConditionView(one, int(rng.integers(tokens.source.count(one)))) for one in identities
        ]

    @torch.no_grad()
    def __call__(self) -> dict[str, float]:
        """`held_out` (loss), `shuffled` (loss with exchanged pictures) and `gap` between them."""
        clean = [None] * len(self._views)
        cond = self._tokens.of(self._views, clean, np.random.default_rng(_SEED))
        losses = []
        for tokens in (cond, cond.roll(1, dims=0)):
            generator = torch.Generator().manual_seed(_SEED)
            losses.append(float(self._task.flow_loss(self._targets, tokens, generator).loss))
        true, shuffled = losses
        return {"held_out": true, "shuffled": shuffled, "gap": shuffled - true}


SIDES = (("front", 0.0), ("left", 90.0), ("rear", 180.0))
_TILE = 160
_CAPTION = 18
_DISTANCE = 1.9  # the unit cube's inside fills the picture through a lens of 40 degrees
_GREY = 0.55  # behind the vehicles, so that black ones are seen too


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
    tiles = []
    for caption, (_, azimuth) in zip(captions, SIDES, strict=True):
        shown = render(gaussians.to("cpu"), Viewpoint(azimuth, distance=_DISTANCE), _TILE)
        tiles.append(_captioned(shown.before(_GREY), caption))
    return tiles


def _captioned(tile: Image, caption: str) -> Image:
    """A tile under its caption, with a white edge."""
    sheet = np.full((_TILE + _CAPTION + 4, _TILE + 4, 3), 255, np.uint8)
    sheet[_CAPTION : _CAPTION + _TILE, :_TILE] = tile
    draw_text(sheet, (2, 13), caption[:30], (40, 40, 40), 10, "ls")
    return sheet


@dataclass
class StageSheets:
    """Draws a sheet after every so many steps, with the weights that would be written then.

    Attributes:
        identities: held-out vehicles, a row each.
        stem: stem of the files: path without the step.
        every: number of steps between sheets.
        average: whether the moving average is what is written.
    """

    model: ImageTo3D
    targets: TargetCache
    identities: Sequence[str]
    tokens: ConditionTokens
    stem: Path
    every: int
    average: bool

    def __post_init__(self) -> None:
        rng = np.random.default_rng(_SEED)
        self._rows = [self._row(one, rng) for one in self.identities]

    def __call__(self, state: TrainingState) -> None:
        """Draw a sheet where one is due."""
        if state.step % self.every:
            return
        with _written_weights(state, average=self.average):
            sheet = sample_sheet(self.model, self._rows, _SEED)
        path = self.stem.with_name(f"{self.stem.name}-{state.step:07d}.png")
        write_bytes(path, encode(sheet))

    def _row(self, identity: str, rng: np.random.Generator) -> ProgressRow:
        source = self.tokens.source
        view = ConditionView(identity, int(rng.integers(source.count(identity))))
        target, device = self.targets.target(identity), self.model.device
        latent = SparseTensor.stack(
            [torch.from_numpy(target.coords).to(device)],
            [torch.from_numpy(target.latent).to(device)],
        )
        return ProgressRow(
            identity,
            self.tokens.crop(view, None, rng),
            source.picture(identity, view.index),
            self.model.decode(latent)[0].to("cpu"),
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
