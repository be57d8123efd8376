"""The paper's closed-loop protocol: scenes x motions x settings x arms, as one command."""

from recast.pipeline.bench.closed_loop import run_closed_loop
from recast.pipeline.bench.grid import (
    BenchScene,
    BenchSettings,
    DriveSize,
    parse_scenes,
    resolve_bench,
)

__all__ = [
    "BenchScene",
    "BenchSettings",
    "DriveSize",
    "parse_scenes",
    "resolve_bench",
    "run_closed_loop",
]
