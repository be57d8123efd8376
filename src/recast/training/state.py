"""Checkpoints of a training: weights, moments of the optimiser, moving average, clipper."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch
from pydantic import Field, FiniteFloat, ValidationError
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor, nn

from recast.core.errors import InputError
from recast.core.files import atomic_file, parse_json
from recast.core.records import Record, validation_error
from recast.core.torch_file import opened_safetensors, read_safetensors
from recast.training.averages import AdaptiveGradClipper, ExponentialMovingAverage
from recast.training.task import Means, TrainerSettings

STATE_FILE = "state.safetensors"
_HEADER = "recast-training"
_MEND = "remove the folder and train again"
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # of AdamW


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
                module.load_state_dict(_below(tensors, f"model/{name}/"))
        except RuntimeError as error:
            reason = str(error).splitlines()[-1].strip()
            raise InputError(
                path, "weights", f"belong to another network ({reason})", _MEND
            ) from None
        for name, average in self.averages.items():
            average.load_state_dict(_below(tensors, f"average/{name}/"), path)
        for index, parameter in enumerate(self.parameters()):
            moments = _below(tensors, f"optimiser/{index}/")
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


def _below(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {
        name.removeprefix(prefix): value
        for name, value in tensors.items()
        if name.startswith(prefix)
    }
