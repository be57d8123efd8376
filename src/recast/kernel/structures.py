"""The structures that cross the border to the compiled rasterizer."""

from __future__ import annotations

import ctypes


class View(ctypes.Structure):
    """`RecastView` of api.cpp."""

    _fields_ = [
        ("count", ctypes.c_int64),
        *((name, ctypes.c_int32) for name in ("sh_bases", "width", "height")),
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
