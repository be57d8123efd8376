"""Studies over many runs: the paper's closed-loop protocol (scenes x motions x settings x arms),
whole scenes, vehicles, planners and the trust in verdicts.
"""

from recast.studies.closed_loop import run_closed_loop
from recast.studies.grid import BenchScene, BenchSettings, DriveSize, parse_scenes, resolve_bench

__all__ = [
    "BenchScene",
    "BenchSettings",
    "DriveSize",
    "parse_scenes",
    "resolve_bench",
    "run_closed_loop",
]
