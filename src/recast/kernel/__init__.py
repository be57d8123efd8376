"""The compiled CPU kernel: finding it, loading it, its calls. Needs no torch, unlike its users."""

from recast.kernel.library import NativeInfo, info, set_isa, set_threads

__all__ = ["NativeInfo", "info", "set_isa", "set_threads"]
