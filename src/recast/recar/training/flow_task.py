"""Flow matching towards cached targets, given one picture of each vehicle."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from recast.errors import InputError
from recast.recar.targets import Target, TargetCache
from recast.recar.training.batches import balanced_parts, draw_identities
from recast.recar.training.latents import Flow
from recast.recar.training.stage_config import FlowObjective
from recast.recar.training.task import StepLoss, StepRandom
from recast.recar.training.tokens import ConditionTokens, Perturb, View
from recast.trellis.flow import FlowLoss, FlowMatching, drop_condition, sample_timesteps


class FlowTask:
    """Trains one flow: the published objective, conditioned on one randomly drawn view.

    A batch holds different vehicles. It is drawn as a whole and then split into the parts that are
    accumulated or go to other processes, balanced by voxels.

    Args:
        flow: what is trained.
        targets: the cache.
        identities: those to train on; each has pictures.
        tokens: of the conditions.
        objective: batch, times, dropping.
        perturb: alters the picture of a condition; None leaves all clean.
        clean_share: probability rho that a condition is left clean all the same.
        encoder: trained with the flow under the name "image_encoder"; its tokens then carry
            gradients.

    Raises:
        InputError: fewer than two identities.
    """

    def __init__(
        self,
        flow: Flow,
        targets: TargetCache,
        identities: Sequence[str],
        tokens: ConditionTokens,
        objective: FlowObjective,
        perturb: Perturb | None = None,
        clean_share: float = 0.2,
        encoder: nn.Module | None = None,
    ) -> None:
        if len(identities) < 2:
            raise InputError(
                targets.folder, "train identities",
                f"{len(identities)} can be used, at least two are needed",
                "accept more targets, or name the set that they were made from",
            )  # fmt: skip
        self.flow = flow
        self.targets = targets
        self.identities = tuple(identities)
        self.tokens = tokens
        self.objective = objective
        self.perturb = perturb
        self.clean_share = clean_share
        self.modules: Mapping[str, nn.Module] = {"flow": flow.model}
        if encoder is not None:
            self.modules = {"flow": flow.model, "image_encoder": encoder}
        self.matching = FlowMatching(objective.sigma_min)

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
        """Loss at random times and with random noise.

        Args:
            targets: of the samples.
            cond: (B, L, C) their tokens.
            generator: on the CPU, so that every device sees the same times and noise.
        """
        objective, data = self.objective, self.flow.data(targets)
        t = sample_timesteps(len(targets), generator, objective.time_mean, objective.time_std)
        noise = torch.randn(data.x0.shape, generator=generator)
        device = data.x0.device
        with autocast(device, objective.autocast):
            return self.matching.loss(
                data.velocity, data.x0, cond, t.to(device), noise.to(device), data.batch
            )

    def _part(self, random: StepRandom) -> tuple[list[View], list[Target]]:
        """Views and targets of this part of the step's batch."""
        rng = random.whole()
        batch = draw_identities(self.identities, self.objective.batch, rng)
        numbers = [int(rng.integers(self.tokens.source.count(one))) for one in batch]
        loads = [self.flow.load(self.targets.records[one].voxels) for one in batch]
        mine = balanced_parts(loads, random.parts)[random.part]
        targets = [self.targets.target(batch[i]) for i in mine]
        return [View(batch[i], numbers[i]) for i in mine], targets


def autocast(device: torch.device, dtype: str | None) -> contextlib.AbstractContextManager[object]:
    """Compute in bfloat16 where asked for; weights and their gradients stay float32."""
    if dtype is None:
        return contextlib.nullcontext()
    return torch.autocast(device.type, getattr(torch, dtype))
