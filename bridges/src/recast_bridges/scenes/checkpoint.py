"""Trained scenes of others: checked reading of checkpoint tables, and of pickles, never run.

A pickle is a program: it may call whatever it names. Here each name that it may use stands for
something of this module, which keeps the bytes of an array and calls nothing; any other name is
refused. The interpreter is Python's own, written in Python: unlike the one in C it takes no memory
for sizes that the file only claims.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import read_bytes
from recast.core.torch_file import read_torch_file
from recast.splats import Gaussians

LARGEST = 1 << 27
"""Bytes of a pickle, at most: a byte can stand for a value, which takes some 64."""
_NUMBER = re.compile(r"[biuf][1248]|b1")
_TEXT = re.compile(r"[SU][0-9]{1,6}")


class PickledType:
    """A pickled `numpy.dtype` of numbers, texts or objects."""

    def __init__(self, code: object, align: object = False, copy: object = False) -> None:
        if not isinstance(code, str) or not (
            _NUMBER.fullmatch(code) or _TEXT.fullmatch(code) or code in ("O8", "O4")
        ):
            raise pickle.UnpicklingError(f"an array of type {str(code)[:20]!r}")
        self.code, self.order = code, "="

    def __setstate__(self, state: object) -> None:
        order = state[1] if isinstance(state, tuple) and len(state) > 1 else None
        if order not in ("<", ">", "=", "|"):
            raise pickle.UnpicklingError("an array type of an unknown byte order")
        self.order = order

    def read(self, data: object, shape: object, fortran: object) -> NDArray[Any]:
        """An array of the bytes (of the list, for objects); nothing larger than them is made."""
        sides = shape if isinstance(shape, tuple) else (shape,)
        if len(sides) > 32 or not all(isinstance(n, int) and n >= 0 for n in sides):
            raise pickle.UnpicklingError("an array without a shape")
        count = math.prod(sides)
        if self.code.startswith("O"):
            if not isinstance(data, list) or len(data) != count:
                raise pickle.UnpicklingError(f"an array of {count} objects that it lacks")
            flat = np.empty(len(data), object)
            for index, one in enumerate(data):
                flat[index] = one
        else:
            kind = np.dtype(self.order + self.code)
            if not isinstance(data, bytes | bytearray) or count * kind.itemsize != len(data):
                raise pickle.UnpicklingError(f"an array of {count} values that it lacks")
            flat = np.frombuffer(bytes(data), kind) if len(data) else np.empty(0, kind)
        return flat.reshape(sides, order="F" if fortran else "C")


class PickledArray:
    """A pickled `numpy.ndarray`; `value` is the array."""

    value: NDArray[Any]

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, tuple) or len(state) != 5 or not isinstance(state[2], PickledType):
            raise pickle.UnpicklingError("an array that is not NumPy's")
        _, shape, kind, fortran, data = state
        self.value = kind.read(data, shape, fortran)


class PickledQuaternion:
    """A pickled `pyquaternion.Quaternion`; `value` are its numbers (4,) wxyz."""

    value: NDArray[Any]

    def __setstate__(self, state: object) -> None:
        own = state.get("q") if isinstance(state, dict) else None
        if not isinstance(own, PickledArray) or own.value.shape != (4,):
            raise pickle.UnpicklingError("a quaternion without four numbers")
        self.value = own.value


def _reconstruct(*_: object) -> PickledArray:
    """NumPy's function that makes an array to be filled."""
    return PickledArray()


def _scalar(kind: object, data: object) -> Any:
    """NumPy's function that makes a single number."""
    if not isinstance(kind, PickledType):
        raise pickle.UnpicklingError("a number that is not NumPy's")
    return kind.read(data, (), False).item()


def _from_buffer(data: object, kind: object, shape: object, order: object) -> PickledArray:
    """NumPy's function that makes an array of bytes, since protocol 5."""
    if not isinstance(kind, PickledType):
        raise pickle.UnpicklingError("an array that is not NumPy's")
    made = PickledArray()
    made.value = kind.read(data, shape, order == "F")
    return made


def _encode(text: object, encoding: object = "latin1") -> bytes:
    """How bytes are written before protocol 3: as text of as many characters."""
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError("bytes in an unknown encoding")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    """`bytes`, which protocols before the third call to write none."""
    return b""


def _table() -> dict[Any, Any]:
    """`OrderedDict`; an ordinary one keeps the order too."""
    return {}


_NUMPY: dict[str, Callable[..., Any]] = {
    "numpy.dtype": PickledType,
    "numpy.ndarray": PickledArray,
}
for _core in ("numpy.core", "numpy._core"):  # before and since NumPy 2
    _NUMPY[f"{_core}.multiarray._reconstruct"] = _reconstruct
    _NUMPY[f"{_core}.multiarray.scalar"] = _scalar
    _NUMPY[f"{_core}.numeric._frombuffer"] = _from_buffer
ARRAYS = tuple((own, name) for name, own in _NUMPY.items())
"""What `read_torch_file` may call to read NumPy's numbers, and arrays as `PickledArray`."""
_ALLOWED: dict[str, Callable[..., Any]] = {
    **_NUMPY,
    "_codecs.encode": _encode,
    "__builtin__.bytes": _no_bytes,
    "pyquaternion.quaternion.Quaternion": PickledQuaternion,
    "collections.OrderedDict": _table,
}
"""All that a pickle may name."""
_FILLED = (PickledType, PickledArray, PickledQuaternion)


class _Reader(pickle._Unpickler):
    """Python's interpreter of pickles without the instructions that plain values do not need."""

    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = dict(pickle._Unpickler.dispatch)

    def find_class(self, module: str, name: str) -> Any:
        full = f"{module}.{name}"
        if full not in _ALLOWED:
            raise pickle.UnpicklingError(f"{full[:80]}, which is never unpickled")
        return _ALLOWED[full]

    def _build(self) -> None:
        state = self.stack.pop()  # type: ignore[attr-defined]
        filled = self.stack[-1]  # type: ignore[attr-defined]
        if type(filled) not in _FILLED:
            raise pickle.UnpicklingError("a state of an object that is not an array")
        filled.__setstate__(state)

    def _named(self, items: list[Any]) -> None:
        # Keys are hashed: tuples within tuples without end would overrun the stack.
        if not all(isinstance(key, str | int | bytes) for key in items[::2]):
            raise pickle.UnpicklingError("a table with keys that are neither texts nor numbers")
        table = self.stack[-1]  # type: ignore[attr-defined]
        if not isinstance(table, dict) or len(items) % 2:
            raise pickle.UnpicklingError("members of an object that is not a table")
        table.update(zip(items[::2], items[1::2], strict=True))

    def _set_item(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()  # type: ignore[attr-defined]
        self._named([key, value])

    def _set_items(self) -> None:
        self._named(self.pop_mark())  # type: ignore[attr-defined]

    def _dict(self) -> None:
        items = self.pop_mark()  # type: ignore[attr-defined]
        self.append({})  # type: ignore[attr-defined]
        self._named(items)

    for _code in (
        *(pickle.PERSID, pickle.BINPERSID, pickle.INST, pickle.OBJ, pickle.NEWOBJ_EX),
        *(pickle.EXT1, pickle.EXT2, pickle.EXT4, pickle.NEXT_BUFFER, pickle.READONLY_BUFFER),
        *(pickle.EMPTY_SET, pickle.ADDITEMS, pickle.FROZENSET),
    ):
        del dispatch[_code[0]]
    dispatch[pickle.BUILD[0]] = _build
    dispatch[pickle.SETITEM[0]] = _set_item
    dispatch[pickle.SETITEMS[0]] = _set_items
    dispatch[pickle.DICT[0]] = _dict


def read_pickle(path: Path, mend: str) -> Any:
    """Plain values, lists, tables with names, `PickledArray` and `PickledQuaternion` of a pickle.

    Args:
        mend: what the user can do about a file that is damaged or refused.

    Raises:
        InputError: the file is missing, larger than `LARGEST`, damaged, or names anything else.
    """
    data = read_bytes(path, LARGEST)
    try:
        return _Reader(io.BytesIO(data)).load()
    except pickle.UnpicklingError as error:
        raise InputError(path, "pickle", f"holds {error}", mend) from None
    except Exception as error:  # the interpreter lets through whatever broken bytes lead to
        reason = type(error).__name__
        raise InputError(path, "pickle", f"is damaged ({reason})", mend) from None


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
