from __future__ import annotations

import json
import math
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.cli.main import main
from recast.core.errors import InputError
from recast.core.files import folder_name
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.runs.display import evaluate_and_print
from recast.scene import (
    SceneActor,
    SkyMap,
    StreetScene,
    export_scene,
    export_scene_at,
    load_scene,
    render_scene,
    save_scene,
)
from recast.scene.exchange import import_gaussians
from recast.scene.sky import read_sky, sample_cubemap, sky_from_cubemap, write_sky
from recast.splats import CLASSIC, MIP, LowPass, read_ply, write_ply
from recast.splats.formats import read_gaussians
from support import trained_scenes as made


@pytest.fixture(scope="module")
def log() -> DrivingLog:
    return made.make_log()


@pytest.fixture(scope="module")
def scene(log: DrivingLog) -> StreetScene:
    """A background, a moving car with a shadow and a parked one, ids that no file may have."""
    car = made.make_car(1)
    shadow = replace(car.select(torch.arange(9)), sh=torch.zeros(9, 1, 3))
    moving, parked = (log.tracks[name].trajectory for name in (made.CAR, made.PARKED))
    actors = {
        "car/1": SceneActor("car/1", car, np.array([4.2, 1.8, 1.6]), moving, shadow),
        "car_1": SceneActor("car_1", made.make_car(3, 4), np.ones(3), parked),
    }
    generator = torch.Generator().manual_seed(1)
    sky = SkyMap(torch.rand(16, 64, 3, generator=generator))
    return StreetScene(made.make_background(3), actors, sky, made.OFFSET, {}, "drive")


def images(scene: StreetScene, poses: dict[str, np.ndarray]) -> np.ndarray:
    cameras = [made.camera_from_world(frame) for frame in (0.0, 3.0)]
    return np.stack([render_scene(scene, made.CAMERA, camera, poses).rgb for camera in cameras])


def through(scene: StreetScene, low_pass: LowPass) -> StreetScene:
    """The scene as if it were made for the filter; without shadows, which are not."""
    actors = {
        name: replace(actor, low_pass=low_pass, shadow=None) for name, actor in scene.actors.items()
    }
    return replace(scene, low_pass=low_pass, actors=actors)


@pytest.mark.parametrize("low_pass", [CLASSIC, MIP])
def test_a_merged_export_comes_back_with_the_same_pictures(
    scene: StreetScene, log: DrivingLog, tmp_path: Path, low_pass: LowPass
) -> None:
    scene = scene if low_pass == CLASSIC else through(scene, low_pass)
    time = export_scene_at(scene, tmp_path / "out", 0.25)
    assert time == made.TIMES[0] + 250_000
    import_gaussians(
        tmp_path / "out" / "merged.ply", log, tmp_path / "scene", sky=tmp_path / "out" / "sky.png"
    )
    back = load_scene(tmp_path / "scene")
    assert back.low_pass == low_pass
    before = images(scene, scene.actor_poses(time))
    assert np.abs(images(back, {}) - before).max() < 1e-4
    assert np.abs(images(scene, {}) - before).max() > 0.1
    record = json.loads((tmp_path / "out" / "scene.json").read_text())
    assert record["timestamp_us"] == time
    assert [actor["track_id"] for actor in record["actors"]] == ["car/1", "car_1"]
    assert np.array_equal(back.world_offset, made.OFFSET) and back.log_name == "drive"


@pytest.mark.parametrize(
    # Of SPZ: 8.5/128 of a harmonic of degree 3, and 1/32 of a log scale, show in a pixel.
    ("name", "suffix", "bound"),
    [("gltf", ".glb", 1e-4), ("usd", ".usda", 1e-4), ("spz", ".spz", 0.1)],
)
def test_other_formats_come_back_with_the_same_pictures(
    scene: StreetScene, log: DrivingLog, tmp_path: Path, name: str, suffix: str, bound: float
) -> None:
    time = export_scene_at(scene, tmp_path / "out", 0.25, name)
    record = import_gaussians(
        tmp_path / "out" / f"merged{suffix}", log, tmp_path / "scene", sky=tmp_path / "out/sky.png"
    )
    assert record.layout == name
    before = images(scene, scene.actor_poses(time))
    assert np.abs(images(load_scene(tmp_path / "scene"), {}) - before).max() < bound
    export_scene(scene, tmp_path / "parts", name)
    parts = json.loads((tmp_path / "parts" / "scene.json").read_text())
    assert parts["splat_format"] == name and name in parts["conventions"]["gaussians"].lower()
    car = read_gaussians(tmp_path / "parts" / parts["actors"][0]["gaussians"])
    own = scene.actors["car/1"].gaussians.means
    # Half a step of SPZ; turning by whole quarters changes no number.
    assert (car.means - own).abs().max() <= (2**-13 if name == "spz" else 0)


def test_parts_are_exported_in_their_own_frames(scene: StreetScene, tmp_path: Path) -> None:
    export_scene(scene, tmp_path / "out")
    record = json.loads((tmp_path / "out" / "scene.json").read_text())
    files = [actor["gaussians"] for actor in record["actors"]]
    assert files == [f"actors/{folder_name('car/1')}.ply", "actors/car_1.ply"]
    assert record["actors"][0]["shadow"] == f"shadows/{folder_name('car/1')}.ply"
    assert "shadow" not in record["actors"][1]
    actors = {}
    for entry in record["actors"]:
        before = scene.actors[entry["track_id"]]
        assert np.array_equal(entry["world_from_actor"], before.trajectory.poses)
        assert entry["timestamps_us"] == before.trajectory.timestamps_us.tolist()
        shadow = entry.get("shadow")
        actors[entry["track_id"]] = replace(
            before,
            gaussians=read_ply(tmp_path / "out" / entry["gaussians"]),
            shadow=None if shadow is None else read_ply(tmp_path / "out" / shadow),
        )
    # Someone else puts them together by scene.json.
    sky = read_sky(tmp_path / "out" / record["sky"])
    built = StreetScene(read_ply(tmp_path / "out" / record["background"]), actors, sky)
    poses = scene.actor_poses(int(made.TIMES[3]))
    assert np.abs(images(built, poses) - images(scene, poses)).max() < 1e-4


def test_times_beyond_the_scene_are_refused(scene: StreetScene, tmp_path: Path) -> None:
    for seconds in (-0.1, 1.1, math.inf, math.nan):
        with pytest.raises(InputError, match="give a time from 0 to 1"):
            export_scene_at(scene, tmp_path / "out", seconds)
    with pytest.raises(InputError, match="the scene has no actors"):
        export_scene_at(replace(scene, actors={}), tmp_path / "out", 0)
    assert not (tmp_path / "out").exists()


def test_a_ply_in_another_frame_and_unit_is_placed(
    scene: StreetScene, log: DrivingLog, tmp_path: Path
) -> None:
    scale, pose = 0.4, se3.exp(np.array([3.0, -2.0, 0.5, 0.2, -0.4, 1.0]))
    # PLY coordinates: (R^T (x - t)) / scale.
    foreign = scene.background.transformed(torch.from_numpy(se3.inverse(pose)))
    foreign = foreign.transformed(torch.eye(4), 1 / scale)
    write_ply(tmp_path / "a.ply", foreign)
    matrix = pose.copy()
    matrix[:3, :3] *= scale
    (tmp_path / "matrix.json").write_text(json.dumps(matrix.tolist()))
    record = import_gaussians(tmp_path / "a.ply", log, tmp_path / "scene", tmp_path / "matrix.json")
    assert record.scale == pytest.approx(scale) and not record.warnings
    assert record.left_out and record.left_out[0].startswith("sky")
    back = replace(load_scene(tmp_path / "scene"), sky=scene.sky)
    assert np.abs(images(back, {}) - images(replace(scene, actors={}), {})).max() < 2e-3


@pytest.mark.parametrize("offset", [(458123.25, 5428765.5, 112.0), (0.0, -5428765.3, 0.1)])
def test_doubles_far_away_are_placed_before_they_are_rounded(
    log: DrivingLog, scene: StreetScene, tmp_path: Path, offset: tuple[float, float, float]
) -> None:
    """Rounded to float32 first, UTM coordinates lose a quarter of a metre."""
    columns = {name: scene.background.means[:, i].numpy() for i, name in enumerate("xyz")}
    rest = [f"f_dc_{i}" for i in range(3)] + ["opacity", *(f"scale_{i}" for i in range(3))]
    rest += [f"rot_{i}" for i in range(4)]
    kinds = [(name, "<f8") for name in "xyz"] + [(name, "<f4") for name in rest]
    table = np.zeros(len(scene.background), kinds)
    for (name, column), shift in zip(columns.items(), offset, strict=True):
        table[name] = column.astype(np.float64) + shift
    table["rot_0"] = 1
    named = "".join(f"property double {name}\n" for name in "xyz")
    named += "".join(f"property float {name}\n" for name in rest)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{named}end_header\n"
    )
    (tmp_path / "a.ply").write_bytes(header.encode() + table.tobytes())
    (tmp_path / "offset.txt").write_text(" ".join(str(-value) for value in offset))
    import_gaussians(tmp_path / "a.ply", log, tmp_path / "scene", tmp_path / "offset.txt")
    placed = load_scene(tmp_path / "scene").background.means
    np.testing.assert_allclose(placed, scene.background.means, atol=1e-5)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("1 2", "numbers: 2"),
        ("1 2 x", "cannot be read"),
        (" ".join(map(str, np.diag([1, 1, -1, 1]).ravel())), "is not a rotation"),
        (" ".join(map(str, np.diag([1, 2, 1, 1]).ravel())), "is not a rotation"),
        (" ".join(["nan"] * 3), "not all within"),
        ("1 2 1e300", "not all within"),
        (" ".join(map(str, np.diag([1e-3, 2e-3, 1e-3, 1]).ravel())), "is not a rotation"),
    ],
)
def test_bad_transforms(log: DrivingLog, tmp_path: Path, text: str, line: str) -> None:
    write_ply(tmp_path / "a.ply", made.make_car(0))
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(InputError, match=line):
        import_gaussians(tmp_path / "a.ply", log, tmp_path / "scene", tmp_path / "t.txt")
    assert not (tmp_path / "scene").exists()


def test_bad_skies(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="file: is missing"):
        read_sky(tmp_path / "none.png")
    (tmp_path / "a.png").write_bytes(b"")
    with pytest.raises(InputError, match="image: cannot be decoded"):
        read_sky(tmp_path / "a.png")


def test_a_sky_is_measured_before_it_is_decoded(scene: StreetScene, tmp_path: Path) -> None:
    write_sky(tmp_path / "sky.png", scene.sky)
    data = bytearray((tmp_path / "sky.png").read_bytes())
    data[16:24] = (9000).to_bytes(4, "big") * 2  # width and height
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    (tmp_path / "sky.png").write_bytes(data)
    with pytest.raises(InputError, match="size: is 9000x9000"):
        read_sky(tmp_path / "sky.png")


def test_sky_image_round_trip(scene: StreetScene, tmp_path: Path) -> None:
    write_sky(tmp_path / "sky.png", scene.sky)
    assert (read_sky(tmp_path / "sky.png").colours - scene.sky.colours).abs().max() < 1e-5


def test_cubemaps_are_looked_up_by_direction() -> None:
    faces = made.make_cubemap()
    directions = torch.randn(2000, 3, generator=torch.Generator().manual_seed(0))
    expected = made.sky_colour(directions)
    # At a face's rim the lookup is held for half a texel, 1/48 of a face.
    assert (sample_cubemap(faces, directions) - expected).abs().max() < 0.012
    turn = torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    sky = sky_from_cubemap(faces, turn)
    assert sky.colours.shape == (96, 192, 3)
    assert (sky(directions) - made.sky_colour(directions @ turn.T)).abs().max() < 0.02


def test_the_commands(
    scene: StreetScene,
    log: DrivingLog,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("recast.logs.read_log", lambda folder: log)
    save_scene(scene, tmp_path / "scene")
    out, again = str(tmp_path / "out"), str(tmp_path / "again")
    assert main(["scene", "export", str(tmp_path / "scene"), "--out", out, "--time", "0.2"]) == 0
    gltf = ["scene", "export", str(tmp_path / "scene"), "--out", f"{out}-glb", "--format", "gltf"]
    assert main(gltf) == 0 and (tmp_path / "out-glb" / "background.glb").is_file()
    command = ["scene", "import", "gaussians", f"{out}/merged.ply", "--log", "log", "--out", again]
    assert main([*command, "--sky", f"{out}/sky.png"]) == 0
    assert "left out" not in capsys.readouterr().out
    assert load_scene(again).log_name == "drive"


def test_an_imported_scene_can_be_judged(tiny_log: DrivingLog, tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", made.make_background(1))
    import_gaussians(tmp_path / "a.ply", tiny_log, tmp_path / "scene")
    judged = evaluate_and_print(tmp_path / "scene", tiny_log, tmp_path / "eval")
    assert len(judged.frames) == 3 and (tmp_path / "eval" / "eval.json").is_file()
