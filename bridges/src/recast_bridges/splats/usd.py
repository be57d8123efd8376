"""Gaussians in OpenUSD 26.03 or newer, as text (.usda): prims ParticleField3DGaussianSplat.

https://openusd.org/release/user_guides/schemas/usdVol/ParticleField3DGaussianSplat.html. Numbers
are written in the fewest digits that give the same float32, so that nothing but rounding is lost:
standard deviations and opacities are stored as such, not as log and logit. A stage says itself
which axis points up, y or z, and how long its unit is; what is read has z up and metres.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import torch
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import read_bytes, write_bytes
from recast.geometry import se3
from recast.splats.formats import SplatFormat
from recast.splats.gaussians import MAX_DEGREE, Gaussians, concatenate, from_linear, to_linear
from recast.splats.rasterization import LowPass, parse_low_pass

LONGEST_USD = 1 << 33
"""Bytes of a file, at most."""
_HARMONICS = "radiance:sphericalHarmonicsCoefficients"
_ATTRIBUTES = {
    "positions": (b"point3[fh]", 3),
    "orientations": (b"quat[fh]", 4),
    "scales": (b"(?:float|half)3", 3),
    "opacities": (b"(?:float|half)", 1),
    _HARMONICS: (b"(?:float|half)3", 3),
}
"""Type and numbers of an element; names that end in h hold half floats."""
_ROWS = 1 << 16  # that become text at once: Arrow's texts have 2 GB at most
_ARRAY = re.compile(rb"\[([^\]]*)\]")
_PRIM = re.compile(rb'\bdef\s+ParticleField3DGaussianSplat\s+"[^"\n]*"')
_DEFINED = re.compile(rb"\bdef\s")
_COMPOSED = re.compile(
    rb"\b(xformOp\w*|references|payload|subLayers|inherits|specializes|variantSets?|over|class|"
    rb"timeSamples)\b"
)
_DEGREE = re.compile(rb"\bint\s+radiance:sphericalHarmonicsDegree\s*=\s*(\d+)")
_UP = re.compile(rb'\bupAxis\s*=\s*"([YZ])"')
_UNIT = re.compile(rb"\bmetersPerUnit\s*=\s*([0-9.eE+-]+)")
_FILTER = re.compile(rb'\bstring\s+recast_low_pass\s*=\s*"([^"\n]*)"')
_COLOURS = b"srgb_rec709_display"
_COLOUR_SPACE = re.compile(rb'\bcolorSpace:name\s*=\s*"([^"\n]*)"')
_Y_UP, _CENTIMETRE = b"Y", 0.01  # of a stage that does not say
_MEND = "export it again as one flat .usda file"


def write_usd(path: str | Path, gaussians: Gaussians, low_pass: LowPass | None = None) -> None:
    """Write Gaussians as one prim of a text layer, whole or not at all.

    Args:
        gaussians: N, z up, metres.
        low_pass: the filter that they were made for, told in `customLayerData`.

    Raises:
        ValueError: a field is not valid.
        InputError: the disk refuses.
    """
    gaussians = gaussians.detach().to("cpu")
    gaussians.validate()
    quats, deviations, opacity = to_linear(gaussians)
    reach = 3 * deviations.amax(dim=1, keepdim=True)
    corners = torch.zeros(2, 3)
    if len(gaussians):
        low, high = (gaussians.means - reach).amin(dim=0), (gaussians.means + reach).amax(dim=0)
        corners = torch.stack([low, high])
    told = b"" if low_pass is None else _TOLD % low_pass.text().encode()
    coefficients = gaussians.sh.shape[1]
    lines = [
        b"float3[] extent = " + _text(corners),
        b"point3f[] positions = " + _text(gaussians.means),
        b"quatf[] orientations = " + _text(quats),
        b"float3[] scales = " + _text(deviations),
        b"float[] opacities = " + _text(opacity),
        b"uniform int radiance:sphericalHarmonicsDegree = %d" % gaussians.sh_degree,
        b'uniform token colorSpace:name = "%s"' % _COLOURS,
        b"float3[] %s = " % _HARMONICS.encode() + _text(gaussians.sh.flatten(0, 1)),
    ]
    body = b"".join(b"    " + line + b"\n" for line in lines)
    elements = b" (\n        elementSize = %d\n    )\n}\n" % coefficients
    write_bytes(path, b"".join([_HEAD % told, body.rstrip(b"\n"), elements]))


_TOLD = b"""    customLayerData = {
        string recast_low_pass = "%s"
    }
"""
_HEAD = b"""#usda 1.0
(
%s    defaultPrim = "Gaussians"
    metersPerUnit = 1
    upAxis = "Z"
)

def ParticleField3DGaussianSplat "Gaussians" (
    prepend apiSchemas = ["ColorSpaceAPI"]
)
{
"""


def _text(values: Tensor) -> bytes:
    """An array (N,) or (N, D) as text: a list of numbers or tuples, each in its fewest digits."""
    parts = []
    for rows in values.split(_ROWS):
        words = pc.cast(pa.array(rows.reshape(-1).numpy()), pa.string())
        if values.ndim == 2:
            ends = np.arange(len(rows) + 1, dtype=np.int32) * values.shape[1]
            tuples = pc.binary_join(pa.ListArray.from_arrays(pa.array(ends), words), ", ")
            words = pc.binary_join_element_wise("(", tuples, ")", "")
        whole = pa.ListArray.from_arrays(pa.array([0, len(words)], pa.int32()), words)
        parts.append(pc.binary_join(whole, ", ")[0].as_py().encode())
    return b"[" + b", ".join(part for part in parts if part) + b"]"


def read_usd(path: str | Path, double: bool = False) -> Gaussians:
    """All Gaussians of a text layer, z up, metres.

    Only what stands in the prims themselves is read: a layer that names others, moves prims or
    changes over time is refused.

    Args:
        double: whether centres are float64.

    Raises:
        InputError: the file is missing, no .usda, too large, composed of others, has no such prim
            or one that lacks an attribute, or holds a value that is not finite or out of range.
    """
    path = Path(path)
    data = read_bytes(path, LONGEST_USD)
    if not data.startswith(b"#usda "):
        problem = "does not begin with #usda: binary layers and packages are not read"
        raise InputError(path, "header", problem, "convert it to text with usdcat")
    text, arrays = _without_arrays(data)
    composed = _COMPOSED.search(text)
    if composed is not None:
        raise InputError(path, composed[0].decode(), "is not read", _MEND)
    starts = [match.end() for match in _PRIM.finditer(text)]
    if not starts:
        problem = "is missing: the file draws no Gaussians"
        raise InputError(path, "ParticleField3DGaussianSplat", problem, _MEND)
    spans = zip(starts, [*starts[1:], len(text)], strict=True)
    bodies = [_DEFINED.split(text[start:end], maxsplit=1)[0] for start, end in spans]
    gaussians = concatenate([_prim(path, body, arrays) for body in bodies])
    up, unit = _UP.search(text), _UNIT.search(text)
    scale = _CENTIMETRE if unit is None else _number(path, "metersPerUnit", unit[1])
    if not 0 < scale < np.inf:
        raise InputError(path, "metersPerUnit", f"is {scale}", "write 1 for metres")
    turn = np.eye(3) if up is not None and up[1] == b"Z" else _Z_FROM_Y
    if scale != 1 or turn is _Z_FROM_Y:
        pose = torch.from_numpy(se3.from_rotation_translation(turn, np.zeros(3)))
        gaussians = gaussians.transformed(pose, scale)
    gaussians = gaussians.with_centres(double)
    fault = gaussians.fault()
    if fault is not None:
        raise InputError(path, fault[0], fault[1], _MEND)
    return gaussians


_Z_FROM_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def read_low_pass(path: str | Path) -> LowPass | None:
    """The filter that `write_usd` told; None if the file tells none. Raises InputError: the file is
    missing or too large, or what it tells is no filter."""
    told = _FILTER.search(read_bytes(path, LONGEST_USD))
    return None if told is None else parse_low_pass(path, told[1].decode("ascii", "replace"))


def _without_arrays(data: bytes) -> tuple[bytes, list[bytes]]:
    """The text with each array's number in its place, `[7]`, and the arrays; `[]` stays."""
    parts = _ARRAY.split(data)
    arrays = parts[1::2]
    parts[1::2] = [b"[%d]" % i if array else b"[]" for i, array in enumerate(arrays)]
    return b"".join(parts), arrays


def _prim(path: Path, body: bytes, arrays: list[bytes]) -> Gaussians:
    """The Gaussians of a prim from its text."""
    colours = _COLOUR_SPACE.search(body)
    if colours is not None and colours[1] != _COLOURS:
        problem = f"is {colours[1].decode('ascii', 'replace')}, only {_COLOURS.decode()} is read"
        raise InputError(path, "colorSpace:name", problem, _MEND)
    found = {name: _array(path, body, name, arrays) for name in _ATTRIBUTES}
    n = len(found["positions"])
    degree = _DEGREE.search(body)
    wanted = 3 if degree is None else int(degree[1][:9])
    if wanted > MAX_DEGREE:
        problem = f"is {wanted}, {MAX_DEGREE} at most"
        raise InputError(path, "radiance:sphericalHarmonicsDegree", problem, _MEND)
    rows = dict.fromkeys(_ATTRIBUTES, n) | {_HARMONICS: n * (wanted + 1) ** 2}
    for name, count in rows.items():
        if len(found[name]) != count:
            raise InputError(path, name, f"has {len(found[name])} rows, not {count}", _MEND)
    means = torch.from_numpy(found.pop("positions"))
    quats, scales, opacities, sh = (torch.from_numpy(v).float() for v in found.values())
    return from_linear(means, quats, scales, opacities[:, 0], sh.reshape(n, -1, 3))


def _array(path: Path, body: bytes, name: str, arrays: list[bytes]) -> Array:
    """An attribute (N, D), of floats or of half floats."""
    kind, width = _ATTRIBUTES[name]
    found = re.findall(rb"\b%s\[\]\s+%sh?\s*=\s*\[(\d*)\]" % (kind, name.encode()), body)
    if len(found) != 1:
        problem = "is missing" if not found else "is given twice"
        raise InputError(path, name, problem, _MEND)
    array = arrays[int(found[0])] if found[0] else b""
    tuples, text = array.count(b"("), array.translate(None, b"()")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of numbers that cannot be read
            values = np.fromstring(text, np.float64, sep=",") if text.strip() else np.zeros(0)
    except (DeprecationWarning, ValueError):
        raise InputError(path, name, "holds a value that is not a number", _MEND) from None
    if values.size != (tuples * width if width > 1 else values.size) or (width == 1 and tuples):
        raise InputError(path, name, f"holds {values.size} numbers in {tuples} tuples", _MEND)
    return values.reshape(-1, width)


def _number(path: Path, name: str, text: bytes) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(path, name, "is not a number", _MEND) from None


USD = SplatFormat(
    "usd",
    ".usda",
    write_usd,
    read_usd,
    read_low_pass,
    contents="OpenUSD, ParticleField3DGaussianSplat, z up; not turned",
)
