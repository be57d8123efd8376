"""Studies over many runs: the paper's closed-loop protocol (scenes x motions x settings x arms),
whole scenes, vehicles, planners, their training in the loop, and the trust in verdicts.
"""

from recast.studies.closed_loop import run_closed_loop
from recast.studies.grid import BenchScene, BenchSettings, DriveSize, parse_scenes, resolve_bench
from recast.studies.teaching import Learner, collect_samples, read_samples, train_in_the_loop

__all__ = [
    "BenchScene",
    "BenchSettings",
    "DriveSize",
    "Learner",
    "collect_samples",
    "parse_scenes",
    "read_samples",
    "resolve_bench",
    "run_closed_loop",
    "train_in_the_loop",
]
