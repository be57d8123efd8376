"""Gaussians in the PLY layout of the original 3DGS release, which every viewer reads.

One element `vertex` with the float properties x y z, nx ny nz (zeros), f_dc_0..2, f_rest_* (one
channel after the other: index c (K - 1) + k - 1 for channel c and harmonic k), opacity (logit),
scale_0..2 (log), rot_0..3 (wxyz). A header line such as "comment low_pass 0.1 antialiased" may say
which filter they were made for.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.core.files import disk_errors, write_bytes
from recast.splats.gaussians import Gaussians
from recast.splats.low_pass import LowPass, parse_low_pass

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_REST_COUNTS = (0, 9, 24, 45)
_PROPERTIES = {
    "means": "x y z",
    "quats": "rot_0..3",
    "log_scales": "scale_0..2",
    "logit_opacities": "opacity",
    "sh": "f_dc_* f_rest_*",
}
_LOW_PASS = "comment low_pass"
_LONGEST_HEADER = 1 << 16  # bytes that are searched for the declaration
_EXPORT_AGAIN = "export it again as a 3D Gaussian splatting PLY"


def _names(rest: int) -> list[str]:
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(rest)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def write_ply(path: str | Path, gaussians: Gaussians, low_pass: LowPass | None = None) -> None:
    """Write `gaussians` as binary little-endian PLY, whole or not at all.

    Args:
        low_pass: the filter that they were made for, to be declared in the header.

    Raises:
        ValueError: a field is not finite, out of range or of the wrong shape.
        InputError: the disk refuses.
    """
    gaussians = gaussians.detach()
    gaussians.validate()
    n = len(gaussians)
    rest = gaussians.sh[:, 1:].transpose(1, 2).flatten(1)
    columns = [
        gaussians.means,
        torch.zeros_like(gaussians.means),
        gaussians.sh[:, 0],
        rest,
        gaussians.logit_opacities[:, None],
        gaussians.log_scales,
        gaussians.quats,
    ]
    table = torch.cat([column.float().cpu() for column in columns], dim=1)
    properties = "".join(f"property float {name}\n" for name in _names(rest.shape[1]))
    filter_line = "" if low_pass is None else f"{_LOW_PASS} {low_pass.text()}\n"
    header = (
        f"ply\nformat binary_little_endian 1.0\n{filter_line}"
        f"element vertex {n}\n{properties}end_header\n"
    )
    write_bytes(path, header.encode() + table.numpy().astype("<f4").tobytes())


def read_low_pass(path: str | Path) -> LowPass | None:
    """The filter that a file's header declares, as `write_ply` does; None if it declares none.

    Raises:
        InputError: the file is missing, or the declaration cannot be understood.
    """
    with disk_errors(path), Path(path).open("rb") as file:
        head, end, _ = file.read(_LONGEST_HEADER).partition(b"end_header")
    for line in head.decode("ascii", "replace").splitlines() if end else []:
        if line.startswith(_LOW_PASS):
            return parse_low_pass(path, line.removeprefix(_LOW_PASS))
    return None


def read_ply(path: str | Path) -> Gaussians:
    """Read Gaussians; properties may come in any order, and ones not known are ignored.

    Raises:
        InputError: the file is missing, no PLY, truncated, lacks a property, or holds a value that
            is not finite or out of range (`Gaussians.fault`).
    """
    path = Path(path)
    with disk_errors(path):
        data = path.read_bytes()
    header = _parse_header(path, data)
    found = header.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in found)
    if rest not in _REST_COUNTS:
        raise InputError(
            path, "f_rest_*", f"{rest} properties, expected 0, 9, 24 or 45", _EXPORT_AGAIN
        )
    names = [name for name in _names(rest) if name[0] != "n"]
    for name in names:
        if name not in found:
            raise InputError(path, f"property {name}", "is missing", _EXPORT_AGAIN)
    vertices = _read_vertices(path, data, header)
    columns = {name: _column(path, vertices, name) for name in names}

    def stack(*names: str) -> torch.Tensor:
        return torch.from_numpy(np.stack([columns[name] for name in names], axis=-1))

    sh = [stack(*(f"f_dc_{i}" for i in range(3)))[:, None]]
    if rest:
        flat = stack(*(f"f_rest_{i}" for i in range(rest)))
        sh.append(flat.reshape(len(flat), 3, rest // 3).transpose(1, 2))
    gaussians = Gaussians(
        means=stack("x", "y", "z"),
        quats=stack(*(f"rot_{i}" for i in range(4))),
        log_scales=stack(*(f"scale_{i}" for i in range(3))),
        logit_opacities=torch.from_numpy(columns["opacity"]),
        sh=torch.cat(sh, dim=1).contiguous(),
    )
    fault = gaussians.fault()
    if fault is not None:
        raise InputError(path, f"property {_PROPERTIES[fault[0]]}", fault[1], _EXPORT_AGAIN)
    return gaussians


@dataclass(frozen=True)
class _Header:
    """`start`: first byte of the vertices; `dtype`: of one vertex; `ascii`: numbers as text."""

    start: int
    count: int
    dtype: np.dtype
    ascii: bool


def _parse_header(path: Path, data: bytes) -> _Header:
    if not data.startswith((b"ply\n", b"ply\r\n")):
        raise InputError(path, "header", "does not begin with 'ply'", "give a PLY file")
    end = data.find(b"end_header")
    start = data.find(b"\n", end) + 1
    if end < 0 or start == 0:
        raise InputError(
            path, "header", "has no end_header", "the file is truncated: copy it again"
        )
    order, fields, count, elements = "", [], -1, []
    try:
        for line in data[:end].decode("ascii").splitlines()[1:]:
            match line.split():
                case ["format", name, _]:
                    order = _ORDERS[name]
                case ["element", name, size]:
                    elements.append(name)
                    if name == "vertex":
                        count = int(size)
                case ["property", kind, name] if elements[-1] == "vertex":
                    fields.append((name, order + _TYPES[kind]))
                case ["property", "list", *_] if elements[-1] == "vertex":
                    raise InputError(path, line.strip(), "is a list", _EXPORT_AGAIN)
                case [] | ["comment" | "obj_info", *_] | ["property", *_]:
                    pass
                case _:
                    raise KeyError(line)
        dtype = np.dtype(fields)
    except (KeyError, ValueError, IndexError, UnicodeDecodeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, "header", f"cannot be understood ({error})", _EXPORT_AGAIN) from None
    if count < 0 or not order:
        raise InputError(path, "header", "has no format or no element vertex", _EXPORT_AGAIN)
    if elements[0] != "vertex":
        raise InputError(path, f"element {elements[0]}", "comes before vertex", _EXPORT_AGAIN)
    return _Header(start, count, dtype, order == _ORDERS["ascii"])


def _read_vertices(path: Path, data: bytes, header: _Header) -> NDArray[np.void]:
    names = header.dtype.names or ()
    # A number takes at least two bytes as text, a digit and a separator.
    size = header.count * (2 * len(names) - 1 if header.ascii else header.dtype.itemsize)
    if len(data) - header.start < size:
        raise InputError(
            path,
            "vertex data",
            f"{len(data) - header.start} bytes, expected {size} or more",
            "the file is truncated: copy it again",
        )
    if not header.ascii:
        return np.frombuffer(data, header.dtype, header.count, header.start)
    wanted = header.count * len(names)
    try:
        numbers = np.array(data[header.start :].split(maxsplit=wanted)[:wanted], np.float64)
        table = numbers.reshape(header.count, len(names))
    except ValueError as error:
        raise InputError(path, "vertex data", f"cannot be read ({error})", _EXPORT_AGAIN) from None
    vertices = np.empty(header.count, [(name, np.float64) for name in names])
    for i, name in enumerate(names):
        vertices[name] = table[:, i]
    return vertices


def _column(path: Path, vertices: NDArray[np.void], name: str) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):  # becomes infinite, which is refused
        column = vertices[name].astype(np.float32)
    bad = np.flatnonzero(~np.isfinite(column))
    if len(bad):
        raise InputError(
            path,
            f"property {name}",
            f"row {bad[0]} is not finite ({column[bad[0]]})",
            _EXPORT_AGAIN,
        )
    return column
