"""A world driven through by the rig, written as an ordinary log."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast import storage
from recast.logs import CameraStream, DrivingLog, LidarStream, Track, write_log
from recast.synthetic.label_noise import check_label_noise, with_label_noise
from recast.synthetic.oracle import instances
from recast.synthetic.oracle_pool import OraclePool
from recast.synthetic.populate import world_metadata
from recast.synthetic.rendering import require_embree, working_llvm
from recast.synthetic.rig import LIDAR, Rig, make_rig
from recast.synthetic.sensors import Measurement, SpooledImages, SpooledSweeps, measure
from recast.synthetic.truth import FOLDER, TruthRecord, write_truth_record
from recast.synthetic.world import Quality, World

Progress = Callable[[int, int], None]
"""Called with how many images and sweeps are done, and how many there will be."""


def synthesize_log(
    world: World,
    out: str | Path,
    *,
    width: int = 480,
    height: int = 320,
    cameras: tuple[str, ...] | None = None,
    workers: int = 0,
    truth: bool = False,
    label_noise: float = 0.0,
    progress: Progress | None = None,
) -> None:
    """Write what the rig sees of `world` to the new log folder `out`.

    Ten times a second, up to but not at the last pose of the ego, all cameras and the LiDAR measure
    at the same instant: no rolling shutter, and sweeps are instantaneous. Labelled is every vehicle
    that any sensor ever saw, at all poses. The folder appears whole or not at all, and holds the
    same bytes for the same world whatever the number of workers.

    Args:
        width, height: of the images, pixels.
        cameras: names out of `rig.CAMERAS`, None for all.
        workers: processes; 0 for one for each core.
        truth: also write exact depth and instance masks, see `recast.synthetic.truth`.
        label_noise: metres, standard deviation of the boxes, see `with_label_noise`.

    Raises:
        InputError: an impossible size, an unknown camera, negative noise or workers; `out` exists;
            embreex is missing; the disk is full.
    """
    check_request(out, width, height, label_noise, cameras, world.light)
    rig = make_rig(width, height, cameras)
    with OraclePool(world, workers) as pool, storage.atomic_folder(out) as folder:
        spool, truth_folder = folder / "spool", folder / FOLDER if truth else None
        for sensor in (*rig.cameras, LIDAR):
            (spool / sensor).mkdir(parents=True)
        jobs = list(_measurements(world, rig, spool, truth_folder))
        seen: set[int] = set()
        for done, met in enumerate(pool.map(measure, jobs), 1):
            seen.update(met)
            if progress is not None:
                progress(done, len(jobs))
        pool.close()
        log = _log(world, rig, spool, _tracks(world, seen, label_noise))
        write_log(log, folder / "log")
        shutil.rmtree(spool)
        for entry in sorted((folder / "log").iterdir()):
            entry.replace(folder / entry.name)
        (folder / "log").rmdir()
        if truth_folder is not None:
            frames = dict.fromkeys(rig.cameras, len(moments(world)))
            names = {number: track_id for track_id, number in instances(world).items()}
            write_truth_record(truth_folder, TruthRecord(frames=frames, instances=names))


def check_request(
    out: str | Path,
    width: int,
    height: int,
    label_noise: float,
    cameras: tuple[str, ...] | None = None,
    light: Quality = "standard",
) -> None:
    """Refuse what `synthesize_log` would refuse, before a world is made for it.

    Raises:
        InputError: an impossible size, an unknown camera, negative noise, `out` exists, or embreex
            or what `light` needs is not installed.
    """
    require_embree()
    if light == "mitsuba":
        working_llvm()
    make_rig(width, height, cameras)
    check_label_noise(label_noise)
    storage.require_new(out)


def moments(world: World) -> NDArray[np.int64]:
    """Times (F,) of images and sweeps, microseconds: those of all poses but the last."""
    return world.ego.timestamps_us[:-1]


def _measurements(world: World, rig: Rig, spool: Path, truth: Path | None) -> Iterator[Measurement]:
    for frame, timestamp in enumerate(moments(world).tolist()):
        for sensor in (*rig.cameras, LIDAR):
            yield Measurement(sensor, frame, timestamp, rig, spool, truth)


def _tracks(world: World, seen: set[int], label_noise: float) -> dict[str, Track]:
    labelled = {key for key, number in instances(world).items() if number in seen}
    tracks = {
        key: Track(key, vehicle.model.category, vehicle.model.size, vehicle.trajectory)
        for key, vehicle in world.vehicles.items()
        if key in labelled
    }
    return with_label_noise(tracks, label_noise, world.seed)


def _log(world: World, rig: Rig, spool: Path, tracks: dict[str, Track]) -> DrivingLog:
    times = moments(world)
    cameras = {
        name: CameraStream(
            name=name,
            camera=mounted.camera,
            rig_from_camera=mounted.rig_from_camera,
            timestamps_us=times,
            images=SpooledImages(spool, name, len(times)),
        )
        for name, mounted in rig.cameras.items()
    }
    lidar = LidarStream(LIDAR, rig.rig_from_lidar, times, SpooledSweeps(spool, times))
    return DrivingLog(
        name=f"{world.name}-{world.seed}",
        cameras=cameras,
        lidars={LIDAR: lidar},
        world_from_rig=world.ego,
        tracks=tracks,
        map=world.street.map,
        metadata=world_metadata(world),
    )
