"""Plans on recorded images against what was driven."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.cli.main import main
from recast.core.errors import InputError
from recast.dynamics import PACIFICA
from recast.logs import Track, Trajectory, write_log
from recast.metrics.plan_agreement import read_agreement
from recast.planning import ConstantVelocity, LogReplay
from recast.scene import SkyMap, StreetScene, save_scene
from recast.simulation.recorded_drive import RecordedDrive, what_is_ahead
from recast.splats import Gaussians
from recast.studies.planner_driving import evaluate_planner
from support.recorded_drives import TIMES, Looker, car, log


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
    # one drive for each disturbance, then one as recorded
    drives = np.array_split(np.arange(len(planner.seen)), 4)
    assert [len(one) for one in drives] == [len(found.moments)] * 4
    seen = planner.seen[drives[-1][0]]
    assert seen.images["virtual_left"].shape[2] == 3
    # the middle of a view 30 degrees to the left shows what the wide camera saw there
    assert seen.images["virtual_left"][20, 30, 0] == pytest.approx(188, abs=3)
    assert seen.images["virtual_left"][20, 30, 2] == 1  # the frame at 0.1 s
    assert len(seen.ego_history) == 2 and seen.ego[3] == pytest.approx(10.0)
    later = planner.seen[-1]
    assert len(later.ego_history) == 21
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


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `log`, and `scene`: a blob ahead on a grey sky."""
    folder = tmp_path_factory.mktemp("street")
    write_log(log(tracks=[car(30.0, speed=10.0)]), folder / "log")
    blob = Gaussians(
        means=torch.tensor([[60.0, 0.0, 1.0]]),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        log_scales=torch.zeros(1, 3),
        logit_opacities=torch.full((1,), 4.0),
        sh=torch.zeros(1, 1, 3),
    )
    scene = StreetScene(blob, {}, SkyMap.constant(torch.full((3,), 0.5)))
    save_scene(scene, folder / "scene")
    return folder


def test_plans_on_a_street_that_shows_little(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["eval", "plans", str(street / "log"), "--scene", str(street / "scene")]
    given = [*command, "--planner", "gtrs-mini", "--every", "2"]
    assert main([*given, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "gtrs-mini on rendered images of straight" in said and "reconstructed" in said
    assert all(len(line) <= 80 for line in said.splitlines())
    found = read_agreement(out)
    assert (found.arms, len(found.moments)) == (("reconstructed",), 3)
    assert {one.held_out for one in found.moments} == {None}  # nobody says what it was trained on
    page = (out / "index.html").read_text()
    assert "end more than 2 m from those on the recorded ones in" in page
    assert page.count("<img") == 6 and "<svg" in page
    assert main([*given, "--out", str(out)]) == 2  # it is there
    capsys.readouterr()
    assert main([*command, "--planner", "log-replay", "--out", str(tmp_path / "x")]) == 2
    assert "looks at no images" in capsys.readouterr().err
    assert main([*given, "--every", "0", "--out", str(tmp_path / "x")]) == 2
    assert main([*given, "--detector", "nothing", "--out", str(tmp_path / "x")]) == 2
    (street / "scene" / "source.json").write_text('{"log_name": "another"}')
    assert main([*given, "--out", str(tmp_path / "x")]) == 2
    assert "was trained on another, and the log is straight" in capsys.readouterr().err
    (street / "scene" / "source.json").unlink()
    assert not (tmp_path / "x").exists()


def test_plans_as_json(street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["eval", "plans", str(street / "log"), "--scene", str(street / "scene"), "--json"]
    command += ["--planner", "gtrs-mini", "--every", "4", "--out", str(tmp_path / "out")]
    assert main(command) == 0
    record = json.loads(capsys.readouterr().out)
    rows = {row["images"]: row for row in record if row["table"] == "scores"}
    assert {"reconstructed", "one pixel", "reconstructed: sky recorded"} <= rows.keys()
    assert rows["one pixel"]["psnr_db"] is None and rows["reconstructed"]["psnr_db"] > 0
    assert {"table": "left_out", "moments": 0} in record
