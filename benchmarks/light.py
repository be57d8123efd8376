"""What lighting an actor where it stands adds to a frame of the closed loop.

    recast demo --out runs/demo
    python benchmarks/light.py runs/demo

Frames of all cameras of the log are drawn with the generated actor at the places where the track
was, a new one for each frame, so that nothing is kept from the frame before. Lit and not lit take
turns; times are medians of the process's CPU seconds.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import process_time

import numpy as np
import torch
from numpy.typing import NDArray

from recast.actors import insert, load_actor
from recast.geometry import se3
from recast.logs import read_log
from recast.scene import SceneRasterizer, load_scene
from recast.scene.light import SceneLight
from recast.simulation import camera_mounts
from recast.splats import set_threads

Array = NDArray[np.float64]


def main() -> None:
    """Print the seconds of a frame, lit and not lit, and the share that light takes."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="of `recast demo`")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--threads", type=int, default=1)
    chosen = parser.parse_args()
    torch.set_num_threads(chosen.threads)
    set_threads(chosen.threads)

    log, run = read_log(chosen.folder / "log"), chosen.folder / "run"
    scene = load_scene(run / "scenes" / "recast")
    actor = load_actor(run / "actors" / "replaced" / "actor")
    began = process_time()
    SceneLight.of(scene)
    street = process_time() - began
    began = process_time()
    lit = insert(scene, actor)
    inserted = process_time() - began

    rasterizers = {
        "lit": SceneRasterizer(lit),
        "not lit": SceneRasterizer(insert(scene, actor, relit=False)),
    }
    mounts = camera_mounts(log)
    times = log.world_from_rig.timestamps_us
    times = times[np.linspace(0, len(times) - 1, chosen.frames + 1).astype(int)[:-1]]
    seconds: dict[str, list[float]] = {name: [] for name in rasterizers}
    for time in times:
        pose = log.tracks[actor.track_id].trajectory.at(int(time))
        rig = log.world_from_rig.at(int(time))
        for name, rasterizer in rasterizers.items():
            began = process_time()
            for mount in mounts.values():
                view = se3.inverse(rig @ mount.rig_from_camera)
                rasterizer.draw(mount.camera, view, {actor.track_id: pose})
            seconds[name].append(process_time() - began)
    medians = {name: float(np.median(each)) for name, each in seconds.items()}
    extra = float(np.median(np.subtract(seconds["lit"], seconds["not lit"])))
    print(
        f"{len(mounts)} cameras, {len(scene.background)} Gaussians of the street, "
        f"{len(actor.gaussians)} of the actor, {chosen.threads} threads\n"
        f"a frame: {medians['not lit'] * 1e3:.0f} ms not lit, {medians['lit'] * 1e3:.0f} ms lit; "
        f"light takes {extra / medians['not lit']:.1%}\n"
        f"once: {street:.2f} s for the street's light, {inserted:.2f} s to insert the actor with it"
    )


if __name__ == "__main__":
    main()
