"""Settings of a training and all that it changes: weights, moments, averages; their checkpoints."""

from __future__ import annotations

import json
import math
import os
import re
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field, FiniteFloat, ValidationError
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor, nn

from recast.core.errors import InputError
from recast.core.files import atomic_file, parse_json
from recast.core.records import Record, validation_error
from recast.core.torch_file import opened_safetensors, read_safetensors, require_state

STATE_FILE = "state.safetensors"
_HEADER = "recast-training"
_MEND = "remove the folder and train again"
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # of AdamW
Share = Annotated[float, Field(ge=0, lt=1)]


class TrainerSettings(Record):
    """Optimiser, schedule and bookkeeping of one training.

    Attributes:
        steps: number of steps of the optimiser.
        lr: peak learning rate of AdamW.
        schedule: learning rate schedule: constant after the warm-up, or a cosine down to 1 % of the
            peak.
        warmup: number of steps over which the rate rises linearly.
        betas, weight_decay: betas and weight decay of AdamW.
        ema_decay: decay of the moving average of the weights; None keeps none.
        clip: norm to which gradients are clipped; "adaptive" as the published trainer does.
        accumulate: number of batches a step.
        seed: seed of everything random.
        checkpoint_every: number of steps between checkpoints.
        log_every: number of steps between lines of the log.
    """

    steps: int = Field(ge=1)
    lr: FiniteFloat = Field(gt=0)
    schedule: Literal["constant", "cosine"] = "constant"
    warmup: int = Field(default=0, ge=0)
    betas: tuple[Share, Share] = (0.9, 0.999)
    weight_decay: FiniteFloat = Field(default=0.0, ge=0)
    ema_decay: Share | None = None
    clip: Annotated[FiniteFloat, Field(gt=0)] | Literal["adaptive"] = "adaptive"
    accumulate: int = Field(default=1, ge=1)
    seed: int = Field(default=0, ge=0)
    checkpoint_every: int = Field(default=500, ge=1)
    log_every: int = Field(default=50, ge=1)

    def same_course(self, other: TrainerSettings) -> bool:
        """Whether both take the same steps, as far as both go.

        How often is written does not matter, nor does where a constant schedule ends.
        """
        free = {"checkpoint_every", "log_every"}
        if self.schedule == "constant":
            free.add("steps")
        return self.model_dump(exclude=free) == other.model_dump(exclude=free)

    def rate(self, step: int) -> float:
        """Learning rate of step number `step`, from 0."""
        warm = min(1.0, (step + 1) / self.warmup) if self.warmup else 1.0
        if self.schedule == "constant":
            return self.lr * warm
        progress = min(1.0, step / self.steps)
        return self.lr * warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))


def overridden(start: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with members replaced; objects member by member."""
    merged = dict(start)
    for name, value in changes.items():
        old = merged.get(name)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[name] = overridden(old, value) if both else value  # type: ignore[arg-type]
    return merged


@dataclass
class Means:
    """Sums and counts by name of the values that were finite.

    A checkpoint keeps them, so that the lines of a resumed log are those of an uninterrupted one.
    """

    sums: dict[str, float] = field(default_factory=dict)
    counts: dict[str, float] = field(default_factory=dict)

    def add(self, values: Mapping[str, float]) -> None:
        """Count values in; one that is not finite only makes its name known."""
        for name, value in values.items():
            known = math.isfinite(value)
            self.sums[name] = self.sums.get(name, 0.0) + (value if known else 0.0)
            self.counts[name] = self.counts.get(name, 0.0) + known

    def means(self) -> dict[str, float]:
        """By name; NaN where nothing finite was seen."""
        return {
            name: total / self.counts[name] if self.counts[name] else math.nan
            for name, total in self.sums.items()
        }


class AdaptiveGradClipper:
    """Clip gradients to a percentile of the latest norms, and never above a largest norm.

    As the published TRELLIS trainer does: the norms stored are those before clipping; until
    `window` of them are there, the bound is `max_norm`. Norms that are not finite are not stored.

    Args:
        max_norm: largest bound.
        percentile: percentile of the stored norms, 0 to 100.
        window: number of latest norms that count.

    Attributes:
        bound: the norm to which the next gradients are clipped.

    Raises:
        ValueError: an argument out of its range.
    """

    def __init__(self, max_norm: float = 1.0, percentile: float = 95.0, window: int = 1000) -> None:
        if not max_norm > 0 or not 0 <= percentile <= 100 or window < 1:
            raise ValueError(
                f"gradient clipper: out of range: {max_norm=}, {percentile=}, {window=}"
            )
        self.max_norm = max_norm
        self.percentile = percentile
        self.window = window
        self.bound = max_norm
        self._norms: deque[float] = deque(maxlen=window)  # oldest first

    def clip(self, parameters: Iterable[Tensor]) -> float:
        """Scale the gradients, in place, to the bound at most, then move the bound.

        Returns:
            L2 norm of all gradients before. Where it is not finite the gradients are useless and
            the optimiser's step must be left out.
        """
        norm = float(torch.nn.utils.clip_grad_norm_(parameters, self.bound))
        if np.isfinite(norm):
            self._norms.append(norm)
            self._follow()
        return norm

    def _follow(self) -> None:
        if len(self._norms) == self.window:
            self.bound = min(self.max_norm, float(np.percentile(self._norms, self.percentile)))

    def state_dict(self) -> dict[str, Any]:
        """The stored norms, oldest first, for JSON."""
        return {"norms": list(self._norms)}

    def load_state_dict(self, state: dict[str, Sequence[float]]) -> None:
        """Continue with stored norms; of more than `window` the latest count."""
        self._norms = deque((float(norm) for norm in state["norms"]), maxlen=self.window)
        self.bound = self.max_norm
        self._follow()


class ExponentialMovingAverage:
    """Average of the weights over training steps, w <- decay w + (1 - decay) model.

    It starts from the weights that the model has now, so make it after they are loaded: an average
    begun at the random initialisation still holds 0.9999^10000 = 37 % of it after ten thousand
    steps, as in the published trainer's fine-tuning. Parameters are averaged in float32 or more,
    whatever their type in the model (torch's `AveragedModel` keeps their type). Buffers, such as
    stored position tables, are not averaged: they are the model's latest.

    Args:
        model: its state dictionary is the one followed.
        decay: weight of the past, per step.

    Raises:
        ValueError: no decay in [0, 1).
    """

    def __init__(self, model: nn.Module, decay: float = 0.9999) -> None:
        if not 0 <= decay < 1:
            raise ValueError(f"moving average: decay {decay}, expected at least 0 and below 1")
        self.decay = decay
        self._averaged = {name for name, _ in model.named_parameters(remove_duplicate=False)}
        self._state = {
            name: value.detach().to(self._dtype(name, value), copy=True)
            for name, value in model.state_dict().items()
        }

    def _dtype(self, name: str, value: Tensor) -> torch.dtype:
        if name not in self._averaged:
            return value.dtype
        return torch.promote_types(value.dtype, torch.float32)

    @torch.no_grad()
    def update(self, model: nn.Module) -> None:
        """Take one step towards the weights of the model.

        Raises:
            ValueError: names or shapes of the model differ from those at the start.
        """
        for name, average, value in self._pairs(model):
            if name in self._averaged:
                average.lerp_(value.to(average), 1 - self.decay)
            else:
                average.copy_(value)

    @torch.no_grad()
    def copy_to(self, model: nn.Module) -> None:
        """Overwrite the weights of the model, in its own types, with the averages.

        Raises:
            ValueError: as `update`.
        """
        for _, average, value in self._pairs(model):
            value.copy_(average)

    def _pairs(self, model: nn.Module) -> list[tuple[str, Tensor, Tensor]]:
        state = model.state_dict()
        if {n: v.shape for n, v in state.items()} != {n: v.shape for n, v in self._state.items()}:
            raise ValueError("moving average: names or shapes of the model have changed")
        return [(name, self._state[name], value) for name, value in state.items()]

    def state_dict(self) -> dict[str, Tensor]:
        """Averages and buffers by name, in the order of the model; the next update changes them."""
        return dict(self._state)

    @torch.no_grad()
    def load_state_dict(
        self, state: Mapping[str, Tensor], where: str | Path = "moving average"
    ) -> None:
        """Continue from saved averages.

        Raises:
            InputError: a tensor is missing, unknown or of another shape, see `require_state`;
                nothing is changed then.
        """
        require_state(where, state, self._state, "load the averages of the same model")
        for name, average in self._state.items():
            average.copy_(state[name])


class _Norms(Record):
    norms: tuple[FiniteFloat, ...]


class _Sums(Record):
    sums: dict[str, FiniteFloat] = Field(default_factory=dict)
    counts: dict[str, FiniteFloat] = Field(default_factory=dict)


class _Header(Record):
    """What a checkpoint says beside its tensors."""

    step: int = Field(ge=0)
    settings: TrainerSettings
    clipper: _Norms | None
    log: _Sums


@dataclass
class TrainingState:
    """Everything that a training changes.

    Attributes:
        modules: modules by name.
        optimiser: optimiser over all their trainable parameters.
        averages: moving average of each module, where asked for.
        clipper: gradient clipper, where the bound follows the norms.
        step: number of steps done.
        pending: means of the log since its last line.
    """

    modules: Mapping[str, nn.Module]
    optimiser: torch.optim.AdamW
    averages: dict[str, ExponentialMovingAverage]
    clipper: AdaptiveGradClipper | None
    step: int = 0
    pending: Means = field(default_factory=Means)

    @staticmethod
    def begin(modules: Mapping[str, nn.Module], settings: TrainerSettings) -> TrainingState:
        """The state before the first step."""
        parameters = [p for m in modules.values() for p in m.parameters() if p.requires_grad]
        averages = {
            name: ExponentialMovingAverage(module, settings.ema_decay)
            for name, module in modules.items()
            if settings.ema_decay is not None
        }
        return TrainingState(
            modules,
            torch.optim.AdamW(
                parameters,
                **settings.model_dump(include={"lr", "betas", "weight_decay"}),
            ),
            averages,
            AdaptiveGradClipper() if settings.clip == "adaptive" else None,
        )

    def parameters(self) -> list[Tensor]:
        """What the optimiser changes, in its order."""
        return [p for group in self.optimiser.param_groups for p in group["params"]]

    def write(self, folder: Path, settings: TrainerSettings) -> None:
        """Write the state, whole or not at all.

        Raises:
            InputError: the disk is full.
        """
        tensors: dict[str, Tensor] = {}
        for name, module in self.modules.items():
            tensors |= {f"model/{name}/{k}": v for k, v in module.state_dict().items()}
        for name, average in self.averages.items():
            tensors |= {f"average/{name}/{k}": v for k, v in average.state_dict().items()}
        for index, parameter in enumerate(self.parameters()):
            moments = self.optimiser.state.get(parameter, {})
            tensors |= {f"optimiser/{index}/{k}": v for k, v in moments.items()}
        header = {
            "step": self.step,
            "settings": settings.model_dump(mode="json"),
            "clipper": None if self.clipper is None else self.clipper.state_dict(),
            "log": asdict(self.pending),
        }
        plain = {k: v.detach().cpu().contiguous() for k, v in tensors.items()}
        with atomic_file(folder / STATE_FILE) as partial:
            try:
                save_file(plain, partial, metadata={_HEADER: json.dumps(header)})
            except SafetensorError as error:
                code = re.search(r"os error (\d+)", str(error))  # said in a way of its own
                if code is None:
                    raise
                raise OSError(int(code[1]), os.strerror(int(code[1]))) from error

    def read(self, folder: Path, settings: TrainerSettings) -> None:
        """Continue from what `write` wrote; nothing happens where there is none.

        Raises:
            InputError: the file is broken, or of other settings or networks.
        """
        path = folder / STATE_FILE
        if not path.exists():
            return
        tensors, texts = read_safetensors(path, "state", _MEND)
        header = _header(path, texts)
        _check_settings(path, header, settings)
        for name, value in tensors.items():
            if value.is_floating_point() and not bool(torch.isfinite(value).all()):
                raise InputError(path, name, "holds NaN or infinite values", _MEND)
        try:
            for name, module in self.modules.items():
                module.load_state_dict(below(tensors, f"model/{name}/"))
        except RuntimeError as error:
            reason = str(error).splitlines()[-1].strip()
            raise InputError(
                path, "weights", f"belong to another network ({reason})", _MEND
            ) from None
        for name, average in self.averages.items():
            average.load_state_dict(below(tensors, f"average/{name}/"), path)
        for index, parameter in enumerate(self.parameters()):
            moments = below(tensors, f"optimiser/{index}/")
            expected = {k: () if k == "step" else tuple(parameter.shape) for k in _MOMENTS}
            if moments and {k: tuple(v.shape) for k, v in moments.items()} != expected:
                raise InputError(path, f"optimiser/{index}", "belongs to another optimiser", _MEND)
            if moments:
                self.optimiser.state[parameter] = {
                    k: v if k == "step" else v.to(parameter.device) for k, v in moments.items()
                }
        if self.clipper is not None:
            if header.clipper is None:
                raise InputError(path, "clipper", "is missing", _MEND)
            self.clipper.load_state_dict({"norms": header.clipper.norms})
        self.step = header.step
        self.pending = Means(dict(header.log.sums), dict(header.log.counts))


def steps_done(folder: Path) -> int:
    """Steps of the checkpoint in a folder, 0 where there is none.

    Raises:
        InputError: the file is broken.
    """
    path = folder / STATE_FILE
    if not path.exists():
        return 0
    try:
        with opened_safetensors(path) as file:
            texts = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise InputError(path, "state", f"cannot be read ({error})", _MEND) from None
    return _header(path, texts).step


def _header(path: Path, texts: Mapping[str, str]) -> _Header:
    try:
        return _Header.model_validate(parse_json(path, texts.get(_HEADER, "null")))
    except ValidationError as error:
        raise validation_error(path, error, _MEND) from None


def _check_settings(path: Path, header: _Header, settings: TrainerSettings) -> None:
    found = header.settings
    if not found.same_course(settings):
        names = [n for n, v in found if v != getattr(settings, n)]
        raise InputError(
            path, "settings", f"differ from the requested ones ({', '.join(names)})", _MEND
        )
    if header.step > settings.steps:
        raise InputError(
            path, "steps", f"{header.step} are done, but {settings.steps} are requested", _MEND
        )


def below(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Those whose names begin with a prefix, without it."""
    return {
        name.removeprefix(prefix): value
        for name, value in tensors.items()
        if name.startswith(prefix)
    }
