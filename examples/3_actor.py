"""Make the vehicle of a track complete from every side, and put it into the street.

python examples/3_actor.py LOG_FOLDER TRACK OUT_FOLDER [GENERATOR] [TRAINING_STEPS] [REFINE]
"""

import sys

import recast
from recast.actors import save_actor


def main(
    source: str,
    track: str,
    out: str,
    generator: str = "auto",
    iterations: str = "2800",
    refine: str = "yes",
) -> None:
    log = recast.load_log(source)
    scene = recast.reconstruct(log, scale=0.5, iterations=int(iterations))
    # Without a scene the vehicle is only registered to the boxes and the LiDAR.
    against = scene if refine == "yes" else None
    actor = recast.make_actor(log, track, scene=against, generator=generator)
    print(actor.provenance.registration.explain())
    if actor.provenance.refinement is not None:
        print(actor.provenance.refinement.explain())

    save_actor(actor, out)  # recast.load_actor reads it
    street = scene.with_actor(actor)  # the scene itself does not change
    print(f"track {track} has {len(street.actors[track].gaussians)} Gaussians")


if __name__ == "__main__":
    main(*sys.argv[1:])
