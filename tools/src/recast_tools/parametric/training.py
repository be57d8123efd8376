"""The training of the parametric model, and what it reaches on held-out designs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from recast.actors.parametric.model import MODEL_FILE, ParametricModel
from recast.actors.parametric.network import SHAPES, ParametricNetwork
from recast.core.files import write_json
from recast.training.loop import Processes, StepLoss, StepRandom, Watch, train
from recast.training.state import TrainerSettings
from recast_tools.parametric.dataset import DesignRows, read_rows

STEPS = 3_200
BATCH = 40
REPORT_FILE = "report.json"
_DROPOUT, _HIDDEN = 0.15, 0.1
_SEED = 5
_PROBED = 256  # held-out rows of each line of the log


@dataclass(frozen=True)
class ParametricTask:
    """Regression and flow, trained together: the first keeps the second from ignoring the picture.

    Attributes:
        network: network to train; its standardisation is set.
        rows: rows to train on.
        batch: photographs a step.
    """

    network: ParametricNetwork
    rows: DesignRows
    batch: int = BATCH

    @property
    def modules(self) -> Mapping[str, nn.Module]:
        """See `TrainingTask.modules`."""
        return {"parametric": self.network}

    def loss(self, step: int, random: StepRandom) -> StepLoss:
        """See `TrainingTask.loss`."""
        count = len(self.rows.numbers)
        rows = self.rows.chosen(random.numpy.choice(count, min(self.batch, count), replace=False))
        planes = with_planes_hidden(rows.planes, random.torch)
        feature = self.network.encode(planes, rows.geometry)
        found = self.network.loss(
            feature, rows.numbers, rows.choices, random.torch, dropout=_DROPOUT
        )
        flow = found.flow.mean()
        logs = {"numbers": found.numbers, "choices": found.choices, "flow": flow}
        return StepLoss(
            found.numbers + found.choices + flow,
            {name: float(value.detach()) for name, value in logs.items()},
        )


def with_planes_hidden(planes: Tensor, generator: torch.Generator) -> Tensor:
    """Planes (B, pixels, 5) with one in ten unseen, or the network learns designs by heart."""
    parts = planes.split([rows * columns for rows, columns in SHAPES.values()], dim=1)
    hidden = torch.rand(len(parts), len(planes), 1, 1, generator=generator) < _HIDDEN
    return torch.cat(
        [part.masked_fill(one, 0) for part, one in zip(parts, hidden, strict=True)], dim=1
    )


@dataclass(frozen=True)
class DesignGap:
    """Loss of the flow on held-out rows with their own photographs, and with those of others.

    A gap of zero is an ignored photograph.
    """

    network: ParametricNetwork
    rows: DesignRows

    @torch.no_grad()
    def __call__(self) -> dict[str, float]:
        """`held_out`, `gap`, and `error`: mean squared error of the numbers over their variance."""
        rows = self.rows.chosen(slice(0, _PROBED))
        feature = self.network.encode(rows.planes, rows.geometry)
        losses = []
        for seen in (feature, feature.roll(len(feature) // 2, dims=0)):
            generator = torch.Generator().manual_seed(_SEED)
            found = self.network.loss(seen, rows.numbers, rows.choices, generator)
            losses.append(float(found.flow.mean()))
        error = _squared(self.network, feature, rows).mean()
        gap = losses[1] - losses[0]
        return {"held_out": losses[0], "gap": gap, "error": float(error)}


def _squared(network: ParametricNetwork, feature: Tensor, rows: DesignRows) -> Tensor:
    """(N, numbers) squared errors over the prior's variance."""
    mean = network.natural(network.regress(feature).mean)
    return ((mean - rows.numbers) / network.spread).square()


def train_parametric(
    designs: Path,
    out: Path,
    steps: int,
    seed: int,
    watch: Watch,
    checkpoint_every: int = 100,
    processes: Processes | None = None,
) -> dict[str, Any]:
    """Train to the last step, resumed where there is a checkpoint; write model and report.

    Args:
        processes: see `recast.training.loop.train`; each takes `BATCH` photographs a step.

    Raises:
        InputError: see `read_rows` and `recast.training.loop.train`.
    """
    rows, held_out = read_rows(designs)
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(seed)
        model = ParametricModel.fresh()
    network = model.network
    standardise(network, rows.numbers)
    settings = TrainerSettings(
        steps=steps,
        lr=1.5e-3,
        schedule="cosine",
        warmup=min(200, steps // 4),
        betas=(0.9, 0.99),
        weight_decay=0.05,
        ema_decay=0.998,
        clip=1.0,
        seed=seed,
        checkpoint_every=checkpoint_every,
        log_every=100,
    )
    state = train(
        ParametricTask(network, rows),
        settings,
        out,
        watch=watch,
        probe=DesignGap(network, held_out),
        processes=processes,
    )
    if processes is not None and not processes.first:
        return {}
    for average in state.averages.values():
        average.copy_to(network)
    network.eval()
    model.save(out / MODEL_FILE)
    report = evaluate(ParametricModel.load(out / MODEL_FILE), held_out)
    write_json(out / REPORT_FILE, report)
    return report


def standardise(network: ParametricNetwork, numbers: Tensor) -> None:
    """Set centre and spread to those of numbers (N, numbers); those that never vary get 1."""
    values = numbers.double().numpy()
    centre, spread = values.mean(axis=0), values.std(axis=0)
    spread = np.where(spread > 1e-5, spread, 1.0)
    network.centre.copy_(torch.from_numpy(centre))
    network.spread.copy_(torch.from_numpy(spread))


@torch.no_grad()
def evaluate(model: ParametricModel, rows: DesignRows) -> dict[str, Any]:
    """Errors on held-out rows, by field.

    For each number the root mean squared error over the prior's standard deviation, and the share
    of truths within one predicted deviation (0.68 if well calibrated); for each choice the share
    that is right beside that of the most frequent option; of the flow the gap.
    """
    network, codec = model.network, model.codec
    features = torch.cat(
        [
            network.encode(part.planes, part.geometry)
            for start in range(0, len(rows.numbers), 256)
            for part in [rows.chosen(slice(start, start + 256))]
        ]
    )
    found = network.regress(features)
    squared = _squared(network, features, rows)
    within = (squared.sqrt() < (0.5 * found.logvar).exp()).float()
    numbers = {
        one.path: [round(float(v), 3) for v in (error.sqrt(), share)]
        for one, error, share in zip(
            codec.numbers, squared.mean(dim=0), within.mean(dim=0), strict=True
        )
    }
    choices = {}
    for index, one in enumerate(codec.choices):
        truth = rows.choices[:, index]
        right = float((found.logits[index].argmax(dim=1) == truth).float().mean())
        usual = float(torch.bincount(truth).max() / len(truth))
        choices[one.path] = [round(right, 3), round(usual, 3)]
    return {
        "rows": len(rows.numbers),
        "relative_error": round(float(np.mean([v[0] for v in numbers.values()])), 4),
        **{k: round(v, 4) for k, v in DesignGap(network, rows)().items()},
        "numbers": numbers,
        "choices": choices,
    }
