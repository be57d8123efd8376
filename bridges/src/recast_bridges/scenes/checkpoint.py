"""Trained scenes of others: checked reading of checkpoint tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.torch_file import read_torch_file
from recast.splats import Gaussians
from recast_bridges.scenes.pickled import ARRAYS, PickledArray, PickledQuaternion

MEND = "give a checkpoint of the published layout; see docs/scenes.md#scenes-that-others-trained"
REST_COUNTS = (0, 3, 8, 15)
"""Harmonics above the constant one, by degree."""
RESAMPLED = "sky cubemap, resampled"
NO_SKY = "sky: the checkpoint has none; it is black"


class CheckpointTable:
    """One table of a checkpoint; errors name the file and the whole key, such as obj_003.xyz."""

    def __init__(self, path: Path, content: Mapping[str, Any], prefix: str = "") -> None:
        self.path = path
        self.prefix = prefix
        self._content = content

    def __contains__(self, name: str) -> bool:
        return name in self._content

    def __iter__(self) -> Iterator[str]:
        return iter(self._content)

    def key(self, name: str) -> str:
        """The whole key of a member, for messages."""
        return f"{self.prefix}.{name}" if self.prefix else name

    def fault(self, name: str, problem: str, mend: str = MEND) -> InputError:
        """The error for a member."""
        return InputError(self.path, self.key(name), problem, mend)

    def table(self, name: str) -> CheckpointTable:
        """The table under `name`.

        Raises:
            InputError: it is missing, no table, or has a name that is no text.
        """
        value = self._member(name)
        if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
            raise self.fault(name, f"is {type(value).__name__}, not a table of tensors")
        return CheckpointTable(self.path, value, self.key(name))

    def raw(self, name: str) -> Any:
        """A member as it is; None if it is missing."""
        return self._content.get(name)

    def below(self, prefix: str) -> CheckpointTable:
        """The members whose names begin with `prefix` and a dot, without these."""
        start = f"{prefix}."
        own = {k.removeprefix(start): v for k, v in self._content.items() if k.startswith(start)}
        return CheckpointTable(self.path, own, self.key(prefix))

    def changed(self, members: Mapping[str, Tensor]) -> CheckpointTable:
        """The table with other members in the place of some."""
        return CheckpointTable(self.path, {**self._content, **members}, self.prefix)

    def iteration(self, name: str) -> int | None:
        """A number of steps, from 0 to 2^53; None where there is none. Raises InputError: it is
        something else."""
        value = self._content.get(name, 0)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.fault(name, f"is {type(value).__name__}, not a whole number")
        if not 0 <= value <= 1 << 53:
            raise self.fault(name, "is not a number of steps")
        return value if name in self else None

    def tensor(self, name: str, *shape: int | None, dtype: torch.dtype = torch.float32) -> Tensor:
        """A tensor without gradient; None in `shape` stands for any size.

        Args:
            dtype: type of the numbers: float64 for places that are still to be moved.

        Raises:
            InputError: it is missing, no dense tensor, of another shape, or holds a value that is
                not finite in that type.
        """
        value = self._member(name)
        if (
            not isinstance(value, Tensor)
            or value.layout != torch.strided
            or value.device.type != "cpu"
            or value.is_quantized
            or value.is_complex()
        ):
            raise self.fault(name, f"is {type(value).__name__}, not a dense tensor of real numbers")
        found = tuple(value.shape)
        if len(found) != len(shape) or any(
            wanted not in (None, size) for size, wanted in zip(found, shape, strict=True)
        ):
            expected = ", ".join("any" if size is None else str(size) for size in shape)
            raise self.fault(name, f"has shape {list(found)}, expected [{expected}]")
        plain = value.detach().to(dtype).contiguous()
        bad = ~torch.isfinite(plain)
        if bool(bad.any()):
            index = bad.nonzero()[0].tolist()
            raise self.fault(name, f"is not finite at {index}", "take an earlier checkpoint")
        return plain

    def text(self, name: str) -> str:
        """A text. Raises InputError: it is missing, or something else."""
        value = self._member(name)
        if not isinstance(value, str):
            raise self.fault(name, f"is {type(value).__name__}, not a text")
        return value

    def number(self, name: str, default: float | None = None) -> float:
        """A finite number; `default` if it is missing or None, and if there is a default. Raises
        InputError: it is missing without a default, or something else."""
        if default is not None and self._content.get(name) is None:
            return default
        value = self._member(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fault(name, f"is {type(value).__name__}, not a number")
        if not abs(value) < 1e300:  # also NaN
            raise self.fault(name, "is not finite, or out of range")
        return float(value)

    def array(self, name: str) -> Array:
        """Numbers of any shape as float64: a tensor, a NumPy array or a list. They may be NaN.
        Raises InputError: it is missing, or something else."""
        value = self._member(name)
        if isinstance(value, Tensor) and value.layout == torch.strided and not value.is_complex():
            return value.detach().to("cpu", torch.float64).numpy()
        pickled = isinstance(value, PickledArray | PickledQuaternion)
        plain = value.value if pickled else value
        if isinstance(plain, np.ndarray | list | tuple):
            try:
                return np.array(plain, np.float64)
            except (TypeError, ValueError, OverflowError, RecursionError):
                pass
        raise self.fault(name, f"is {type(value).__name__}, not an array of numbers")

    def texts(self, name: str) -> list[str]:
        """The texts of a list or an array; none if it is missing or holds something else."""
        value = self._content.get(name)
        plain = value.value.tolist() if isinstance(value, PickledArray) else value
        return [one for one in plain if isinstance(one, str)] if isinstance(plain, list) else []

    def _member(self, name: str) -> Any:
        if name not in self._content:
            raise self.fault(name, "is missing")
        return self._content[name]


def read_checkpoint(path: str | Path, arrays: bool = False) -> CheckpointTable:
    """Read a checkpoint; nothing but tensors and plain values is unpickled.

    Args:
        arrays: whether the checkpoint may hold NumPy's numbers and arrays.

    Raises:
        InputError: see `recast.core.torch_file.read_torch_file`; or it holds no table.
    """
    path = Path(path)
    content = read_torch_file(path, "copy it again", safe=ARRAYS if arrays else ())
    if not isinstance(content, Mapping) or not all(isinstance(key, str) for key in content):
        raise InputError(path, "file", f"holds {type(content).__name__}, not a table", MEND)
    return CheckpointTable(path, content)


@dataclass(frozen=True)
class Names:
    """What a layout calls the fields of Gaussians but the constant harmonic."""

    means: str
    rest: str
    log_scales: str
    quats: str
    logit_opacities: str


def read_gaussians(table: CheckpointTable, names: Names, constant: Tensor) -> Gaussians:
    """The Gaussians of a table; their centres are float64, to be placed before they are rounded.

    Args:
        constant: (N, 3) constant harmonics, which layouts store in different ways.

    Raises:
        InputError: a field is missing, of another shape, not finite, or out of range
            (`Gaussians.fault`).
    """
    n = len(constant)
    rest = table.tensor(names.rest, n, None, 3)
    if rest.shape[1] not in REST_COUNTS:
        raise table.fault(
            names.rest, f"has {rest.shape[1]} harmonics, expected one of {list(REST_COUNTS)}"
        )
    found = Gaussians(
        means=table.tensor(names.means, n, 3, dtype=torch.float64),
        quats=table.tensor(names.quats, n, 4),
        log_scales=table.tensor(names.log_scales, n, 3),
        logit_opacities=table.tensor(names.logit_opacities, n, 1)[:, 0],
        sh=torch.cat([constant[:, None], rest], dim=1),
    )
    fault = found.fault()
    if fault is not None:
        field = names.rest if fault[0] == "sh" else getattr(names, fault[0])
        raise table.fault(field, fault[1])
    return found


def read_harmonics(table: CheckpointTable, name: str, count: int, degree: float) -> Tensor:
    """View-dependent harmonics (N, (degree + 1)^2 - 1, 3); those of higher degrees are cut off.
    Raises InputError: see `CheckpointTable.tensor`; or the table has fewer."""
    rest = table.tensor(name, count, None, 3)
    wanted = (int(degree) + 1) ** 2 - 1
    if rest.shape[1] < wanted:
        problem = f"has {rest.shape[1]} harmonics, degree {degree:g} needs {wanted}"
        raise table.fault(name, problem)
    return rest[:, :wanted]


def unused_members(
    tables: Iterable[CheckpointTable], names: Names, others: Sequence[str]
) -> list[str]:
    """A sentence on what the tables hold beside Gaussians and `others`; none where that is all."""
    known = {*astuple(names), *others}
    found = sorted({name for table in tables for name in table if name not in known})
    return [f"in the models: {', '.join(found)}"] if found else []


def read_faces(table: CheckpointTable, name: str) -> Tensor:
    """A checkpoint's cubemap (6, R, R, 3). Raises InputError: it is missing, of another shape, or
    not finite."""
    faces = table.tensor(name, 6, None, None, 3)
    if faces.shape[1] != faces.shape[2] or faces.shape[1] == 0:
        raise table.fault(name, f"has faces of {list(faces.shape[1:3])}, which are not squares")
    return faces
