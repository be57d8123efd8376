"""Foreign pickles of plain values and NumPy arrays, of which nothing is ever run.

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
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.core.files import read_bytes

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
