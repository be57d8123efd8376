"""The compiled CPU rasterizer: loading, threads, working memory."""

from recast.kernel import NativeInfo, info, set_isa, set_threads
from recast.splats.native.rasterizer import free_memory

__all__ = ["NativeInfo", "free_memory", "info", "set_isa", "set_threads"]
