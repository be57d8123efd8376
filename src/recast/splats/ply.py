"""Gaussians in the PLY layout of the original 3DGS release, which every viewer reads.

One element `vertex` with the float properties x y z, nx ny nz (zeros), f_dc_0..2, f_rest_* (one
channel after the other: index c (K - 1) + k - 1 for channel c and harmonic k), opacity (logit),
scale_0..2 (log), rot_0..3 (wxyz). A header line such as "comment low_pass 0.1 antialiased" may say
which filter they were made for.

Read as well: Mip-Splatting's `filter_3D`, the discs of 2DGS (no scale_2), and red green blue in the
place of f_dc.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.core.files import disk_errors, write_bytes
from recast.splats.gaussians import C0, Gaussians, from_linear, to_linear
from recast.splats.rasterization import MIP, LowPass, parse_low_pass

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
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)
_FILTER = "filter_3D"  # standard deviation in metres, of Mip-Splatting and what builds on it
_COLOURS = ("red", "green", "blue")
_COMPRESSED = "packed_position"
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

    A file with `filter_3D` was made for the filter of Mip-Splatting.

    Raises:
        InputError: the file is missing, or the declaration is not a PLY header.
    """
    with disk_errors(path), Path(path).open("rb") as file:
        data = file.read(_LONGEST_HEADER)
    end = _END.search(data)
    lines = [] if end is None else _lines(data[: end.start()])
    for line in lines:
        if line.startswith(_LOW_PASS):
            return parse_low_pass(path, line.removeprefix(_LOW_PASS))
    return MIP if any(line.split()[2:] == [_FILTER] for line in lines) else None


def read_ply(path: str | Path, double: bool = False) -> Gaussians:
    """Read Gaussians; properties may come in any order, and ones not known are ignored.

    An opacity of +inf is the largest below 1, Gaussians with an opacity of -inf are left out, and a
    scale of -inf is flat. `filter_3D` widens the Gaussians and lowers their opacities, as
    Mip-Splatting does before it draws them.

    Args:
        double: whether centres are float64, for coordinates far from the origin that are still to
            be moved; the rest is float32.

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
    painted = "f_dc_0" not in found and set(_COLOURS) <= set(found)
    sides = 2 if "scale_1" in found and "scale_2" not in found else 3
    absent = {"nx", "ny", "nz", *(f"scale_{i}" for i in range(sides, 3))}
    absent |= {f"f_dc_{i}" for i in range(3)} if painted else set()
    names = [name for name in _names(rest) if name not in absent]
    names += [*(_COLOURS if painted else ()), *([_FILTER] if _FILTER in found else [])]
    for name in names:
        if name not in found:
            raise InputError(path, f"property {name}", "is missing", _EXPORT_AGAIN)
    vertices = _read_vertices(path, data, header)
    kept = vertices["opacity"] != -np.inf
    vertices = vertices if kept.all() else vertices[kept]
    columns = {
        name: _column(path, vertices, name, "f8" if double and name in "xyz" else "f4")
        for name in names
    }
    columns |= {f"scale_{i}": np.full_like(columns["scale_0"], -np.inf) for i in range(sides, 3)}

    def stack(*names: str) -> torch.Tensor:
        return torch.from_numpy(np.stack([columns[name] for name in names], axis=-1))

    constant = stack(*(_COLOURS if painted else (f"f_dc_{i}" for i in range(3))))
    sh = [((constant - 0.5) / C0 if painted else constant)[:, None]]
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
    gaussians = _without_infinities(gaussians)
    if _FILTER in columns:
        gaussians = _filtered(gaussians, torch.from_numpy(columns[_FILTER]))
    fault = gaussians.fault()
    if fault is not None:
        raise InputError(path, f"property {_PROPERTIES[fault[0]]}", fault[1], _EXPORT_AGAIN)
    return gaussians


def _without_infinities(gaussians: Gaussians) -> Gaussians:
    """An opacity of 1 and deviations of 0 as the nearest numbers that have a logit or a log."""
    limits = from_linear(*(torch.tensor([[v]]) for v in (0.0, 1.0, 0.0, 1.0, 0.0)))
    return replace(
        gaussians,
        log_scales=torch.where(
            gaussians.log_scales == -torch.inf, limits.log_scales, gaussians.log_scales
        ),
        logit_opacities=torch.where(
            gaussians.logit_opacities == torch.inf,
            limits.logit_opacities[0],
            gaussians.logit_opacities,
        ),
    )


def _filtered(gaussians: Gaussians, deviation: torch.Tensor) -> Gaussians:
    """Gaussians as Mip-Splatting draws them (Yu et al. 2024, section 4.1).

    Each is convolved with an isotropic Gaussian, and its opacity is lowered by the root of the
    ratio of the covariances' determinants, so that it keeps its integral.

    Args:
        deviation: (N,) standard deviation of the filter in metres.
    """
    double = replace(
        gaussians,
        log_scales=gaussians.log_scales.double(),
        logit_opacities=gaussians.logit_opacities.double(),
    )
    _, sizes, opacities = to_linear(double)
    wide = torch.hypot(sizes, deviation.double()[:, None])
    share = torch.where(wide > 0, sizes / wide, 1.0).prod(dim=1)
    smoothed = from_linear(double.means, double.quats, wide, opacities * share, double.sh)
    return replace(
        gaussians,
        log_scales=smoothed.log_scales.float(),
        logit_opacities=smoothed.logit_opacities.float(),
    )


@dataclass(frozen=True)
class _Header:
    """Where the vertices are, and of what."""

    start: int  # first byte of the elements' data
    # fields of the elements before the vertices, with the count of each.
    before: tuple[tuple[int, np.dtype], ...]
    count: int  # number of vertices
    dtype: np.dtype  # fields of one vertex
    ascii: bool  # whether numbers are text


def _parse_header(path: Path, data: bytes) -> _Header:
    if not data.startswith((b"ply\n", b"ply\r\n")):
        raise InputError(path, "header", "does not begin with 'ply'", "give a PLY file")
    end = _END.search(data)
    if end is None:
        raise InputError(
            path, "header", "has no end_header", "the file is truncated: copy it again"
        )
    order = ""
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    try:
        for line in _lines(data[: end.start()])[1:]:
            match line.split():
                case ["format", name, _]:
                    order = _ORDERS[name]
                case ["element", name, size]:
                    elements.append((name, int(size), []))
                case ["property", "list", *_] if not _after_vertex(elements):
                    problem = "is a list" if elements[-1][0] == "vertex" else "comes before vertex"
                    raise InputError(path, line.strip(), problem, _EXPORT_AGAIN)
                case ["property", kind, name] if not _after_vertex(elements):
                    elements[-1][2].append((name, order + _TYPES[kind]))
                case [] | ["comment" | "obj_info", *_] | ["property", *_]:
                    pass
                case _:
                    raise KeyError(line)
        sizes = [(name, size, np.dtype(fields)) for name, size, fields in elements]
    except (KeyError, ValueError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, "header", f"is not a PLY header ({error})", _EXPORT_AGAIN) from None
    names = [name for name, _, _ in sizes]
    if "vertex" not in names or not order or min(size for _, size, _ in sizes) < 0:
        raise InputError(path, "header", "has no format or no element vertex", _EXPORT_AGAIN)
    at = names.index("vertex")
    _, count, dtype = sizes[at]
    if _COMPRESSED in (dtype.names or ()):
        problem = f"is a compressed PLY of SuperSplat ({_COMPRESSED}), which is not supported"
        raise InputError(path, "format", problem, "export it as an uncompressed PLY")
    before = tuple((size, dtype) for _, size, dtype in sizes[:at])
    return _Header(end.end(), before, count, dtype, order == _ORDERS["ascii"])


def _lines(header: bytes) -> list[str]:
    """Lines of a header; comments may be in any encoding."""
    return [line.decode("ascii", "replace").strip() for line in header.split(b"\n")]


def _after_vertex(elements: list[tuple[str, int, list[tuple[str, str]]]]) -> bool:
    """Whether the element that a property belongs to comes after the vertices: not read. Raises
    IndexError: there is no element."""
    return elements[-1][0] != "vertex" and any(name == "vertex" for name, _, _ in elements)


def _read_vertices(path: Path, data: bytes, header: _Header) -> NDArray[np.void]:
    names = header.dtype.names or ()

    def length(count: int, dtype: np.dtype) -> int:
        # A number takes at least two bytes as text, a digit and a separator.
        fields = dtype.names or ()
        return count * (max(2 * len(fields) - 1, 0) if header.ascii else dtype.itemsize)

    skipped = sum(length(count, dtype) for count, dtype in header.before)
    size = skipped + length(header.count, header.dtype)
    if len(data) - header.start < size:
        raise InputError(
            path,
            "vertex data",
            f"{len(data) - header.start} bytes, expected {size} or more",
            "the file is truncated: copy it again",
        )
    if not header.ascii:
        return np.frombuffer(data, header.dtype, header.count, header.start + skipped)
    first = sum(count * len(dtype.names or ()) for count, dtype in header.before)
    last = first + header.count * len(names)
    try:
        words = data[header.start :].split(maxsplit=last)[first:last]
        table = np.array(words, np.float64).reshape(header.count, len(names))
    except ValueError as error:
        raise InputError(path, "vertex data", f"cannot be read ({error})", _EXPORT_AGAIN) from None
    # As the header has them: its whole numbers stand for shares of their type's largest.
    vertices = np.empty(header.count, [(name, np.float64) for name in names])
    for i, name in enumerate(names):
        kind = header.dtype[name]
        scale = np.iinfo(kind).max if name in _COLOURS and kind.kind == "u" else 1
        vertices[name] = table[:, i] / scale
    return vertices


def _column(path: Path, vertices: NDArray[np.void], name: str, kind: str) -> NDArray[Any]:
    values = vertices[name]
    if name in _COLOURS and values.dtype.kind == "u":
        values = values / np.iinfo(values.dtype).max
    with np.errstate(over="ignore"):  # becomes infinite, which is refused
        column = values.astype(kind)
    allowed = {"opacity": np.inf, "scale": -np.inf}.get(name.partition("_")[0], 0.0)
    bad = np.flatnonzero(~np.isfinite(column) & (values != allowed))
    if len(bad):
        raise InputError(
            path,
            f"property {name}",
            f"row {bad[0]} is not finite ({column[bad[0]]})",
            _EXPORT_AGAIN,
        )
    return column
