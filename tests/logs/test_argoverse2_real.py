"""The Argoverse 2 importer and PDM-Closed on two real logs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
from pyarrow import feather

from recast.dynamics import PACIFICA
from recast.geometry import boxes, se2, se3
from recast.logs import DrivingLog, Track, all_track_points, read_log, write_log
from recast.logs.importers.argoverse2 import BOX_DELAY_US, load_argoverse2
from recast.planning.map import planner_map, route_blocks
from recast.planning.pdm.closed import PdmClosedPlanner
from recast.planning.types import ReferenceRoute
from recast.simulation import RolloutSetup, run_rollout
from recast.simulation.actor_motion import StartSituation

SENSORS = "7fab2350-7eaf-3b7e-a39d-6937a4c1bede"
NO_SENSORS = "3bffdcff-c3a7-38b6-a0f2-64196d130958"
LOGS = (SENSORS, NO_SENSORS)
VEHICLES = ("car", "truck", "bus", "tram")


@pytest.fixture(scope="module")
def logs(shared: Path) -> dict[str, DrivingLog]:
    root = shared / "data" / "argoverse2"
    if not root.is_dir():
        pytest.skip(f"{root} not found")
    return {name: load_argoverse2(root, name) for name in LOGS}


def _off_area(log: DrivingLog, ego_boxes: np.ndarray) -> float:
    """Metres that a corner of the ego's box is off the surveyed area at the worst."""
    assert log.map is not None
    area = shapely.union_all([shapely.Polygon(o).buffer(0) for o in log.map.drivable_area])
    corners = boxes.bev_corners(ego_boxes, PACIFICA.length, PACIFICA.width)
    return float(shapely.distance(area, shapely.points(corners)).max())


def test_what_the_logs_hold_is_read(logs: dict[str, DrivingLog]) -> None:
    full, bare = logs[SENSORS], logs[NO_SENSORS]
    assert len(full.tracks) == 114 and len(bare.tracks) == 115  # less the ego's own box
    assert len(full.cameras) == 9 and not bare.cameras and not bare.lidars
    assert full.cameras["ring_front_center"].camera.height == 2048
    assert all(len(camera.images) == 0 for camera in full.cameras.values())
    for log in logs.values():
        log.validate()
        assert log.map is not None and log.map.ground is not None
        log.map.validate()
        places = log.world_from_rig.poses[:, :3, 3]
        above = places[:, 2] - log.map.ground.at(places[:, :2])
        assert abs(np.nanmedian(above)) < 0.02
        for lane in log.map.lanes.values():
            for other in lane.successors:
                ahead = log.map.lanes[other].centreline[0] - lane.centreline[-1]
                assert np.linalg.norm(ahead[:2]) < 0.1


def test_boxes_hold_the_labelled_points_after_the_log_is_stored(
    logs: dict[str, DrivingLog], shared: Path, tmp_path: Path
) -> None:
    path = shared / "data" / "argoverse2" / "val" / SENSORS / "annotations.feather"
    table = feather.read_table(path, memory_map=False)
    wanted = {
        (int(time) // 1000, track): count
        for time, track, count in zip(
            *(
                table[name].to_pylist()
                for name in ("timestamp_ns", "track_uuid", "num_interior_pts")
            ),
            strict=True,
        )
    }
    times = logs[SENSORS].lidars["up_lidar"].timestamps_us.tolist()
    hold = [time + BOX_DELAY_US for time in times]

    def in_sweeps(track: Track) -> Track:
        kept = np.isin(track.trajectory.timestamps_us, hold)
        part = replace(
            track.trajectory,
            timestamps_us=track.trajectory.timestamps_us[kept],
            poses=track.trajectory.poses[kept],
        )
        return replace(track, trajectory=part)

    # Only what is looked at: writing all 11,000 boxes takes ten seconds.
    vehicles = {k: in_sweeps(t) for k, t in logs[SENSORS].tracks.items() if t.category in VEHICLES}
    seen = {k: t for k, t in vehicles.items() if len(t.trajectory.timestamps_us)}
    write_log(replace(logs[SENSORS], tracks=seen, map=None), tmp_path / "log")
    log = read_log(tmp_path / "log")
    compared = 0
    for index, time in enumerate(times):
        points = np.concatenate([lidar.sweeps[index].points for lidar in log.lidars.values()])
        world = se3.apply(log.world_from_rig.at(time), points)
        for name, track in log.tracks.items():
            # As the points were scanned and the boxes drawn: at one place, whatever their times.
            at = time + BOX_DELAY_US
            if at not in track.trajectory.timestamps_us:
                continue
            inside = int(boxes.contains(world, track.size, track.trajectory.at(at)).sum())
            assert abs(inside - wanted[time, name]) <= 2, (name, inside, wanted[time, name])
            compared += 1
    assert compared > 50


def test_fast_cars_keep_their_points_moved_to_their_own_times(logs: dict[str, DrivingLog]) -> None:
    log = logs[SENSORS]
    early = {
        name: replace(
            track,
            trajectory=replace(
                track.trajectory, timestamps_us=track.trajectory.timestamps_us - BOX_DELAY_US
            ),
        )
        for name, track in log.tracks.items()
        if name.startswith(("3c6c66", "7f57d7"))  # ahead of the ego, 10.4 m/s
    }
    held = all_track_points(log, {name: log.tracks[name] for name in early})
    lost = all_track_points(log, early)
    for name in early:
        assert len(held[name].points) > 2 * len(lost[name].points) > 0


@pytest.mark.parametrize("name", LOGS)
def test_the_recorded_ego_stays_on_the_drivable_area_and_its_route_on_lanes(
    logs: dict[str, DrivingLog], name: str
) -> None:
    log = logs[name]
    rear = se2.from_se3(log.world_from_rig.poses)
    ahead = np.stack([np.cos(rear[:, 2]), np.sin(rear[:, 2])], axis=-1)
    centre = rear[:, :2] + PACIFICA.centre_offset * ahead
    assert _off_area(log, np.column_stack([centre, rear[:, 2]])) == 0.0
    assert log.map is not None
    lanes = planner_map(log.map)
    blocks = route_blocks(lanes, ReferenceRoute.from_trajectory(log.world_from_rig))
    assert len(blocks) >= 3
    for before, after in pairwise(blocks):
        assert after in lanes.blocks[before].successors


@dataclass(frozen=True)
class Recorded:
    """The controlled actor drives as it was recorded, and stands before and after."""

    track: Track
    start_us: int
    name: str = "recorded"
    setting: str = "a"

    def script(self, start: StartSituation, steps: int, dt: float) -> np.ndarray:
        times = self.start_us + np.round(np.arange(steps + 1) * dt * 1e6).astype(np.int64)
        labelled = self.track.trajectory.timestamps_us[[0, -1]]
        pose = se2.from_se3(self.track.trajectory.at(np.clip(times, *labelled)))
        speed = np.linalg.norm(np.gradient(pose[:, :2], dt, axis=0), axis=1)
        return np.column_stack([pose, speed])


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        (SENSORS, 3.0),
        (NO_SENSORS, 3.0),
        pytest.param(SENSORS, 15.9, marks=pytest.mark.slow),
        pytest.param(NO_SENSORS, 15.9, marks=pytest.mark.slow),
    ],
)
def test_pdm_closed_drives_among_the_recorded_traffic(
    logs: dict[str, DrivingLog], name: str, seconds: float
) -> None:
    log = logs[name]
    start = int(log.world_from_rig.timestamps_us[0])
    actor = recorded_near_the_road(log)
    rollout = run_rollout(
        RolloutSetup(
            log=log,
            track_id=actor.track_id,
            motion=Recorded(actor, start),
            start_timestamp_us=start,
            steps=round(10 * seconds),
            traffic="replay",
            road_margin=0.0,
        ),
        PdmClosedPlanner(),
    )
    assert np.isfinite(rollout.ego).all()
    assert _off_area(log, rollout.ego_boxes) == 0.0
    driven = np.linalg.norm(np.diff(rollout.ego[:, :2], axis=0), axis=1).sum()
    assert driven > 6.0 * min(seconds, 3.0)
    # Cut only where the recorded road ends, because it drives faster than the recorded ego.
    assert rollout.steps_run == rollout.steps_requested or "recorded road" in str(
        rollout.cut_reason
    )


def recorded_near_the_road(log: DrivingLog) -> Track:
    """A car that is beside the recorded road as long as it is labelled, longest labelled first."""
    route = ReferenceRoute.from_trajectory(log.world_from_rig)
    cars = [track for track in log.tracks.values() if track.category == "car"]
    for track in sorted(cars, key=lambda car: -len(car.trajectory.timestamps_us)):
        s, lateral = route.project(track.trajectory.poses[:, :2, 3])
        if np.all((s > 0) & (s < route.length - 2) & (np.abs(lateral) > 2.5)):
            return track
    raise AssertionError("no car beside the road")
