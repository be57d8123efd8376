"""Scene bundles of AlpaSim: a log to a USDZ file and back, and what its runtime reads of one."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from recast import __version__
from recast.cli.main import main
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog, Track, Trajectory, load_log, log_info, read_log, write_log
from recast.synthetic import populate
from recast.synthetic.write import synthesize_log
from recast_bridges.alpasim import export_bundle
from recast_bridges.alpasim.bundle import LABELS
from support.small_log import small_log
from support.small_street import box_car, small_street

EPS = 2.0**-52
TURNS = 64 * EPS
"""Radians, and entries of a rotation: JSON keeps every digit of a float64, so all that is lost are
the roundings of a quaternion, of its length and of the nearest rotation, some ten of each."""


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> DrivingLog:
    """Half a second of a synthetic street of box-shaped cars, with its map."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(populate, "sample_vehicle", box_car)
        world = populate.populate(small_street("urban-straight"), "urban-straight", 0, 0.5)
    folder = tmp_path_factory.mktemp("street") / "log"
    synthesize_log(world, folder, width=24, height=16, workers=1)
    return read_log(folder)


@pytest.fixture
def small() -> DrivingLog:
    return small_log(np.random.default_rng(0))


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def turned(left: Trajectory, right: Trajectory) -> float:
    """Largest difference of the entries of two trajectories' rotations."""
    return float(np.abs(left.poses[:, :3, :3] - right.poses[:, :3, :3]).max())


def test_a_synthetic_log_comes_back_to_the_microsecond_and_to_rounding(
    street: DrivingLog, tmp_path: Path
) -> None:
    told = export_bundle(street, tmp_path / "street.usdz")
    back = load_log(tmp_path / "street.usdz", importer="alpasim")
    assert back.name == told.scene_id == street.name
    ego = street.world_from_rig
    assert np.array_equal(back.world_from_rig.timestamps_us, ego.timestamps_us)
    assert np.array_equal(back.world_from_rig.poses[:, :3, 3], ego.poses[:, :3, 3])
    assert turned(back.world_from_rig, ego) <= TURNS
    kept = {key: one for key, one in street.tracks.items() if len(one.trajectory.timestamps_us) > 1}
    assert len(kept) > 1
    assert list(back.tracks) == list(kept)
    assert told.tracks == len(kept)
    assert told.tracks_left_out == len(street.tracks) - len(kept)
    for key, track in kept.items():
        found = back.tracks[key]
        assert np.array_equal(found.trajectory.timestamps_us, track.trajectory.timestamps_us)
        assert np.array_equal(found.size, track.size)
        places = track.trajectory.poses[:, :3, 3]
        assert np.array_equal(found.trajectory.poses[:, :3, 3], places)
        assert turned(found.trajectory, track.trajectory) <= TURNS
    assert list(back.cameras) == list(street.cameras)
    for name, stream in street.cameras.items():
        found = back.cameras[name]
        assert found.camera == stream.camera
        assert np.abs(found.rig_from_camera - stream.rig_from_camera).max() <= TURNS
        assert len(found.timestamps_us) == len(found.images) == 0
    assert street.map is not None
    assert back.map is not None
    assert told.lanes == len(street.map.lanes) > 1
    assert list(back.map.lanes) == list(street.map.lanes)
    for key, lane in street.map.lanes.items():
        assert np.array_equal(back.map.lanes[key].centreline, lane.centreline)
        assert back.map.lanes[key].successors == lane.successors
    assert len(back.map.drivable_area) == len(street.map.drivable_area)


def test_a_distorted_camera_and_poses_of_any_direction_come_back(
    small: DrivingLog, tmp_path: Path
) -> None:
    export_bundle(small, tmp_path / "a.usdz", "another id")
    back = load_log(tmp_path / "a.usdz", importer="alpasim", drive="another id")
    assert back.name == "another id"
    assert back.cameras["front"].camera == small.cameras["front"].camera
    track, found = small.tracks["car 7"], back.tracks["car 7"]
    assert turned(found.trajectory, track.trajectory) <= TURNS
    assert np.abs(back.world_from_rig.poses - small.world_from_rig.poses).max() <= TURNS


def test_the_log_of_a_bundle_can_be_written_and_read(small: DrivingLog, tmp_path: Path) -> None:
    export_bundle(small, tmp_path / "a.usdz")
    write_log(load_log(tmp_path / "a.usdz", importer="alpasim"), tmp_path / "log")
    back = read_log(tmp_path / "log")
    assert back.cameras["front"].camera == small.cameras["front"].camera
    assert back.map is None
    log_info(back)


def test_the_runtime_finds_every_field(street: DrivingLog, tmp_path: Path) -> None:
    """Field by field as AlpaSim's `artifact.py` and `scenario.py` read a bundle."""
    export_bundle(street, tmp_path / "a.usdz", "drive 7")
    found = members(tmp_path / "a.usdz")
    metadata = yaml.safe_load(found["metadata.yaml"])
    assert metadata["scene_id"] == "drive 7"
    assert metadata["sensors"]["camera_ids"] == list(street.cameras)
    text = ("version_string", "training_date", "dataset_hash", "uuid")
    assert all(isinstance(metadata[name], str) for name in text)
    first, last = street.world_from_rig.timestamps_us[[0, -1]].tolist()
    assert metadata["time_range"] == {"start": first, "end": last}
    rig = json.loads(found["rig_trajectories.json"])
    assert rig["world_to_nre"]["matrix"] == rig["T_world_base"] == np.eye(4).tolist()
    [trajectory] = rig["rig_trajectories"]
    poses = np.array(trajectory["T_rig_worlds"], np.float32)
    times = np.array(trajectory["T_rig_world_timestamps_us"], np.uint64)
    assert poses.shape == (len(times), 4, 4)
    # The rig's own x axis points along the drive: the poses are not the inverse ones.
    along = np.diff(poses[:, :3, 3], axis=0)
    assert np.all(np.einsum("ti,ti->t", along, poses[:-1, :3, 0]) > 0)
    box = trajectory["rig_bbox"]
    assert box["rot"] == [0, 0, 0]
    assert box["dim"] == [4.049 + 1.127, 2.297, 1.777]
    assert box["centroid"][0] - box["dim"][0] / 2 == pytest.approx(-1.127, abs=4 * EPS)
    names = {}
    for key, frames in trajectory["cameras_frame_timestamps_us"].items():
        name = rig["camera_calibrations"][key]["logical_sensor_name"]
        names[name] = frames
        assert all(first <= start < end <= last for start, end in frames)
    for name, stream in street.cameras.items():
        kept = stream.timestamps_us[stream.timestamps_us > first]
        assert [end for _, end in names[name]] == kept.tolist()
    [tracks] = json.loads(found["sequence_tracks.json"]).values()
    data, sizes = tracks["tracks_data"], tracks["cuboidtracks_data"]["cuboids_dims"]
    rows = zip(*(data[name] for name in sorted(data)), sizes, strict=True)  # all of one length
    kinds = set()
    for flags, key, label, track_poses, track_times, size in rows:
        track = street.tracks[key]
        assert label == LABELS[track.category]
        assert np.array(track_poses).shape == (len(track_times), 7)
        assert len(size) == 3
        assert len(track_times) > 1  # or the runtime can lay no spline
        kinds.add("CONTROLLABLE" in flags)
        quat = np.array(track_poses)[0, [6, 3, 4, 5]]
        turn = se3.quat_to_matrix(quat) - track.trajectory.poses[0, :3, :3]
        assert np.abs(turn).max() <= TURNS
    assert kinds == {True, False}  # the runtime does not move parked cars
    assert b"geoReference" not in found["map.xodr"]  # the map's frame is the local one


def test_the_metadata_to_the_letter(small: DrivingLog, tmp_path: Path) -> None:
    export_bundle(small, tmp_path / "a.usdz", "a: 'b'\n")
    text = members(tmp_path / "a.usdz")["metadata.yaml"].decode()
    digest = yaml.safe_load(text)["dataset_hash"]
    variant = hex(int(digest[16], 16) & 3 | 8)[2:]
    name = f"{digest[:8]}-{digest[8:12]}-4{digest[13:16]}-{variant}{digest[17:20]}-{digest[20:]}"
    assert text == (
        "scene_id: \"a: 'b'\\n\"\n"
        f'version_string: "recast-{__version__}"\n'
        'training_date: "2023-11-14"\n'
        f'dataset_hash: "{digest}"\n'
        f'uuid: "{name}"\n'
        "is_resumable: false\n"
        "sensors:\n  camera_ids:\n  - front\n  lidar_ids: []\n"
        "logger:\n  name: recast\n  run_id: null\n  run_url: null\n"
        "time_range:\n  start: 1700000000000000.0\n  end: 1700000000500000.0\n"
    )


def test_the_same_log_gives_the_same_bytes(street: DrivingLog, tmp_path: Path) -> None:
    for name in ("a.usdz", "b.usdz"):
        export_bundle(street, tmp_path / name)
    assert (tmp_path / "a.usdz").read_bytes() == (tmp_path / "b.usdz").read_bytes()
    moved = replace(street, tracks=dict(list(street.tracks.items())[1:]))
    export_bundle(moved, tmp_path / "c.usdz")
    ids = {yaml.safe_load(members(tmp_path / f"{n}.usdz")["metadata.yaml"])["uuid"] for n in "abc"}
    assert len(ids) == 2


NAMES = ("../../x", "/etc/passwd", 'a"b\\c', "none", "a\nb\x00c", "\u202etrack", "1e3", "@", "null")


def test_names_are_text_and_never_members_or_paths(small: DrivingLog, tmp_path: Path) -> None:
    track, camera = small.tracks["car 7"], small.cameras["front"]
    poses = track.trajectory.poses.copy()
    poses[:, :3, :3] = np.eye(3)  # so many cars that lean would be refused
    track = replace(track, trajectory=Trajectory(track.trajectory.timestamps_us, poses))
    hostile = replace(
        small,
        name="../../up\n",
        tracks={name: replace(track, track_id=name) for name in NAMES},
        cameras={name: replace(camera, name=name) for name in NAMES},
    )
    export_bundle(hostile, tmp_path / "in" / "a.usdz")
    plain = ["default.usda", "metadata.yaml", "rig_trajectories.json", "sequence_tracks.json"]
    assert list(members(tmp_path / "in" / "a.usdz")) == plain
    back = load_log(tmp_path / "in" / "a.usdz", importer="alpasim")
    assert back.name == "../../up\n"
    assert tuple(back.tracks) == tuple(back.cameras) == NAMES
    assert [path.name for path in tmp_path.rglob("*")] == ["in", "a.usdz"]


@pytest.mark.parametrize("category", [*LABELS, "misc", "spaceship"])
def test_categories_that_alpasim_tells_apart_come_back(
    category: str, small: DrivingLog, tmp_path: Path
) -> None:
    track = replace(small.tracks["car 7"], category=category)
    export_bundle(replace(small, tracks={"car 7": track}), tmp_path / "a.usdz")
    back = load_log(tmp_path / "a.usdz", importer="alpasim").tracks["car 7"].category
    expected = {"van": "car", "spaceship": "misc", "motorcyclist": "cyclist"}
    assert back == expected.get(category, category)


def test_labels_without_the_ego_and_single_labels_are_left_out(
    small: DrivingLog, tmp_path: Path
) -> None:
    one = small.tracks["car 7"]
    single = Trajectory(one.trajectory.timestamps_us[:1], one.trajectory.poses[:1])
    log = replace(small, tracks={"car 7": one, "b": Track("b", "car", one.size, single)})
    told = export_bundle(log, tmp_path / "a.usdz")
    assert (told.tracks, told.tracks_left_out, told.frames_left_out) == (1, 1, 1)
    found = members(tmp_path / "a.usdz")
    tracks = json.loads(found["sequence_tracks.json"])
    times: list[int] = tracks["small"]["tracks_data"]["tracks_timestamps_us"][0]
    assert len(times) == 3
    times[0] = int(small.world_from_rig.timestamps_us[0]) - 1
    found["sequence_tracks.json"] = json.dumps(tracks).encode()
    with zipfile.ZipFile(tmp_path / "b.usdz", "w") as archive:
        for name, data in found.items():
            archive.writestr(name, data)
    back = load_log(tmp_path / "b.usdz", importer="alpasim").tracks["car 7"]
    assert back.trajectory.timestamps_us.tolist() == times[1:]


def test_the_commands_there_and_back(
    street: DrivingLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, bundle = street.origin, tmp_path / "street.usdz"
    assert main(["log", "export", "alpasim", str(log), "--scene", "s", "--out", str(bundle)]) == 0
    assert f"wrote {bundle}: scene s, " in capsys.readouterr().out
    words = ["log", "import", "alpasim", str(bundle), "--out"]
    assert main([*words, str(tmp_path / "log")]) == 0
    assert "alpasim is experimental" in capsys.readouterr().out
    assert list(read_log(tmp_path / "log").cameras) == list(street.cameras)
    assert main([*words, str(tmp_path / "none"), "--cameras", "none"]) == 0
    assert not read_log(tmp_path / "none").cameras
    bare = tmp_path / "bare.usdz"
    assert main(["log", "export", "alpasim", str(log), "--no-map", "--out", str(bare)]) == 0
    assert "map.xodr" not in members(bare)


@pytest.mark.parametrize(
    ("name", "problem"), [("a.zip", "does not end in .usdz"), ("there.usdz", "exists already")]
)
def test_outputs_that_are_refused(
    name: str, problem: str, small: DrivingLog, tmp_path: Path
) -> None:
    (tmp_path / "there.usdz").write_bytes(b"mine")
    with pytest.raises(InputError, match=problem):
        export_bundle(small, tmp_path / name)
    assert (tmp_path / "there.usdz").read_bytes() == b"mine"
    assert len(list(tmp_path.iterdir())) == 1


def test_ids_that_are_no_names_are_refused(small: DrivingLog, tmp_path: Path) -> None:
    bad: Any
    for bad in ("", "x" * 1001, "\ud800"):
        with pytest.raises(InputError, match="scene"):
            export_bundle(small, tmp_path / "a.usdz", bad)
    assert not list(tmp_path.iterdir())
