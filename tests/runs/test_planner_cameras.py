"""What a planner sees in a run: printed, recorded, and the same whatever the cameras are called."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console

from recast.cli.main import main
from recast.core.errors import InputError
from recast.geometry import se2
from recast.logs import CameraStream, DrivingLog, Track, Trajectory
from recast.planning import Planner, make_planner
from recast.runs.config import RunConfig
from recast.runs.rollouts import announce_planner, make_rollout, read_rollout, run_mounts
from recast.scene.sky import SkyMap
from recast.scene.street_scene import SceneActor, StreetScene
from recast.simulation import MOTIONS, Rollout, RolloutSetup
from recast.simulation.scene_renderer import SceneRenderer, through_lenses
from recast.splats import Gaussians
from recast.studies import closed_loop, resolve_bench
from recast.synthetic import make_rig

NAMINGS = {
    "ours": ("front_left", "front", "front_right"),
    "Waymo": ("FRONT_LEFT", "FRONT", "FRONT_RIGHT"),
    "nuScenes": ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT"),
    "Argoverse": ("ring_front_left", "ring_front_center", "ring_front_right"),
}


class NoImages:
    def __len__(self) -> int:
        return 0

    def __getitem__(self, index: int) -> np.ndarray:
        raise IndexError(index)


@pytest.fixture(scope="module")
def log() -> DrivingLog:
    """Straight on at 10 m/s with the synthetic rig and a parked car; no images are needed."""
    times = np.arange(81, dtype=np.int64)
    poses = np.stack([times, np.zeros(81), np.zeros(81)], axis=-1).astype(np.float64)
    drive = Trajectory(times * 100_000, se2.to_se3(poses))
    parked = Trajectory(drive.timestamps_us, se2.to_se3(np.tile([30.0, 4.0, 0.0], (81, 1))))
    cameras = {
        name: CameraStream(name, c.camera, c.rig_from_camera, np.zeros(0, np.int64), NoImages())
        for name, c in make_rig(120, 80).cameras.items()
    }
    track = Track("7", "car", np.array([4.2, 1.8, 1.5]), parked)
    return DrivingLog("made", cameras, {}, drive, {"7": track})


@pytest.fixture(scope="module")
def scene(log: DrivingLog) -> StreetScene:
    """Coloured blobs along the road, and a grey one as the actor."""
    rng = np.random.default_rng(0)
    along = log.world_from_rig.poses[rng.integers(0, len(log.world_from_rig.poses), 400), :3, 3]
    means = along + rng.uniform([-8, -8, 0], [8, 8, 4], (400, 3))
    actor = Gaussians(
        torch.zeros(1, 3),
        torch.tensor([[1.0, 0, 0, 0]]),
        torch.full((1, 3), -0.2),
        torch.tensor([8.0]),
        torch.zeros(1, 1, 3),
    )
    street = Gaussians(
        torch.from_numpy(means).float(),
        torch.tensor([[1.0, 0, 0, 0]]).repeat(400, 1),
        torch.full((400, 3), -2.0),
        torch.full((400,), 4.0),
        torch.from_numpy(rng.uniform(-1.5, 1.5, (400, 1, 3))).float(),
    )
    (track,) = log.tracks.values()
    modelled = SceneActor(track.track_id, actor, track.size, track.trajectory)
    return StreetScene(street, {track.track_id: modelled}, SkyMap.constant(torch.full((3,), 0.6)))


def _config(log: DrivingLog, **more: object) -> RunConfig:
    return RunConfig(track=next(iter(log.tracks)), motions=("stationary-a",), **more)


def _said(log: DrivingLog, planner: str = "gtrs-mini") -> str:
    console = Console(file=StringIO(), width=1000)
    made = _planner() if planner == "gtrs-mini" else make_planner(planner)
    announce_planner(made, run_mounts(log, made, _config(log)), console)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


@cache
def _planner() -> Planner:
    return make_planner("gtrs-mini", "cpu")


def _drive(log: DrivingLog, scene: StreetScene, folder: Path) -> Rollout:
    planner, config = _planner(), _config(log)
    mounts = run_mounts(log, planner, config)
    renderer = through_lenses(mounts, lambda sources: SceneRenderer(scene, sources, "cpu"))
    setup = RolloutSetup(log, config.track, MOTIONS["stationary-a"], steps=6)
    make_rollout(setup, planner, renderer, folder, filmed=False)
    rollout = read_rollout(folder)
    assert isinstance(rollout, Rollout), rollout
    return rollout


def _renamed(log: DrivingLog, names: tuple[str, ...]) -> DrivingLog:
    streams = zip(names, log.cameras.values(), strict=True)
    return replace(log, cameras={n: replace(stream, name=n) for n, stream in streams})


@pytest.mark.parametrize(
    ("resized", "namings"), [(False, tuple(NAMINGS)), (True, ("ours", "Argoverse"))]
)
def test_the_same_rollouts_for_all_namings(
    resized: bool, namings: tuple[str, ...], log: DrivingLog, scene: StreetScene, tmp_path: Path
) -> None:
    """With cameras as the planner wants them, and in another shape: then through virtual ones."""
    if resized:
        cameras = {
            name: replace(stream, camera=replace(stream.camera, width=110, cx=55.0))
            for name, stream in log.cameras.items()
        }
        log = replace(log, cameras=cameras)
    files: dict[str, dict[str, bytes]] = {}
    plans = {}
    for who in namings:
        names = NAMINGS[who]
        renamed, folder = _renamed(log, names), tmp_path / who
        plans[who] = _drive(renamed, scene, folder).predictions.tobytes()
        record = json.loads((folder / "planner.json").read_text())
        assert (record["planner"], record["device"]) == ("gtrs-mini", "cpu")
        assert [view["source"] for view in record["views"]] == list(names)
        assert [view["virtual"] for view in record["views"]] == [resized] * 3
        states = (folder / "states").rglob("*")
        files[who] = {path.name: path.read_bytes() for path in states if path.is_file()}
        said = _said(renamed)
        if resized:
            assert f"front by a virtual camera at {names[1]}" in said
        elif who != "ours":
            assert f"sees front_left by {names[0]}; front by {names[1]}; front_" in said
    assert len(set(plans.values())) == 1
    assert all(found == files["ours"] for found in files.values()) and files["ours"]


def test_what_is_seen_matters(log: DrivingLog, scene: StreetScene, tmp_path: Path) -> None:
    """Else the test above would hold for a blind planner."""
    seen = _drive(log, scene, tmp_path / "as it is")
    colours = replace(scene.background, sh=-scene.background.sh)
    other = _drive(log, replace(scene, background=colours), tmp_path / "other colours")
    assert other.predictions.tobytes() != seen.predictions.tobytes()


def test_one_camera_of_a_recorded_drive(tiny_log: DrivingLog) -> None:
    """As KITTI's: wide and low, so that the sides are seen in part; all of it is said."""
    planner = make_planner("gtrs-mini")
    mounts = run_mounts(tiny_log, planner, _config(tiny_log))
    assert list(mounts) == [
        "image_02",
        "virtual_front_left",
        "virtual_front",
        "virtual_front_right",
    ]
    said, warning, *_ = _said(tiny_log).splitlines()
    assert said.startswith(
        "planner gtrs-mini on cpu sees front_left by a virtual camera at image_02"
    )
    assert warning.startswith(
        "warning: planner gtrs-mini sees black where no camera of the log looks"
    )
    assert _said(tiny_log, "idm-follower") == ""


def test_a_log_that_does_not_look_ahead_is_refused_before_anything_is_written(
    log: DrivingLog,
) -> None:
    with pytest.raises(InputError, match="planner gtrs-mini: view front: looks ahead, but the log"):
        run_mounts(log, make_planner("gtrs-mini"), _config(log, scene={"cameras": ["front_left"]}))


def test_a_device_that_is_not_there_is_one_line(
    tiny_log_folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    args = ["run", str(tiny_log_folder), "--track", "0", "--out", str(tmp_path / "run")]
    assert main([*args, "--planner", "gtrs-mini", "--planner-device", "cuda"]) == 2
    assert "planner device: cuda: does not exist: torch finds 0 GPUs" in capsys.readouterr().err
    assert main([*args, "--planner-device", "gpu"]) == 2
    assert "planner_device" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_the_device_is_part_of_a_run(log: DrivingLog) -> None:
    assert _config(log).resolved()["planner_device"] == "auto"
    assert _config(log, planner_device="cuda:1").resolved()["planner_device"] == "cuda:1"
    with pytest.raises(ValueError, match="planner_device"):
        _config(log, planner_device="cuda:one")


def test_a_grid_says_it_for_every_log_and_once_for_synthetic_scenes(tiny_log_folder: Path) -> None:
    console = Console(file=StringIO(), width=1000)
    settings = resolve_bench(
        words=["urban-straight", "industrial", f"{tiny_log_folder}:0"],
        track=None,
        motions=(),
        quick=False,
        config_file=None,
        scene_config_file=None,
        samples=100,
        drive_options={},
        run_options={"planners": ("gtrs-mini",)},
        scene_options={},
    )
    closed_loop._announce(settings, _planner(), console)
    assert isinstance(console.file, StringIO)
    synthetic, recorded, warning = console.file.getvalue().splitlines()
    name = settings.scenes[2].id
    assert synthetic == "synthetic: planner gtrs-mini on cpu sees front_left; front; front_right"
    assert recorded.startswith(f"{name}: planner gtrs-mini on cpu sees front_left by a virtual")
    assert warning.startswith(f"{name}: warning: planner gtrs-mini sees black where no camera")


def test_a_planner_that_is_one_program_has_one_worker(
    tiny_log_folder: Path, tmp_path: Path
) -> None:
    settings = resolve_bench(
        words=[f"{tiny_log_folder}:0"],
        track=None,
        motions=("advancing-a",),
        quick=False,
        config_file=None,
        scene_config_file=None,
        samples=100,
        drive_options={},
        run_options={"planners": ("idm-follower", "neuroncap:localhost:9000")},
        scene_options={},
    )
    console, out = Console(file=StringIO()), tmp_path / "grid"
    for options in ({"workers": 2}, {"workers": 1, "ray": "local"}):
        with pytest.raises(
            InputError, match="neuroncap:localhost:9000: is a single program"
        ) as error:
            closed_loop.run_closed_loop(settings, out, console, **options)
        assert not out.exists() and "use one worker" in str(error.value)
