"""AlpaSim and NuRec: recast as their renderer, and their renderers and drivers for recast's loop
(extra alpasim), and scene bundles, which need no extra."""

from __future__ import annotations

from recast.lazy import getattr_of, names_of

TYPE_CHECKING = False  # typing's own costs 5 ms; type checkers know the name
if TYPE_CHECKING:
    from recast_bridges.alpasim.bundle import ExportedBundle as ExportedBundle
    from recast_bridges.alpasim.bundle import export_bundle as export_bundle
    from recast_bridges.alpasim.bundle_read import load_alpasim as load_alpasim
    from recast_bridges.alpasim.client import SensorsimClient as SensorsimClient
    from recast_bridges.alpasim.client import SensorsimRenderer as SensorsimRenderer
    from recast_bridges.alpasim.driver import AlpaSimDriver as AlpaSimDriver
    from recast_bridges.alpasim.messages import message as message
    from recast_bridges.alpasim.messages import parse as parse
    from recast_bridges.alpasim.server import SensorsimServer as SensorsimServer
    from recast_bridges.alpasim.server import SensorsimService as SensorsimService
    from recast_bridges.rendering import ScenePainter as ScenePainter
    from recast_bridges.rendering import ServedScene as ServedScene

_PLACES = {
    "..rendering": ("ScenePainter", "ServedScene"),
    ".bundle": ("ExportedBundle", "export_bundle"),
    ".bundle_read": ("load_alpasim",),
    ".client": ("SensorsimClient", "SensorsimRenderer"),
    ".driver": ("AlpaSimDriver",),
    ".messages": ("message", "parse"),
    ".server": ("SensorsimServer", "SensorsimService"),
}
__all__ = names_of(_PLACES)
__getattr__ = getattr_of(__name__, _PLACES)  # gRPC is an extra
