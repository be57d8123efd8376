"""recast: closed-loop driving simulation from recorded logs with view-complete actors."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("recast-sim")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"
