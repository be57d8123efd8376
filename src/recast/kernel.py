"""The compiled CPU kernel: finding it, loading it, its structures and calls. Needs no torch."""

from __future__ import annotations

import contextlib
import ctypes
import os
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

_ABI = 6
_SUFFIXES = (".so", ".dylib", ".dll")


class KernelView(ctypes.Structure):
    """`RecastView` of api.cpp."""

    _fields_ = [
        ("count", ctypes.c_int64),
        *((name, ctypes.c_int32) for name in ("sh_bases", "width", "height")),
        *((name, ctypes.c_int32) for name in ("left", "top", "whole_width", "whole_height")),
        *((name, ctypes.c_int32) for name in ("antialiased", "training", "most_at_once")),
        *((name, ctypes.c_float) for name in ("near", "far", "eps2d", "max_alpha")),
        *((name, ctypes.c_float) for name in ("fx", "fy", "cx", "cy")),
        ("rotation", ctypes.c_float * 9),
        ("translation", ctypes.c_float * 3),
        ("background", ctypes.c_float * 3),
        ("pad", ctypes.c_float),
        *((name, ctypes.c_void_p) for name in ("means", "quats", "log_scales", "logits", "sh")),
        *((name, ctypes.c_void_p) for name in ("rgb", "depth", "alpha")),
        *((name, ctypes.c_void_p) for name in ("visible", "radii", "means2d")),
    ]


class KernelPart(ctypes.Structure):
    """`KernelPart` of frame.hpp."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in ("blocks", "first_chunk", "sh_bases", "antialiased")),
        *((name, ctypes.c_void_p) for name in ("geometry", "colours", "bounds")),
        ("rotation", ctypes.c_float * 9),
        ("translation", ctypes.c_float * 3),
        ("eps2d", ctypes.c_float),
    ]


class Gradients(ctypes.Structure):
    """`RecastGradients` of api.cpp."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("means", "quats", "log_scales", "logits", "sh")),
        *((name, ctypes.c_void_p) for name in ("rgb", "depth", "alpha")),
        *(
            (name, ctypes.c_void_p)
            for name in (
                "means_grad",
                "quats_grad",
                "log_scales_grad",
                "logits_grad",
                "sh_grad",
                "means2d_grad",
                "pose_grad",
                "means2d_absgrad",
            )
        ),
    ]


class AdamRows(ctypes.Structure):
    """`AdamRows` of frame.hpp."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("value", "gradient", "first", "second")),
        *((name, ctypes.c_void_p) for name in ("steps", "low", "high")),
        ("width", ctypes.c_int64),
    ]


class AdamSettings(ctypes.Structure):
    """`AdamSettings` of frame.hpp."""

    _fields_ = [
        (name, ctypes.c_float)
        for name in ("beta1", "beta2", "rest1", "rest2", "epsilon", "correction")
    ]


class Photometric(ctypes.Structure):
    """`Photometric` of frame.hpp."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("image", "target")),
        *((name, ctypes.c_void_p) for name in ("by_mean", "by_square", "by_product")),
        *((name, ctypes.c_void_p) for name in ("sums", "gradient")),
        *((name, ctypes.c_int64) for name in ("height", "row")),
        ("window", ctypes.c_float * 6),
        *((name, ctypes.c_float) for name in ("c1", "c2", "l1", "ssim")),
    ]


class KernelSky(ctypes.Structure):
    """`KernelSky` of sky.hpp."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("rgb", "alpha", "colours", "coordinates")),
        *((name, ctypes.c_void_p) for name in ("image", "image_grad")),
        *((name, ctypes.c_void_p) for name in ("alpha_grad", "colours_grad")),
        *((name, ctypes.c_int64) for name in ("pixels", "height", "width")),
        ("opaque", ctypes.c_float),
    ]


@dataclass(frozen=True)
class NativeInfo:
    """State of the compiled rasterizer.

    Attributes:
        available: it can be used.
        isa: instruction set in use, "" if not available.
        isas: those this machine runs, best first.
        library: the loaded file, None if not available.
        threads: threads it uses.
        reason: why it is not available, "" if it is.
    """

    available: bool
    isa: str
    isas: tuple[str, ...]
    library: Path | None
    threads: int
    reason: str


def _candidates() -> list[Path]:
    """Where the library may lie: in this package, or in the installed distribution.

    An editable install, or a source tree on PYTHONPATH, has the Python files in one place and the
    library in the other.
    """
    packages = [Path(__file__).parent]
    with contextlib.suppress(PackageNotFoundError):
        packages.append(Path(str(distribution("recast-sim").locate_file("recast"))))
    return [
        package / "splats" / "native" / f"recast_native{suffix}"
        for package in packages
        for suffix in _SUFFIXES
    ]


def _declare(library: ctypes.CDLL) -> None:
    pointer: object = ctypes.c_void_p
    integer, short, long, real = ctypes.c_int, ctypes.c_int32, ctypes.c_int64, ctypes.c_float
    signatures: dict[str, tuple[object, list[object]]] = {
        "recast_isa": (ctypes.c_char_p, []),
        "recast_isa_available": (ctypes.c_char_p, [integer]),
        "recast_set_isa": (integer, [ctypes.c_char_p]),
        "recast_threads": (integer, []),
        "recast_set_threads": (None, [integer]),
        "recast_create": (pointer, []),
        "recast_destroy": (None, [pointer]),
        "recast_forward": (
            integer,
            [pointer, ctypes.POINTER(KernelView), ctypes.POINTER(ctypes.c_int64)],
        ),
        "recast_forward_frozen": (
            integer,
            [pointer, ctypes.POINTER(KernelView), ctypes.POINTER(KernelPart), integer],
        ),
        "recast_backward": (integer, [pointer, ctypes.POINTER(Gradients)]),
        "recast_timings": (None, [pointer, ctypes.POINTER(ctypes.c_double)]),
        "recast_bytes": (ctypes.c_int64, [pointer]),
        "recast_intersections": (ctypes.c_uint64, [pointer]),
        "recast_adam": (
            None,
            [
                ctypes.POINTER(AdamRows),
                integer,
                ctypes.POINTER(AdamSettings),
                pointer,
                ctypes.c_int64,
            ],
        ),
        "recast_smooth": (None, [pointer, pointer, long, long, pointer, pointer, long]),
        "recast_borrow": (
            None,
            [*[pointer] * 5, long, long, *[pointer] * 4, long, long, long, real, real]
            + [pointer] * 2,
        ),
        "recast_surface": (None, [pointer, long, *[pointer] * 14]),
        "recast_entered": (None, [*[pointer] * 2, long, *[pointer] * 2, long, pointer]),
        "recast_expose": (None, [*[pointer] * 3, long, real]),
        "recast_first_hits": (
            None,
            [pointer, long, *[pointer] * 4, long, short, *[pointer] * 4],
        ),
        "recast_occluded": (
            None,
            [pointer, long, *[pointer] * 3, long, short, pointer],
        ),
        "recast_edges": (None, [*[pointer] * 7, long, long, real, pointer]),
        "recast_photometric": (None, [ctypes.POINTER(Photometric)]),
        "recast_photometric_backward": (None, [ctypes.POINTER(Photometric)]),
        "recast_sky": (None, [ctypes.POINTER(KernelSky)]),
        "recast_sky_backward": (None, [ctypes.POINTER(KernelSky)]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments


@lru_cache(maxsize=1)
def _load() -> tuple[ctypes.CDLL | None, Path | None, str]:
    """The library, its path, and the reason if there is none."""
    for path in _candidates():
        if not path.is_file():
            continue
        try:
            library = ctypes.CDLL(str(path))
            abi = library.recast_abi()
        except (OSError, AttributeError) as error:
            return None, None, f"{path} cannot be loaded: {error}"
        if abi != _ABI:
            return None, None, f"{path} is of another version (ABI {abi}, expected {_ABI})"
        _declare(library)
        forced = os.environ.get("RECAST_ISA")
        if forced and library.recast_set_isa(forced.encode()) != 0:
            known = ", ".join(_isas(library))
            raise RuntimeError(f"RECAST_ISA={forced}: not available, this machine has {known}")
        return library, path, ""
    return None, None, "it was not built: install recast where a C++ compiler is found"


def _isas(library: ctypes.CDLL) -> tuple[str, ...]:
    names: list[str] = []
    while (name := library.recast_isa_available(len(names))) is not None:
        names.append(name.decode())
    return tuple(names)


def library() -> ctypes.CDLL:
    """The loaded library.

    Raises:
        RuntimeError: it is not available; the message says why.
    """
    loaded, _, reason = _load()
    if loaded is None:
        raise RuntimeError(f"the native rasterizer is not available: {reason}")
    return loaded


def find() -> ctypes.CDLL | None:
    """The loaded library; None where it is not available, see `info` for why."""
    return _load()[0]


def info() -> NativeInfo:
    """What is known about the compiled rasterizer; never raises for a missing one."""
    loaded, path, reason = _load()
    if loaded is None:
        return NativeInfo(False, "", (), None, 0, reason)
    isa = loaded.recast_isa().decode()
    return NativeInfo(True, isa, _isas(loaded), path, loaded.recast_threads(), "")


def set_threads(count: int) -> None:
    """Use `count` threads in the compiled rasterizer (default: one a core); no effect without it.

    Images and gradients do not depend on the number.

    Raises:
        ValueError: count is less than 1.
    """
    if count < 1:
        raise ValueError(f"set_threads: {count}, expected at least 1")
    loaded = find()
    if loaded is not None:
        loaded.recast_set_threads(count)


def set_isa(name: str) -> None:
    """Use the instruction set `name`, one of `info().isas`: for tests and benchmarks.

    Raises:
        RuntimeError: there is no compiled rasterizer.
        ValueError: this machine does not run that instruction set.
    """
    if library().recast_set_isa(name.encode()) != 0:
        raise ValueError(f"set_isa: {name!r}, expected one of {info().isas}")
