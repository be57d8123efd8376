"""AlpaSim and NuRec: recast as their renderer, and their renderers and drivers for recast's loop
(extra alpasim), and scene bundles, which need no extra."""

from __future__ import annotations

TYPE_CHECKING = False  # typing's own costs 5 ms; type checkers know the name
if TYPE_CHECKING:
    from recast_bridges.alpasim.bundle import ExportedBundle, export_bundle
    from recast_bridges.alpasim.bundle_read import load_alpasim
    from recast_bridges.alpasim.client import SensorsimClient, SensorsimRenderer
    from recast_bridges.alpasim.driver import AlpaSimDriver
    from recast_bridges.alpasim.messages import message, parse
    from recast_bridges.alpasim.server import SensorsimServer, SensorsimService
    from recast_bridges.rendering import ScenePainter, ServedScene

_FILES = {
    "AlpaSimDriver": ".driver",
    "ExportedBundle": ".bundle",
    "ScenePainter": "..rendering",
    "SensorsimClient": ".client",
    "SensorsimRenderer": ".client",
    "SensorsimServer": ".server",
    "SensorsimService": ".server",
    "ServedScene": "..rendering",
    "export_bundle": ".bundle",
    "load_alpasim": ".bundle_read",
    "message": ".messages",
    "parse": ".messages",
}

__all__ = [
    "AlpaSimDriver",
    "ExportedBundle",
    "ScenePainter",
    "SensorsimClient",
    "SensorsimRenderer",
    "SensorsimServer",
    "SensorsimService",
    "ServedScene",
    "export_bundle",
    "load_alpasim",
    "message",
    "parse",
]


def __getattr__(name: str) -> object:
    """A name of `__all__`, imported when it is first used: gRPC is an extra."""
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_FILES[name], __name__), name)
