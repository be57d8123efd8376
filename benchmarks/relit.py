"""What lighting an actor where it stands brings, against the truth.

    recast demo --quick --scene underpass --seed 1 --out runs/underpass
    python benchmarks/relit.py runs/underpass runs/...

For each folder of `recast demo`: PSNR and SSIM in the vehicle's box, mean over the views of the
step `truth`, of the scene's own actor, of the generated actor as it was recorded, and of the same
actor lit where it stands.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from recast.actors import insert, load_actor
from recast.logs import read_log
from recast.metrics.oracle_views import Painter, ViewSettings, place_views
from recast.scene import load_scene
from recast.simulation import camera_mounts
from recast.splats import set_threads
from recast.synthetic import Oracle, world_of
from recast.synthetic.world import exposure

NAMES = ("native", "not relit", "relit")


def scores(folder: Path, settings: ViewSettings) -> tuple[str, dict[str, tuple[float, float]]]:
    """Name of the drive, and mean PSNR and SSIM by name."""
    log, run = read_log(folder / "log"), folder / "run"
    world = world_of(log)
    scene = load_scene(run / "scenes" / "recast")
    actor = load_actor(run / "actors" / "replaced" / "actor")
    models = (scene, insert(scene, actor, relit=False), insert(scene, actor))
    mounts = camera_mounts(log)
    track = log.tracks[actor.track_id]
    exposures = {name: exposure(world.seed, name) for name in mounts}
    painter = Painter(
        dict(zip(NAMES, models, strict=True)),
        Oracle(world),
        actor.track_id,
        track.size,
        mounts,
        exposures,
    )
    found = []
    for view in place_views(log, track, mounts, settings):
        rectangle = painter.rectangle(view)
        if rectangle is not None:
            found.append(painter.compare(view, rectangle)[0])
    return f"{world.name} {world.seed}", {
        name: (
            float(np.mean([one[name].psnr for one in found])),
            float(np.mean([one[name].ssim for one in found])),
        )
        for name in NAMES
    }


def main() -> None:
    """Print a row for each run, then the mean and the worst gain."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+", help="of `recast demo`")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--moments", type=int, default=ViewSettings().moments)
    chosen = parser.parse_args()
    torch.set_num_threads(chosen.threads)
    set_threads(chosen.threads)
    gains = []
    print("| drive | " + " | ".join(NAMES) + " | gain |")
    print("|---|" + "---|" * (len(NAMES) + 1))
    for folder in chosen.folders:
        drive, means = scores(folder, ViewSettings(moments=chosen.moments))
        gains.append(means["relit"][0] - means["not relit"][0])
        cells = [f"{psnr:.2f} dB, {ssim:.3f}" for psnr, ssim in means.values()]
        print(f"| {drive} | {' | '.join(cells)} | {gains[-1]:+.2f} |", flush=True)
    print(f"\nmean gain {np.mean(gains):+.2f} dB, worst {min(gains):+.2f} dB")


if __name__ == "__main__":
    main()
