"""The numbers of SPZ files: 24 bits for a coordinate, 8 for all else, 32 for a rotation.

With b fractional bits, a position is at most 2^-(b + 1) metres off (0.12 mm at the usual 12 bits),
an opacity 1/510, f_dc 1/76.5, a log scale 1/32; harmonics 4.5/128 (degree 1) and 8.5/128 (above).
The three smallest components of a quaternion are at most 1/1445 off. Numbers beyond a field's range
are clipped, as the format's own library does: f_dc beyond +-3.33, log scales beyond -10 and 5.94,
harmonics beyond -1 and 127/128.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.core.errors import InputError
from recast.core.files import read_bytes, write_bytes
from recast.splats.formats import SplatFormat
from recast.splats.gaussians import MAX_DEGREE, Gaussians
from recast.splats.rasterization import MIP, LowPass

Bytes = NDArray[np.uint8]

COLOUR_SCALE, SCALE_OFFSET, SCALE_STEPS, SH_STEPS = 0.15, 10.0, 16.0, 128.0
SH_BUCKETS = (8, 16)
"""Steps of 1/128 that one stored value stands for: degree 1, and above."""
MOST_COMPONENT, COMPONENT_STEPS = 0.5**0.5, 511
"""Range of a quaternion's three smallest components, and the steps up to it."""


def packed(gaussians: Gaussians, bits: int) -> list[bytes]:
    """Positions, opacities, colours, scales, rotations and harmonics of N Gaussians on the CPU.

    Args:
        bits: fractional bits of positions, which must fit.
    """
    fixed = (gaussians.means.double() * 2**bits).round().to(torch.int32).numpy()
    positions = fixed.astype("<i4")[..., None].view(np.uint8)[..., :3]
    sh = gaussians.sh.double()
    parts = [
        torch.from_numpy(positions.copy()),
        _byte(gaussians.logit_opacities.double().sigmoid() * 255),
        _byte(sh[:, 0] * (COLOUR_SCALE * 255) + 127.5),
        _byte((gaussians.log_scales.double() + SCALE_OFFSET) * SCALE_STEPS),
        torch.from_numpy(_smallest_three(gaussians.quats.double())),
        torch.cat([_bucketed(sh[:, 1:4], SH_BUCKETS[0]), _bucketed(sh[:, 4:], SH_BUCKETS[1])], 1),
    ]
    return [part.numpy().tobytes() for part in parts]


def _byte(values: Tensor) -> Tensor:
    return values.round().clamp(0, 255).to(torch.uint8)


def _bucketed(sh: Tensor, bucket: int) -> Tensor:
    steps = (sh * SH_STEPS).round() + SH_STEPS
    return _byte(((steps + bucket // 2) / bucket).floor() * bucket)


def _smallest_three(quats: Tensor) -> Bytes:
    """(N, 4) bytes of quaternions (N, 4) wxyz: index of the largest, sign and size of the rest."""
    xyzw = (quats / quats.norm(dim=1, keepdim=True)).roll(-1, 1).numpy()
    largest = np.abs(xyzw).argmax(axis=1)
    flip = np.take_along_axis(xyzw, largest[:, None], 1)[:, 0] < 0
    code = largest.astype(np.uint32)
    for i in range(4):
        size = np.abs(xyzw[:, i]) / MOST_COMPONENT * COMPONENT_STEPS + 0.5
        own = ((xyzw[:, i] < 0) ^ flip).astype(np.uint32) << 9 | size.astype(np.uint32)
        code = np.where(largest == i, code, code << np.uint32(10) | own)
    return code.astype("<u4")[:, None].view(np.uint8)


def unpacked(rows: Sequence[Bytes], bits: int) -> Gaussians:
    """Gaussians of the fields of `packed`, (N, bytes) each; in version 2, rotations have 3."""
    position, opacity, colour, scale, rotation, sh = rows
    n = len(position)
    fixed = np.zeros((n, 3, 4), np.uint8)
    fixed[..., 1:] = position.reshape(n, 3, 3)
    # Half of a step from the ends keeps logits finite.
    shares = np.clip(opacity[:, 0] / 255, 0.25 / 255, 1 - 0.25 / 255)
    constant = (colour / 255 - 0.5) / COLOUR_SCALE
    rest = (sh.reshape(n, sh.shape[1] // 3, 3) - SH_STEPS) / SH_STEPS
    arrays = (
        (fixed.view("<i4")[..., 0] >> 8) * 0.5**bits,
        _of_code(rotation) if rotation.shape[1] == 4 else _first_three(rotation),
        scale / SCALE_STEPS - SCALE_OFFSET,
        np.log(shares / (1 - shares)),
        np.concatenate([constant[:, None], rest], axis=1),
    )
    return Gaussians(*(torch.from_numpy(array).float() for array in arrays))


def _first_three(code: Bytes) -> NDArray[np.float64]:
    """Quaternions wxyz of version 2: x, y, z in a byte each, w not negative."""
    xyz = code / 127.5 - 1
    w = np.sqrt(np.clip(1 - (xyz**2).sum(axis=1, keepdims=True), 0, None))
    return np.concatenate([w, xyz], axis=1)


def _of_code(code: Bytes) -> NDArray[np.float64]:
    """Quaternions wxyz of `_smallest_three`."""
    rest = np.ascontiguousarray(code).view("<u4").reshape(len(code)).copy()
    largest = rest >> 30
    xyzw = np.zeros((len(code), 4))
    for i in (3, 2, 1, 0):
        here = largest != i
        size = (rest & COMPONENT_STEPS) / COMPONENT_STEPS * MOST_COMPONENT
        xyzw[:, i] = np.where(here, np.where(rest >> 9 & 1, -size, size), 0)
        rest = np.where(here, rest >> 10, rest)
    missing = np.sqrt(np.clip(1 - (xyzw**2).sum(axis=1), 0, None))
    np.put_along_axis(xyzw, largest[:, None].astype(np.int64), missing[:, None], 1)
    return np.roll(xyzw, 1, axis=1)


# Gaussians in SPZ (Niantic), about a tenth of the size of a PLY file, at a bounded loss.
#
# https://github.com/nianticlabs/spz, versions 2 to 4. Positions are 24-bit fixed-point numbers, the
# rest has 8 bits a number, see `spz_fields`. The axes are x right, y up and z back.

LONGEST_SPZ = 1 << 32
"""Bytes of a file, at most."""
MOST_POINTS = 10_000_000
"""Gaussians of a file, at most: what the format's own library reads."""
POSITION_BITS = 12
"""Fractional bits of positions, fewer if a scene reaches beyond 2 km."""
_MAGIC, _ANTIALIASED, _EXTENSIONS = 0x5053474E, 1, 2
_HEADER, _CONTAINER, _ENTRY = struct.Struct("<3I4B"), struct.Struct("<I12x"), struct.Struct("<2Q")
_FIXED_MOST = (1 << 23) - 1
_MEND = "export it again as SPZ of version 2, 3 or 4, without extensions"


def write_spz(
    path: str | Path,
    gaussians: Gaussians,
    low_pass: LowPass | None = None,
    version: Literal[3, 4] = 4,
) -> None:
    """Write Gaussians, whole or not at all.

    Args:
        gaussians: N, in the axes of the format.
        low_pass: filter that they were made for; the file tells only whether it is antialiased.
        version: 4 (one zstd stream a field), or 3 (gzip), which older programs read.

    Raises:
        ValueError: a field is not valid.
        InputError: there are too many, they lie too far out, or the disk refuses.
    """
    gaussians = gaussians.detach().to("cpu")
    gaussians.validate()
    n, degree = len(gaussians), gaussians.sh_degree
    if n > MOST_POINTS:
        mend = "write its parts, or another format"
        raise InputError(path, "size", f"{n} Gaussians, SPZ has {MOST_POINTS} at most", mend)
    reach = float(gaussians.means.abs().max()) if n else 0.0
    bits = next((b for b in range(POSITION_BITS, -1, -1) if reach * 2**b <= _FIXED_MOST), None)
    if bits is None:
        problem = f"{reach:g} m from the origin, SPZ reaches {_FIXED_MOST}"
        raise InputError(path, "position", problem, "leave out Gaussians that far away")
    antialiased = _ANTIALIASED if low_pass is not None and low_pass.antialiased else 0
    streams = [stream for stream in packed(gaussians, bits) if stream]
    count = len(streams) if version == 4 else 0
    header = _HEADER.pack(_MAGIC, version, n, degree, bits, antialiased, count)
    if version == 3:
        packer = zlib.compressobj(wbits=16 + zlib.MAX_WBITS)
        write_bytes(path, packer.compress(header + b"".join(streams)) + packer.flush())
        return
    squeezed = [pa.compress(stream, "zstd", asbytes=True) for stream in streams]
    table = [_ENTRY.pack(len(b), len(a)) for a, b in zip(streams, squeezed, strict=True)]
    start = _HEADER.size + _CONTAINER.size
    write_bytes(path, b"".join([header, _CONTAINER.pack(start), *table, *squeezed]))


def read_spz(path: str | Path, double: bool = False) -> Gaussians:
    """Read Gaussians, in the axes of the format.

    Args:
        double: whether centres are float64.

    Raises:
        InputError: the file is missing, no SPZ, truncated, too large, of another version or degree,
            has extensions (which may change what its numbers mean), or holds a value out of range.
    """
    path = Path(path)
    header, streams = _opened(path)
    rows = [s.reshape(header.count, w) for s, w in zip(streams, header.widths, strict=True)]
    gaussians = unpacked(rows, header.bits).with_centres(double)
    fault = gaussians.fault()
    if fault is not None:
        raise InputError(path, fault[0], fault[1], _MEND)
    return gaussians


def read_low_pass(path: str | Path) -> LowPass | None:
    """Mip-Splatting's filter if the file says antialiased, whose variance it cannot tell; or None.
    Raises InputError: see `read_spz`."""
    return MIP if _opened(Path(path))[0].flags & _ANTIALIASED else None


@dataclass(frozen=True)
class _Header:
    version: int
    count: int
    degree: int
    bits: int
    flags: int

    @property
    def widths(self) -> tuple[int, ...]:
        """Bytes of a Gaussian: position, opacity, colour, scale, rotation and harmonics."""
        return 9, 1, 3, 3, 3 if self.version == 2 else 4, 3 * ((self.degree + 1) ** 2 - 1)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes of all of them."""
        return tuple(self.count * width for width in self.widths)


def _opened(path: Path) -> tuple[_Header, list[Bytes]]:
    """Header and streams of the sizes that it says, of which no more is ever unpacked."""
    data = read_bytes(path, LONGEST_SPZ)
    if data[:2] == b"\x1f\x8b":
        unpacker = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
        try:
            header = _header(path, unpacker.decompress(data, _HEADER.size))
            wanted = sum(header.sizes)
            body = unpacker.decompress(unpacker.unconsumed_tail, wanted) if wanted else b""
        except zlib.error as error:
            raise InputError(path, "gzip", str(error), "copy the file again") from None
        if header.version > 3 or len(body) < wanted:
            problem = f"version {header.version}, {len(body)} of {wanted} bytes"
            raise InputError(path, "gzip", problem, _MEND)
        ends = np.cumsum(header.sizes)
        return header, np.split(np.frombuffer(body, np.uint8), ends[:-1])
    header = _header(path, data)
    if header.version != 4 or len(data) < _HEADER.size + _CONTAINER.size:
        problem = f"version {header.version} without gzip, of {len(data)} bytes"
        raise InputError(path, "header", problem, _MEND)
    return header, _streams(path, header, data)


def _header(path: Path, data: bytes) -> _Header:
    if len(data) < _HEADER.size or data[:4] != _MAGIC.to_bytes(4, "little"):
        raise InputError(path, "header", "is not that of an SPZ file", "give an SPZ file")
    _, version, count, degree, bits, flags, _ = _HEADER.unpack(data[: _HEADER.size])
    if version not in (2, 3, 4) or degree > MAX_DEGREE or bits > 23 or count > MOST_POINTS:
        problem = f"version {version}, {count} Gaussians of degree {degree}, {bits} fractional bits"
        raise InputError(path, "header", problem, _MEND)
    if flags & _EXTENSIONS:
        raise InputError(path, "flags", "use extensions, which are not supported", _MEND)
    return _Header(version, count, degree, bits, flags)


def _streams(path: Path, header: _Header, data: bytes) -> list[Bytes]:
    """The streams of version 4, behind a table of their sizes."""
    filled = [size for size in header.sizes if size]
    (at,) = _CONTAINER.unpack_from(data, _HEADER.size)
    end = at + len(filled) * _ENTRY.size
    if data[_HEADER.size - 1] != len(filled) or not _HEADER.size < at <= end <= len(data):
        raise InputError(path, "header", "names another number of streams, or no table", _MEND)
    table = [_ENTRY.unpack_from(data, at + i * _ENTRY.size) for i in range(len(filled))]
    found: list[Bytes] = []
    for (length, size), wanted in zip(table, filled, strict=True):
        part = data[end : end + length]
        if size != wanted or len(part) != length:
            problem = f"{len(part)} of {length} bytes for {size}, expected {wanted}"
            raise InputError(path, f"stream {len(found)}", problem, "copy the file again")
        try:
            # Never writes beyond the size it is given: what a stream claims itself is not trusted.
            plain = pa.decompress(part, wanted, "zstd", asbytes=True)
        except (OSError, ValueError) as error:
            raise InputError(path, f"stream {len(found)}", str(error), _MEND) from None
        found.append(np.frombuffer(plain, np.uint8))
        end += length
    queue = iter(found)
    return [next(queue) if size else np.zeros(0, np.uint8) for size in header.sizes]


SPZ = SplatFormat(
    "spz",
    ".spz",
    write_spz,
    read_spz,
    read_low_pass,
    np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),  # x right, y up, z back
    "SPZ; turned: world and actor (x, y, z) = file (-z, -x, y); quantised",
)
