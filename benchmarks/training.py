"""Training of a scene: held-out PSNR against minutes, as a curve.

    python benchmarks/training.py --log runs/kitti/log
    python benchmarks/training.py --log runs/kitti/log --steps 5600 --every 200 --set voxel_m=0.3

Minutes are wall-clock time, the first scene included, evaluations left out. The last line is the
evaluation of the whole run: its "boxes" is the mean PSNR of the boxes of moving objects.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

from recast.logs import read_log
from recast.reconstruction import SceneConfig, TrainingStatus, evaluate_scene, train_scene


class Curve:
    """Prints a line an evaluation."""

    def __init__(self) -> None:
        self._began = self._last = time.perf_counter()
        self._evaluating = 0.0
        self._phase = ""

    @property
    def minutes(self) -> float:
        """Since the start, without evaluations."""
        return (time.perf_counter() - self._began - self._evaluating) / 60

    def __call__(self, status: TrainingStatus) -> None:
        """What is being done from now on."""
        now = time.perf_counter()
        if self._phase == "evaluate":
            self._evaluating += now - self._last
            print(
                f"{self.minutes:7.2f} {status.iteration:>6} {status.gaussians:>9} "
                f"{status.psnr or 0:>9.2f} {status.held_out_psnr or 0:>9.2f}",
                flush=True,
            )
        self._phase, self._last = status.phase, now


def main() -> None:
    """Train, and print the curve."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=SceneConfig().iterations)
    parser.add_argument("--every", type=int, default=200, help="steps between evaluations")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=JSON", help="configuration")
    chosen = parser.parse_args()
    settings = {
        "iterations": chosen.steps,
        "evaluate_every": chosen.every,
        "threads": chosen.threads,
    }
    for item in chosen.set:
        name, _, value = item.partition("=")
        settings[name] = json.loads(value)
    config = SceneConfig.model_validate(settings)
    log = read_log(chosen.log)
    print(f"{'minutes':>7} {'step':>6} {'Gaussians':>9} {'train dB':>9} {'held out':>9}")
    with tempfile.TemporaryDirectory() as out:
        curve = Curve()
        result = train_scene(log, Path(out) / "scene", config, curve)
        minutes = curve.minutes
        scores = evaluate_scene(result.scene, log, config, None)
    boxes = "none" if scores.box_psnr is None else f"{scores.box_psnr:.2f} dB"
    print(f"{minutes:.2f} min: PSNR {scores.psnr:.2f} dB, SSIM {scores.ssim:.4f}, boxes {boxes}")


if __name__ == "__main__":
    main()
