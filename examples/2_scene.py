"""Reconstruct the street of a log, and draw it from one metre beside the drive.

python examples/2_scene.py LOG_FOLDER IMAGE.png [TRAINING_STEPS]
"""

import sys

import numpy as np
from PIL import Image

import recast
from recast.geometry import se3
from recast.scene import SceneRasterizer


def main(source: str, out: str, iterations: str = "2800") -> None:
    log = recast.load_log(source)
    scene = recast.reconstruct(log, scale=0.5, iterations=int(iterations))  # or found in the store
    print(f"{len(scene.background)} Gaussians, actors: {', '.join(scene.actors)}")

    stream = next(iter(log.cameras.values()))
    time_us = int(stream.timestamps_us[0])
    aside = np.eye(4)
    aside[1, 3] = 1.0  # metres to the left of the rig
    world_from_camera = log.world_from_rig.at(time_us) @ aside @ stream.rig_from_camera
    drawn = SceneRasterizer(scene).render(
        stream.camera, se3.inverse(world_from_camera), scene.actor_poses(time_us)
    )
    Image.fromarray((drawn.rgb * 255).astype(np.uint8)).save(out)
    print(f"wrote {out}")


if __name__ == "__main__":
    main(*sys.argv[1:])
