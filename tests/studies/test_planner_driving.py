"""Plans on recorded images against what was driven."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recast.arrays import Array
from recast.cameras import PinholeCamera, View
from recast.cameras.mounts import camera_pose
from recast.cli.main import main
from recast.core.errors import InputError
from recast.dynamics import PACIFICA
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, Track, Trajectory, write_log
from recast.planning import BasePlanner, ConstantVelocity, LogReplay, Plan, PlannerInput
from recast.studies.planner_driving import (
    RecordedDrive,
    evaluate_planner,
    what_is_ahead,
)

START = 1_700_000_000_000_000
TIMES = START + 100_000 * np.arange(91, dtype=np.int64)
WIDE = PinholeCamera(160, 80, 60.0, 60.0, 80.0, 40.0)


def poses(x: Array, y: float = 0.0, heading: float = 0.0) -> Array:
    turn = se3.from_rotation_translation(se3.rotation_z(heading), np.zeros(3))
    found = np.tile(turn, (len(x), 1, 1))
    found[:, 0, 3], found[:, 1, 3] = x, y
    return found


class Azimuths:
    """Images whose red says how far left a pixel looks, and whose blue counts the frames."""

    def __len__(self) -> int:
        return len(TIMES)

    def __getitem__(self, index: int, /) -> Array:
        rays = WIDE.rays(WIDE.pixel_grid())
        left = np.degrees(np.arctan2(-rays[..., 0], rays[..., 2]))
        image = np.zeros((80, 160, 3), np.uint8)
        image[..., 0] = np.clip(128 + 2 * left, 0, 255)
        image[..., 2] = index
        return image


def log(
    speed: Array | float = 10.0, tracks: Sequence[Track] = (), images: bool = True
) -> DrivingLog:
    x = np.cumsum(np.broadcast_to(speed, len(TIMES)) * 0.1)
    mount = camera_pose((1.5, 0.0, 1.5), 0.0, 0.0)
    stream = CameraStream("cam", WIDE, mount, TIMES, Azimuths())
    return DrivingLog(
        name="straight",
        cameras={"cam": stream} if images else {},
        lidars={},
        world_from_rig=Trajectory(TIMES, poses(x)),
        tracks={track.track_id: track for track in tracks},
    )


def car(x: float, y: float = 0.0, speed: float = 0.0, heading: float = 0.0) -> Track:
    places = x + speed * 0.1 * np.arange(len(TIMES))
    size = np.array([4.4, 1.8, 1.5])
    return Track("7", "car", size, Trajectory(TIMES, poses(places, y, heading)))


class Looker(BasePlanner):
    """Stands still in every fourth moment; else drives by the red in the middle of its view."""

    name = "looker"
    needs_images = True
    wanted_views = (View("left", PinholeCamera(60, 40, 60.0, 60.0, 30.0, 20.0), 30.0),)

    def __init__(self) -> None:
        self.seen: list[PlannerInput] = []

    def choose_cameras(self, mounts: object) -> Sequence[str]:
        return ["virtual_left"]

    def plan(self, observation: PlannerInput) -> Plan:
        self.seen.append(observation)
        red = float(observation.images["virtual_left"][20, 28:32, 0].mean())
        waypoints = np.zeros((40, 3))
        speed = 0.0 if (len(self.seen) // 4) % 4 == 3 else 10.0 + (red - 188.0)
        waypoints[:, 0] = speed * 0.1 * np.arange(1, 41)
        return Plan(waypoints)


def test_who_drives_as_recorded_scores_nothing(tmp_path: Path) -> None:
    found = evaluate_planner(LogReplay(), [log()], tmp_path / "out")
    assert found.planner == "log-replay"
    first = found.scores[0]
    assert (first.kind, first.moments) == ("all", 10)  # 0.1 to 5.0 s, each half a second
    assert first.ade == pytest.approx(0.0, abs=1e-9) and first.fde == pytest.approx(0.0, abs=1e-9)
    assert (first.stops_alone, first.goes_alone, first.leaves) == (0.0, None, 0.0)
    assert [one.kind for one in found.scores] == ["all", "free", "from 8 m/s"]
    record = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert record["version"] == 1 and len(record["moments"]) == 10
    page = (tmp_path / "out" / "index.html").read_text()
    assert "end 0.0 m from what was driven" in page
    assert "<img" not in page  # it used no images


def test_a_driver_who_stops_and_a_plan_that_goes_on(tmp_path: Path) -> None:
    braking = np.clip(12.0 - 4.0 * np.arange(len(TIMES)) * 0.1, 0.0, None)
    found = evaluate_planner(ConstantVelocity(), [log(braking)], tmp_path / "out")
    assert found.scores[0].stops_alone is None
    went_on = [one for one in found.moments if not one.stops]
    assert went_on and all(one.driver_stops for one in found.moments)
    assert found.scores[0].goes_alone == pytest.approx(len(went_on) / len(found.moments))
    assert found.moments[0].fde > 15.0


def test_a_planner_sees_the_recorded_images_by_its_own_camera(tmp_path: Path) -> None:
    planner = Looker()
    found = evaluate_planner(planner, [log()], tmp_path / "out")
    seen = planner.seen[0]
    assert seen.images["virtual_left"].shape[2] == 3
    # the middle of a view 30 degrees to the left shows what the wide camera saw there
    assert seen.images["virtual_left"][20, 30, 0] == pytest.approx(188, abs=3)
    assert seen.images["virtual_left"][20, 30, 2] == 1  # the frame at 0.1 s
    assert len(seen.ego_history) == 2 and seen.ego[3] == pytest.approx(10.0)
    later = planner.seen[-1]
    assert len(later.ego_history) == 21
    # one call as recorded, and one for each disturbance
    assert len(planner.seen) == 4 * len(found.moments)
    stopped = [one.stops for one in found.moments]
    assert stopped == [index % 4 == 3 for index in range(len(stopped))]
    assert found.scores[0].stops_alone == pytest.approx(np.mean(stopped))
    moved = found.scores[0].moved
    assert set(moved) == {"one pixel", "one grey level", "JPEG 90"}
    assert moved["one grey level"] < moved["one pixel"] == 0.8  # 2 red a degree, a degree a pixel
    page = (tmp_path / "out" / "index.html").read_text()
    assert page.count("<img") == len(list((tmp_path / "out" / "images").iterdir())) > 0


@pytest.mark.parametrize(
    ("track", "ahead"),
    [
        (car(40.0, speed=10.0), "leading"),
        (car(40.0), "standing"),
        (car(60.0, 3.5, -10.0, np.pi), "oncoming"),
        (car(60.0, 0.0, -10.0, np.pi), "oncoming"),
        (car(40.0, heading=np.pi / 2), "standing"),
        (car(40.0, 3.5, 10.0), "free"),
        (car(-20.0, 0.0, 10.0), "free"),
        (car(120.0, 0.0, 10.0), "free"),
    ],
)
def test_what_is_ahead(track: Track, ahead: str) -> None:
    drive = RecordedDrive(log(tracks=[track]), ConstantVelocity(), PACIFICA, 0)
    assert what_is_ahead(drive.observation(0, int(TIMES[1])), drive.route) == ahead


def test_a_car_that_crosses() -> None:
    across = car(30.0, heading=np.pi / 2)
    moving = np.tile(across.trajectory.poses[:1], (len(TIMES), 1, 1))
    moving[:, 1, 3] = -1.0 + 0.5 * np.arange(len(TIMES))
    crossing = replace(across, trajectory=Trajectory(TIMES, moving))
    drive = RecordedDrive(log(tracks=[crossing]), ConstantVelocity(), PACIFICA, 0)
    assert what_is_ahead(drive.observation(0, int(TIMES[1])), drive.route) == "crossing"


def test_what_is_missing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="the log has none, but the planner uses images"):
        evaluate_planner(Looker(), [log(images=False)], tmp_path / "out")
    short = log()
    brief = replace(short, world_from_rig=Trajectory(TIMES[:30], short.world_from_rig.poses[:30]))
    with pytest.raises(InputError, match="no moment has 4 s of the drive ahead"):
        evaluate_planner(ConstantVelocity(), [brief], tmp_path / "out")
    assert not list(tmp_path.iterdir())
    write_log(log(), tmp_path / "log")
    command = ["eval", "planner", "constant-velocity", str(tmp_path / "log")]
    assert main([*command, "--every", "0", "--out", str(tmp_path / "out")]) == 2
    assert main([*command, "--every", "1", "--out", str(tmp_path / "out")]) == 0
    assert "constant-velocity on recorded images" in capsys.readouterr().out
    assert main([*command, "--out", str(tmp_path / "out")]) == 2
