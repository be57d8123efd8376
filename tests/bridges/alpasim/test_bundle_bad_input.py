"""Bundles with a bad value: one line with file, field and mend, exit code 2, nothing written."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.cli.main import main
from recast_bridges.alpasim import export_bundle
from recast_bridges.alpasim.bundle import METADATA, RIG, TRACKS, write_usdz
from recast_bridges.alpasim.bundle_read import LIMITS
from support.small_log import small_log

CAMERA = "front@small"
Change = Callable[[Any], None]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("good") / "a.usdz"
    export_bundle(small_log(np.random.default_rng(0)), path)
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def line_of(
    members: dict[str, bytes],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    *options: str,
) -> str:
    """The one line of an import that must be refused."""
    bundle, out = tmp_path / "bad.usdz", tmp_path / "logs" / "log"
    write_usdz(bundle, members)
    capsys.readouterr()
    assert main(["log", "import", "alpasim", str(bundle), "--out", str(out), *options]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("recast: ")
    assert ";" in line, "names the mend"
    assert [path.name for path in tmp_path.iterdir()] == ["bad.usdz"]
    return line


def rig(change: Change) -> Change:
    return lambda value: change(value["rig_trajectories"][0])


def model(change: Change) -> Change:
    return lambda value: change(value["camera_calibrations"][CAMERA]["camera_model"])


def data(change: Change) -> Change:
    return lambda value: change(value["small"]["tracks_data"])


def put(*way: Any) -> Change:
    """Sets the last of `way` at the members before it."""
    *keys, last, value = way

    def change(found: Any) -> None:
        for key in keys:
            found = found[key]
        found[last] = value

    return change


def drop(name: str) -> Change:
    return lambda found: found.pop(name)


NAN = float("nan")
POSES, TIMES = "T_rig_worlds", "T_rig_world_timestamps_us"
FRAMES = "cameras_frame_timestamps_us"
CASES: dict[str, tuple[str, Change, str]] = {
    "nan in a pose": (RIG, rig(put(POSES, 1, 0, 3, NAN)), "NaN is not a number that JSON allows"),
    "infinite pose": (RIG, rig(put(POSES, 1, 0, 3, 1e300)), f"{POSES}.1: 1e+300 is not within"),
    "bent pose": (RIG, rig(put(POSES, 2, 0, 0, 1.9)), f"{POSES}.2: is not a rotation"),
    "mirrored": (RIG, rig(put(POSES, 2, np.diag([1.0, 1, -1, 1]).tolist())), "is not a rotation"),
    "last row": (RIG, rig(put(POSES, 2, 3, 3, 2.0)), f"{POSES}.2: is not a rotation"),
    "ego jumps": (RIG, rig(put(POSES, 3, 0, 3, 900.0)), f"{POSES}.3: is 90"),
    "time falls": (RIG, rig(put(TIMES, 2, 5)), f"{TIMES}: must increase strictly"),
    "time of no year": (RIG, rig(put(TIMES, 2, 1 << 60)), f"{TIMES}.2: "),
    "negative time": (RIG, rig(put(TIMES, 0, -5)), f"{TIMES}: -5 is not a time"),
    "pose is missing": (RIG, rig(lambda one: one[POSES].pop()), "has 5 poses for 6 times"),
    "one pose": (
        RIG,
        rig(lambda one: one.update({POSES: one[POSES][:1], TIMES: one[TIMES][:1]})),
        "at least two of each are needed",
    ),
    "two rigs": (
        RIG,
        lambda value: value["rig_trajectories"].append(value["rig_trajectories"][0]),
        "rig_trajectories: List should have at most 1 item",
    ),
    "no world_to_nre": (RIG, drop("world_to_nre"), "world_to_nre: Field required"),
    "frame of no length": (RIG, rig(put(FRAMES, CAMERA, 0, [7, 7])), f"{FRAMES}.{CAMERA}: "),
    "frames fall": (RIG, rig(put(FRAMES, CAMERA, 1, [1, 2])), f"{FRAMES}.{CAMERA}: "),
    "unknown camera": (RIG, rig(put(FRAMES, "x", [])), f"{FRAMES}.x: is not in camera_cal"),
    "f-theta": (RIG, model(put("type", "ftheta")), "camera_model.type: is 'ftheta'"),
    "unknown model": (
        RIG,
        model(put("type", "x")),
        "camera_model.type: is 'x', but logs can only hold",
    ),
    "rational": (RIG, model(put("parameters", "radial_coeffs", 3, 0.1)), "beyond k1 k2 p1 p2 k3"),
    "windshield": (
        RIG,
        model(put("parameters", "external_distortion_parameters", {"type": "x"})),
        "beyond k1 k2 p1 p2 k3",
    ),
    "no focal length": (RIG, model(put("parameters", "focal_length", [0, 1])), "parameters: "),
    "huge image": (
        RIG,
        model(put("parameters", "resolution", [1 << 30, 9])),
        "parameters.resolution.0: Input should be less",
    ),
    "camera mount": (
        RIG,
        put("camera_calibrations", CAMERA, "T_sensor_rig", 0, 3, 1e9),
        "T_sensor_rig.0: 1e+09 is not within",
    ),
    "track time falls": (
        TRACKS,
        data(put("tracks_timestamps_us", 0, 1, 3)),
        "tracks.0.timestamps_us: must increase strictly",
    ),
    "nan in a track": (TRACKS, data(put("tracks_poses", 0, 0, 0, NAN)), "NaN is not a number"),
    "quaternion": (
        TRACKS,
        data(put("tracks_poses", 0, 2, 3, 7.0)),
        "tracks_poses.0.2: the length of its quat",
    ),
    "zero quaternion": (
        TRACKS,
        data(put("tracks_poses", 0, 1, [0, 0, 0, 0, 0, 0, 0])),
        "tracks_poses.0.1: the length of its quat",
    ),
    "far away": (TRACKS, data(put("tracks_poses", 0, 0, 0, 1e9)), "tracks.0.poses: 1e+09"),
    "no labels": (
        TRACKS,
        data(lambda one: one.update(tracks_poses=[[]], tracks_timestamps_us=[[]])),
        "tracks_poses.0: has 0 poses for 0 times",
    ),
    "lists differ": (
        TRACKS,
        data(put("tracks_flags", [])),
        "tracks_flags: has 0 entries for 1 tracks",
    ),
    "sizes differ": (
        TRACKS,
        put("small", "cuboidtracks_data", "cuboids_dims", []),
        "cuboids_dims: has 0 entries for 1 tracks",
    ),
    "flat box": (
        TRACKS,
        put("small", "cuboidtracks_data", "cuboids_dims", 0, 2, 0.0),
        "tracks.0.size: expected three sides",
    ),
    "one id twice": (
        TRACKS,
        lambda value: [
            members.extend(members)
            for members in (
                *value["small"]["tracks_data"].values(),
                value["small"]["cuboidtracks_data"]["cuboids_dims"],
            )
        ],
        "tracks_id.1: 'car 7' appears twice",
    ),
    "two sequences": (
        TRACKS,
        lambda value: value.update(other=value["small"]),
        "sequences: Dictionary should have at most 1 item",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_one_bad_value_is_one_line(
    case: str, good: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, change, said = CASES[case]
    value = json.loads(good[name])
    change(value)
    line = line_of({**good, name: json.dumps(value).encode()}, tmp_path, capsys)
    assert said in line
    assert f"bad.usdz/{name}: " in line


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"scene_id: small", b"scene_id: ''", "scene_id: String should have at least 1"),
        (b"scene_id: small", b"", "scene_id: Field required"),
        (b"scene_id: small", b"scene_id: !!python/name:os.system x", "has the tag"),
        (b"  - front", b"  - [", "YAML: cannot be read"),
        (b"end: ", b"end: x", "time_range.end: Input should be a valid number"),
        (b"is_resumable: false", b"is_resumable: maybe", "is_resumable: "),
        (b"scene_id: small", b"scene_id: \xff", "is not UTF-8"),
        (
            b"scene_id: small",
            b"a: &a [1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b]\n"
            b"d: &d [*c,*c,*c,*c,*c,*c]\ne: [*d,*d,*d,*d,*d,*d,*d,*d]",
            "has more than 10000 values",
        ),
    ],
)
def test_bad_metadata_is_one_line(
    old: bytes,
    new: bytes,
    said: str,
    good: dict[str, bytes],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert old in good[METADATA]
    changed = {**good, METADATA: good[METADATA].replace(old, new)}
    line = line_of(changed, tmp_path, capsys)
    assert said in line
    assert f"bad.usdz/{METADATA}" in line


@pytest.mark.parametrize("name", [METADATA, RIG, TRACKS])
def test_missing_members_are_named(
    name: str, good: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left = {key: value for key, value in good.items() if key != name}
    assert f"member {name}: is missing" in line_of(left, tmp_path, capsys)
    assert "cannot be read" in line_of({**good, name: b"{"}, tmp_path, capsys)


def test_members_beyond_their_limit_are_not_read(
    good: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    large = good[METADATA] + bytes(LIMITS[METADATA])
    line = line_of({**good, METADATA: large}, tmp_path, capsys)
    assert f"more than {LIMITS[METADATA]}" in line


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--drive", "other"), "drive other: does not exist; choose one of small"),
        (("--cameras", "back"), "has no camera 'back'; choose one of front"),
        (("--labels", "x.json"), "are already in the bundle"),
        (("--no-refine",), "has no option refine"),
    ],
)
def test_options_that_a_bundle_does_not_have_are_refused(
    options: tuple[str, ...],
    said: str,
    good: dict[str, bytes],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert said in line_of(good, tmp_path, capsys, *options)
