"""The small planner: its sizes and settings, and what a step of its training sees and minimises."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, ValidationError
from torch import Tensor, nn
from torch.nn import functional

from recast.arrays import Array, BoolArray, Image
from recast.core.errors import InputError
from recast.core.files import read_json
from recast.core.records import Record, validation_error
from recast.planning.gtrs import (
    METRICS,
    BackboneConfig,
    BackboneStage,
    GtrsConfig,
    GtrsModel,
    ScoreWeights,
    network_input,
    new_model,
    training_loss,
)
from recast.planning.gtrs.config import ViewLayout
from recast.planning.gtrs.expert import SCORED
from recast.planning.gtrs.perception import COLUMN_SCALES, ROAD_SCALES
from recast.planning.gtrs.scores import DEMONSTRATED, comfortable, vocabulary_dropout
from recast.training.loop import StepLoss, StepRandom
from recast.training.state import TrainerSettings, overridden
from recast_tools.planner_training.samples import (
    CLUES,
    COLUMNS,
    RENDERERS,
    Renderer,
    SampleStore,
    augment,
    mirror_clues,
    mirror_columns,
    mirror_image,
    mirror_status,
)
from recast_tools.planner_training.targets import COLUMN_VALUES, unpacked

_ROAD = CLUES.index("lateral")
"""First of the clues about the road, which are read from the picture; those about the vehicle are
read from its columns."""
_MOVING = COLUMN_VALUES.index("vx")
_COLUMNS, _EXACT = 3.0, 0.3
"""Weight of what is read from the columns: without it, what is foreseen is wrong. And the error, in
usual sizes, from which on it counts linearly."""
_BESIDE, _FAR = 2.0, 22.0
"""Metres to one side, and ahead of the rear axle: kinds of samples."""
_CLOSING = 5.0
"""m/s by which the ego is faster than what is nearest: one more kind."""
_FORGOTTEN = 0.15
"""Share of the samples whose earlier image is left out, as at the first moment of a run."""

MINI_VIEWS = ViewLayout(
    width=480, height=320, crop_rows=32, crop_columns=104, input_width=512, input_height=128
)
"""Three cameras of the synthetic rig in the loop: 272 + 480 + 272 columns, averaged two by two."""

HALF_VIEWS = ViewLayout(
    width=240, height=160, crop_rows=16, crop_columns=52, input_width=512, input_height=128
)
"""The same rendered at half the size, for the training: a quarter of the cost."""
COLUMN_LOOKS = HALF_VIEWS.directions(8 * COLUMNS).reshape(COLUMNS, 8)
"""(32, 8) directions in which the columns are looked at, radians: a pedestrian 45 m away is met by
one of them."""


@dataclass(frozen=True)
class Batch:
    """Samples as tensors: B pictures, K speeds of each, L trajectories at each speed.

    Attributes:
        images: (B, 3, H, W) images in [0, 1].
        earlier: (B, 3, H, W) earlier images, where the model looks at them; the present
            ones where there are none.
        age: (B,) seconds by which they are earlier; 0 where there are none.
        status: (B K, 8) status vectors, those of a picture one after another.
        trajectories: (B K, L, 40, 3) trajectories that are scored.
        calm: (B K, L) bool, which of them are `comfortable`.
        targets: (B K, L) target sub-scores, by metric head.
        demonstration: (B K, 8, 3) poses of the best trajectories of all.
        clues: (B, 10).
        columns: (B, 32, 6), see `COLUMN_VALUES`.
    """

    images: Tensor
    earlier: Tensor | None
    age: Tensor
    status: Tensor
    trajectories: Tensor
    calm: Tensor
    targets: Mapping[str, Tensor]
    demonstration: Tensor
    clues: Tensor
    columns: Tensor


class GtrsTask:
    """Trains a GTRS model on stored samples, with the loss of the released training.

    Half of a batch is drawn, see `balanced`; the other half are their twins, the same situations
    with or without the vehicle, where there are some, and else other samples. Half of all are
    mirrored, and all but one in seven altered, see `augment`. Each picture is looked at once and
    scored at all its speeds, with a part of the primitives that is drawn for the step: twins have
    the same speeds, so that nothing but the picture tells them apart.

    Args:
        store: store of the samples.
        indices: indices of the samples to train on.
        model: model that is trained.
        batch: samples a step; even.
        kept: primitives scored in a step; all where there are fewer.
    """

    def __init__(
        self,
        store: SampleStore,
        indices: NDArray[np.int64],
        model: GtrsModel,
        batch: int,
        kept: int,
    ) -> None:
        self.store, self.indices, self.batch = store, indices, batch
        self.primitives = store.record.primitives
        self._mirror = self.primitives.mirror
        self._twin = np.where(np.isin(store.twin, indices), store.twin, -1)
        self._chances = balanced(store, indices)
        self._kept = min(kept, len(self.primitives))
        self.model = model
        self.modules: Mapping[str, nn.Module] = {"gtrs": model}

    def loss(self, step: int, random: StepRandom) -> StepLoss:
        """Loss of the batch of a step, and its terms."""
        rng = random.numpy
        drawn = rng.choice(self.indices, self.batch // 2, replace=False, p=self._chances)
        twins = self._twin[drawn]
        others = rng.choice(self.indices, len(drawn), replace=False, p=self._chances)
        chosen = np.concatenate([drawn, np.where(twins >= 0, twins, others)])
        mirrored = rng.uniform(size=len(chosen)) < 0.5
        ages = self._drawn_ages(chosen, twins >= 0, rng)
        images = [
            augment(self.picture(index, age), rng) for index, age in zip(chosen, ages, strict=True)
        ]
        scored = vocabulary_dropout(len(self.primitives), self._kept, random.torch).numpy()
        # How things move is against the speed that the images were taken at: the first one.
        every = np.arange(self.store.status.shape[1] if self.model.config.history is None else 1)
        found = self.of(self.gather(chosen, every, mirrored, images, ages, scored))
        return StepLoss(sum_of(found), {k: float(v.detach()) for k, v in found.items()})

    def _drawn_ages(
        self, chosen: NDArray[np.int64], paired: BoolArray, rng: np.random.Generator
    ) -> Array:
        """(B,) ages of the earlier images, of all that there are; 0 for none, now and then, too.

        What one of two twins lacks must not tell it from the other: they get the same.
        """
        there = [set(self.model.config.ages(self.store.earlier(index))) for index in chosen]
        half, ages = len(paired), np.zeros(len(chosen))
        for row, possible in enumerate(there):
            if row >= half and paired[row - half]:
                ages[row] = ages[row - half]
                continue
            if row < half and paired[row]:
                possible = possible & there[row + half]
            if possible and rng.uniform() > _FORGOTTEN:
                ages[row] = rng.choice(sorted(possible))
        return ages

    def age(self, index: int) -> float:
        """The age of the earlier image that the planner would look at; 0 without one."""
        return next(iter(self.model.config.ages(self.store.earlier(index))), 0.0)

    def picture(self, index: int, age: float | None = None) -> Image:
        """(H, W, 3) the image of a sample; above one of an age where the model looks at two, or
        above itself for age 0. None: of `age`."""
        now = self.store.image(index)
        if self.model.config.history is None:
            return now
        age = self.age(index) if age is None else age
        return np.concatenate(
            [now, self.store.image(self.store.earlier(index)[age]) if age else now]
        )

    def gather(
        self,
        chosen: NDArray[np.int64],
        speeds: NDArray[np.int64],
        mirrored: NDArray[np.bool_],
        images: Sequence[NDArray[np.uint8]] | None = None,
        ages: Array | None = None,
        scored: NDArray[np.int64] | None = None,
    ) -> Batch:
        """Samples as a batch.

        Args:
            chosen: (B,) indices of the samples.
            speeds: (K,) indices of the ego's speeds, the same for all samples.
            mirrored: (B,) whether a sample is taken in the mirror.
            images: pictures instead of those of `picture`.
            ages: (B,) ages of their earlier images; None for those of `age`.
            scored: (L,) indices of the primitives; None for all.
        """
        store, twice = self.store, self._mirror
        if scored is None:
            scored = np.arange(len(twice))
        pictures = [self.picture(i) for i in chosen] if images is None else list(images)
        if ages is None:
            ages = np.array([self.age(index) for index in chosen])
        at = np.ix_(chosen, speeds)
        # Of a mirrored sample a trajectory has the score that its mirror image has in the sample.
        alike = np.where(mirrored[:, None], twice[scored], scored)[:, None, None]
        scores = unpacked(np.take_along_axis(store.scores[at], alike, axis=-1))
        status, best, clues = store.status[at], store.best[at].astype(np.int64), store.clues[chosen]
        columns = store.columns[chosen]
        for row in np.flatnonzero(mirrored):
            pictures[row], columns[row] = mirror_image(pictures[row]), mirror_columns(columns[row])
            status[row], clues[row] = mirror_status(status[row]), mirror_clues(clues[row])
            best[row] = twice[best[row]]
        possible = self.primitives.trajectories(status.reshape(-1, status.shape[-1]))
        demonstrated = possible[np.arange(len(possible)), best.ravel()][:, DEMONSTRATED]
        trajectories = possible[:, scored]
        scores = np.moveaxis(scores, 2, 0).reshape(len(SCORED), -1, len(scored))
        targets = {name: torch.from_numpy(scores[i]) for i, name in enumerate(SCORED)}
        targets[METRICS[6]] = torch.ones_like(targets[SCORED[0]])
        # Channels last, as the pictures come: a step takes a fifth less.
        shown = torch.stack([network_input(picture) for picture in pictures]).contiguous(
            memory_format=torch.channels_last
        )
        now, *before = [shown] if self.model.config.history is None else shown.chunk(2, dim=2)
        return Batch(
            now,
            before[0] if before else None,
            torch.from_numpy(ages).float(),
            torch.from_numpy(status).flatten(0, 1),
            torch.from_numpy(trajectories),
            torch.from_numpy(comfortable(trajectories, status.reshape(len(trajectories), -1))),
            targets,
            torch.from_numpy(demonstrated),
            torch.from_numpy(clues),
            torch.from_numpy(columns),
        )

    def of(self, batch: Batch) -> dict[str, Tensor]:
        """Terms of the loss by name."""
        tokens = self.look(batch)
        logits = self.logits(tokens, batch)
        terms = training_loss(logits, batch.targets, batch.trajectories, batch.demonstration)
        if batch.earlier is not None:
            reads = self.model.foresight
            terms["clues"] = road_loss(reads.road(tokens), batch.clues)
            misread = column_loss(reads.columns(tokens), batch.columns, batch.age > 0)
            terms["columns"] = _COLUMNS * misread
        return terms

    def look(self, batch: Batch) -> Tensor:
        """Tokens (B, T, d) of the pictures, see `GtrsModel.look`."""
        earlier = None
        if batch.earlier is not None:
            # The backbone learns from the present images: a step takes a quarter less.
            with torch.no_grad():
                earlier = self.model.backbone(batch.earlier)
        return self.model.look(self.model.backbone(batch.images), earlier, batch.age)

    def logits(self, tokens: Tensor, batch: Batch) -> dict[str, Tensor]:
        """Logits (B K, L) of every head, from the tokens of `look`."""
        each = tokens.repeat_interleave(len(batch.status) // len(tokens), dim=0)
        return self.model.score(each, batch.status, batch.trajectories)


def balanced(store: SampleStore, indices: NDArray[np.int64]) -> Array:
    """(N,) probabilities with which samples are drawn: what is rare to be seen, more often.

    The samples are of kinds, by where the vehicle placed is (out of sight, ahead in the lane or
    beside it, near or far, driving along or facing the ego) and whether there is an earlier image;
    a kind is drawn as often as the root of its number. A car beside the lane that will cut in is
    in one of a hundred samples, and what to do about it must be decided in its first moments. What
    comes of it is no part of the kind: then what is foretold would be too likely.
    """
    present, x, y, along = store.clues[indices, :4].T
    beside, far = np.abs(y) > _BESIDE, x > _FAR
    columns = store.columns[indices]
    nearest = _nearness(columns).argmax(axis=1)
    closing = columns[np.arange(len(columns)), nearest, 4] < -_CLOSING
    kind = (present > 0) * (1 + beside + 2 * far + 4 * (along < 0) + 8 * closing)
    _, number, counts = np.unique(
        2 * kind + (store.before[indices] < 0), return_inverse=True, return_counts=True
    )
    chances = 1.0 / np.sqrt(counts[number])
    return np.asarray(chances / chances.sum())


_Columns = TypeVar("_Columns", NDArray[np.float32], Tensor)


def _nearness(columns: _Columns) -> _Columns:
    """The more, the nearer what columns (..., 6) show is; 0 where nothing is there."""
    return columns[..., 0] * (10.0 - columns[..., 1])


def sum_of(terms: Mapping[str, Tensor]) -> Tensor:
    """Sum of all terms: the loss."""
    return torch.stack(list(terms.values())).sum()


def road_loss(found: Tensor, clues: Tensor) -> Tensor:
    """Loss of what `Foresight.road` read, (B, 5), against clues (B, 10)."""
    return functional.smooth_l1_loss(found, clues[:, _ROAD:] / clues.new_tensor(ROAD_SCALES))


def column_loss(found: Tensor, columns: Tensor, known: Tensor) -> Tensor:
    """Presence by cross-entropy in every column, the rest where something is there.

    How it moves counts only where there is an earlier image.

    Args:
        found: (B, W, 6) what `Foresight.columns` read.
        columns: (B, 32, 6) what they show, W being a part of 32.
        known: (B,) bool.
    """
    each = columns.shape[1] // found.shape[1]
    wanted = columns.unflatten(1, (-1, each))
    wanted = wanted.gather(
        2, _nearness(wanted).argmax(dim=2)[..., None, None].expand(-1, -1, 1, len(COLUMN_VALUES))
    )
    wanted = wanted.squeeze(2) / columns.new_tensor(COLUMN_SCALES)
    there = wanted[..., 0]
    counted = there[..., None].repeat(1, 1, found.shape[-1])
    counted[..., _MOVING:] *= known[:, None, None]
    misses = functional.smooth_l1_loss(found, wanted, reduction="none", beta=_EXACT) * counted
    seen = functional.binary_cross_entropy_with_logits(found[..., 0], there)
    each_value = misses[..., 1:].sum(dim=(0, 1)) / counted[..., 1:].sum(dim=(0, 1)).clamp(min=1.0)
    return 2.0 * seen + each_value.sum()


def _stage(blocks: int, conv_channels: int, out_channels: int) -> BackboneStage:
    return BackboneStage(blocks=blocks, conv_channels=conv_channels, out_channels=out_channels)


MINI = GtrsConfig(
    backbone=BackboneConfig(
        stem=(16, 16, 32),
        stages=(_stage(1, 24, 48), _stage(1, 48, 96), _stage(3, 64, 192)),
        layers=3,
        frozen_norm=False,
    ),
    channels=128,
    feedforward=192,
    heads=4,
    decoder_layers=2,
    token_rows=8,
    token_columns=32,
    history=1.0,
)
"""A backbone that ends at stride 16: a vehicle 40 m ahead is 11 of 512 columns wide."""

MINI_SCORING = ScoreWeights(
    imitation=0.75,
    no_collision=9.0,
    drivable_area=2.0,
    direction=2.0,
    traffic_light=0.2,
    average=12.0,
    time_to_collision=5.0,
    progress=3.0,
    lane_keeping=6.0,
    comfort=10.0,
    blended=20.0,
)
"""Weights of the final score, chosen on six streets of seed 31: on 160 moments of recorded drives
and in 36 scenarios in closed loop with the truth. See docs/train_the_small_planner.md."""

_USUAL = {
    "no_at_fault_collisions": 1.0,
    "drivable_area_compliance": 1.0,
    "traffic_light_compliance": 5.0,
}
"""Logits that the heads begin with, where most trajectories are fine."""


def first_model(seed: int, config: GtrsConfig = MINI) -> GtrsModel:
    """The network before its first step; the vocabulary embedding is scaled to metres."""
    model = new_model(config, torch.Generator().manual_seed(seed))
    with torch.no_grad():
        # Raw metres come in, tens of them: unit weights would drown all else in a few entries.
        first = model.head.pos_embed[0]
        assert isinstance(first, torch.nn.Linear)
        first.weight.mul_(0.1)
        if config.history is not None:
            reads = model.foresight
            reads.directions.copy_(torch.from_numpy(MINI_VIEWS.directions(len(reads.directions))))
            nn.init.zeros_(reads.add[2].weight)  # type: ignore[arg-type]
        for name, logit in _USUAL.items():
            last = model.head.heads[name][-1]  # type: ignore[index]
            last.bias.fill_(logit)
    return model


class PlannerTrainingConfig(Record):
    """How the planner is trained; the defaults are the shipped one's.

    Attributes:
        trainer: optimiser and schedule.
        network: sizes.
        scoring: score weights of the exported planner, by which it is judged too.
        batch: samples a step, even.
        kept: primitives that are scored in a step.
        renderers: leave out samples that another one rendered, those held out too.
        judged: held-out samples that each line of the log is judged on; at the end all are.
        sheet_every: steps between sheets of held-out decisions; 0 draws none.
    """

    trainer: TrainerSettings = TrainerSettings(
        steps=4_800,
        lr=6e-4,
        schedule="cosine",
        warmup=300,
        ema_decay=0.998,
        clip=2.0,
        checkpoint_every=250,
        log_every=250,
    )
    network: GtrsConfig = MINI
    scoring: ScoreWeights = MINI_SCORING
    batch: int = Field(default=8, ge=2, multiple_of=2)
    kept: int = Field(default=192, ge=1)
    renderers: tuple[Renderer, ...] = Field(default=RENDERERS, min_length=1)
    judged: int = Field(default=96, ge=2)
    sheet_every: int = Field(default=2_000, ge=0)


def chosen_training(
    path: Path | None,
    seed: int = 0,
    steps: int | None = None,
    renderers: Sequence[Renderer] | None = None,
) -> PlannerTrainingConfig:
    """The shipped planner's settings, with what a JSON file and the arguments say instead.

    Raises:
        InputError: the file is missing, no JSON object, or names what does not exist.
    """
    chosen = PlannerTrainingConfig().model_dump(mode="json")
    if path is not None:
        said = read_json(path)
        if not isinstance(said, dict):
            raise InputError(
                path, "JSON", "is not an object", "write an object of the settings to change"
            )
        chosen = overridden(chosen, said)
    chosen["trainer"]["seed"] = seed
    if steps is not None:
        chosen["trainer"]["steps"] = steps
    if renderers is not None:
        chosen["renderers"] = list(renderers)
    try:
        return PlannerTrainingConfig.model_validate(chosen)
    except ValidationError as error:
        raise validation_error(path or "`steps`", error, "give a value in range") from None
