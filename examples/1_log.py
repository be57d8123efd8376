"""Look at the tracks of a driving log: python examples/1_log.py LOG_FOLDER."""

import sys

import numpy as np

import recast


def main(source: str) -> None:
    log = recast.load_log(source)  # a folder, or an address such as s3://bucket/folder
    path = log.world_from_rig.poses[:, :2, 3]  # (T, 2): where the ego was, in metres
    driven = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    print(f"{log.name}: {', '.join(log.cameras)}; the ego drove {driven:.1f} m")

    for name, track in log.tracks.items():
        times_us, poses = track.trajectory.timestamps_us, track.trajectory.poses
        seconds = (times_us[-1] - times_us[0]) / 1e6
        moved = np.linalg.norm(poses[-1, :3, 3] - poses[0, :3, 3])
        length, width, height = track.size
        print(
            f"track {name}: {track.category}, {length:.1f} x {width:.1f} x {height:.1f} m, "
            f"labelled for {seconds:.1f} s, moved {moved:.1f} m"
        )

    camera = next(iter(log.cameras.values()))
    print(f"first image of {camera.name}: {camera.images[0].shape}")  # decoded now


if __name__ == "__main__":
    main(*sys.argv[1:])
