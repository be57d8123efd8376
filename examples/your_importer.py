"""An importer of your own: python examples/your_importer.py FOLDER OUT.

The format is made up: DRIVE/ego.csv, boxes.csv, camera.csv and one PNG in front/ for each row of
ego.csv. The script writes such a drive into FOLDER, imports it into the log folder OUT and reads
that. With a drive of yours: recast log import examples.your_importer:load_csv FOLDER --drive DRIVE
"""

import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import recast
from recast.cameras import PinholeCamera
from recast.geometry import se2, se3
from recast.logs import CameraStream, DrivingLog, Track, Trajectory
from recast.logs.images import ImageFiles, encode

# Camera axes (right, down, forward) in rig axes (forward, left, up).
RIG_FROM_OPENCV = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]


def load_csv(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """The log of a drive: recast checks the rest, and derives a map from the drive."""
    folder = Path(root) / drive
    ego = numbers(folder / "ego.csv", ("time_us", "x", "y", "heading"))
    boxes = labels or folder / "boxes.csv"
    columns = ("time_us", "id", "x", "y", "z", "heading", "length", "width", "height")
    rows = numbers(boxes, columns)
    width, height, focal, forward, up = numbers(
        folder / "camera.csv", ("width", "height", "focal", "forward", "up")
    )[0]
    files = tuple(sorted((folder / "front").glob("*.png")))
    if len(files) != len(ego):
        problem = f"{len(files)} images, but ego.csv has {len(ego)} rows"
        raise recast.InputError(folder, "front", problem, "give one PNG for each row")
    times = ego[:, 0].astype(np.int64)
    front = CameraStream(
        name="front",
        camera=PinholeCamera(int(width), int(height), focal, focal, width / 2, height / 2),
        rig_from_camera=se3.from_rotation_translation(RIG_FROM_OPENCV, [forward, 0.0, up]),
        timestamps_us=times,
        images=ImageFiles(files, int(width), int(height), "camera.csv"),  # decoded on demand
    )
    tracks = {}
    for number in np.unique(rows[:, 1]):
        own = rows[rows[:, 1] == number]
        path = Trajectory(own[:, 0].astype(np.int64), se2.to_se3(own[:, [2, 3, 5]], own[:, 4]))
        tracks[f"{number:g}"] = Track(f"{number:g}", "car", own[0, 6:9], path)
    return DrivingLog(
        name=drive,
        cameras={"front": front} if "front" in (cameras or ["front"]) else {},
        lidars={},
        world_from_rig=Trajectory(times, se2.to_se3(ego[:, 1:4])),
        tracks=tracks,
        metadata={"dataset": "made up"},
    )


def numbers(path: Path, columns: Sequence[str]) -> np.ndarray:
    """(N, columns) cells of a CSV file; what is wrong with it is one clear line."""
    try:
        with path.open(newline="") as file:
            rows = [[float(row[name]) for name in columns] for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError) as error:
        problem = f"cannot be read ({type(error).__name__}: {error})"
        mend = f"give the columns {', '.join(columns)}, all numbers"
        raise recast.InputError(path, "table", problem, mend) from error
    if not rows:
        raise recast.InputError(path, "table", "has no rows", "give a row for each moment")
    return np.array(rows)


def write_made_up_drive(folder: Path) -> None:
    """4 s at 8 m/s behind a car that is 15 m ahead."""
    (folder / "front").mkdir(parents=True)
    ego, boxes = ["time_us,x,y,heading"], ["time_us,id,x,y,z,heading,length,width,height"]
    for k in range(41):
        ego.append(f"{100_000 * k},{0.8 * k},0,0")
        boxes.append(f"{100_000 * k},7,{0.8 * k + 18},0,0.8,0,4.5,1.9,1.6")
        image = np.full((96, 160, 3), 150, np.uint8)
        image[45:62, 68:92] = (60, 60, 160)
        (folder / "front" / f"{k:06d}.png").write_bytes(encode(image))
    (folder / "ego.csv").write_text("\n".join(ego))
    (folder / "boxes.csv").write_text("\n".join(boxes))
    (folder / "camera.csv").write_text("width,height,focal,forward,up\n160,96,120,1.5,1.4")


def main(root: str, out: str) -> None:
    if not (Path(root) / "morning").exists():
        write_made_up_drive(Path(root) / "morning")
    recast.write_log(recast.load_log(root, importer=load_csv, drive="morning"), out)
    log = recast.load_log(out)
    print(log)
    for track in log.tracks.values():
        print(f"track {track.track_id}: {track.category}, {len(track.trajectory.poses)} boxes")


if __name__ == "__main__":
    main(*sys.argv[1:])
