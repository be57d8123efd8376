"""The viewer on a run: seconds to the first state, updates a second, and memory while it plays.

python benchmarks/viewer.py runs/demo/run --seconds 600
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path


def resident_mb() -> float:
    """Memory of this process now, MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", type=Path, nargs="+")
    parser.add_argument("--seconds", type=float, default=60.0, help="of play, for the memory")
    parser.add_argument("--updates", type=int, default=600, help="for the rate")
    parser.add_argument("--max-gaussians", type=int, default=300_000)
    options = parser.parse_args()
    began = time.perf_counter()

    from recast.runs.view import view_inputs
    from recast.viewer import Page
    from recast.viewer.stage import Shown

    imported = time.perf_counter()
    inputs = view_inputs(options.what)
    loaded = time.perf_counter()
    page = Page(inputs, options.max_gaussians)
    served = time.perf_counter()
    print(
        f"first state after {served - began:.2f} s: imports {imported - began:.2f}, "
        f"loading {loaded - imported:.2f}, page {served - loaded:.2f}; CPU time in all "
        f"{time.process_time():.2f} s; {page.pruned}"
    )
    shown, steps = page.playback.shown, len(page.playback.drive)
    start, cpu = time.perf_counter(), time.process_time()
    for number in range(options.updates):
        page.stage.show(Shown(shown.scenario, shown.arm, number % steps), number % 6 == 0)
    wall, used = time.perf_counter() - start, time.process_time() - cpu
    print(
        f"{options.updates / wall:.0f} updates a second "
        f"({used / options.updates * 1e3:.1f} ms of CPU each), every sixth with pictures"
    )
    page.playback.play(True)
    time.sleep(min(10.0, options.seconds / 4))
    before, begun, passed = resident_mb(), time.monotonic(), 0
    last = page.playback.step
    while time.monotonic() - begun < options.seconds:
        time.sleep(0.01)
        passed += page.playback.step != last
        last = page.playback.step
    after = resident_mb()
    print(
        f"{options.seconds:.0f} s of play, {passed} steps shown: memory {before:.0f} MB before, "
        f"{after:.0f} MB after ({after - before:+.1f} MB)"
    )
    page.close()


if __name__ == "__main__":
    main()
