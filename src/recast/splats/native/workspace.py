"""Native working memory: one context a view, recycled."""

from __future__ import annotations

import ctypes
import weakref

from recast.kernel.library import library
from recast.splats.native import memory

STAGES = ("project", "sort", "bin", "raster", "raster_backward", "project_backward")
_idle: list[int] = []


class Workspace:
    """The memory of one view from its forward to its backward pass.

    Whoever holds the object owns the memory; when it is collected, the native context (tens to
    hundreds of MB) is kept for the next view instead of being freed.
    """

    def __init__(self) -> None:
        try:
            handle = _idle.pop()
        except IndexError:
            handle = library().recast_create()
        if not handle:
            raise MemoryError("rasterize: no memory for a native context")
        self.handle: int = handle
        weakref.finalize(self, _idle.append, handle).atexit = False

    def timings(self) -> dict[str, float]:
        """CPU milliseconds of each stage of the last passes, all threads together."""
        values = (ctypes.c_double * len(STAGES))()
        library().recast_timings(self.handle, values)
        return dict(zip(STAGES, values, strict=True))

    def nbytes(self) -> int:
        """Bytes held."""
        return int(library().recast_bytes(self.handle))

    def intersections(self) -> int:
        """Pairs of a Gaussian and a tile in the last forward pass."""
        return int(library().recast_intersections(self.handle))


def free_memory() -> None:
    """Free the working memory that no view and no tensor holds."""
    memory.clear()
    while _idle:
        library().recast_destroy(_idle.pop())
