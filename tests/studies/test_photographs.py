"""`recast eval photographs`: from folders of pictures to scores."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from recast.actors import Asset, Observation, TemplateGenerator
from recast.actors.generate import UNIT_CUBE_Z_UP
from recast.cli.main import main
from recast.core.errors import InputError
from recast.geometry import se3
from recast.splats import Gaussians, write_ply
from recast.studies.photographs import evaluate_photographs, photographs_table
from support.crops import SIZE, two_coloured_box, write_crops


@pytest.fixture(scope="module")
def crops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_crops(tmp_path_factory.mktemp("crops") / "set", ("car-a", "car-b"))


def cube_vehicle(yaw: float) -> Gaussians:
    """The photographed vehicle as a generator of any heading and unit would give it."""
    import torch

    pose = se3.from_rotation_translation(se3.rotation_z(yaw), np.zeros(3))
    return two_coloured_box().transformed(torch.from_numpy(pose), 0.2)


@pytest.fixture(scope="module")
def ply(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ply") / "car.ply"
    write_ply(path, cube_vehicle(2.0))
    return path


def test_a_ply_through_the_command(
    crops: Path, ply: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = []
    for name in ("first", "second"):
        args = ["eval", "photographs", str(crops), "--model", f"car={ply}"]
        args += ["--out", str(tmp_path / name)]
        assert main([*args, "--limit", "1"]) == 0
        told.append(capsys.readouterr().out)
    assert "IoU" in told[0] and "car-a" in told[0]
    out = tmp_path / "first"
    assert {path.name for path in out.iterdir()} == {"metrics.json", "timings.json", "car"}
    data = (out / "metrics.json").read_bytes()
    assert data == (tmp_path / "second" / "metrics.json").read_bytes()
    sheets = [tmp_path / name / "car" / "car-a.png" for name in ("first", "second")]
    assert sheets[0].read_bytes() == sheets[1].read_bytes()
    metrics = json.loads(data)
    (made,) = metrics["generators"]
    assert (metrics["version"], made["generator"], metrics["seed"]) == (2, "ply", 0)
    (vehicle,) = made["vehicles"]
    assert vehicle["input"] == "frame_00"
    assert vehicle["input_azimuth_deg"] == pytest.approx(130.0, abs=1e-5)
    assert [round(view["azimuth_deg"]) for view in vehicle["views"]] == [40, 200]
    assert [round(view["apart_deg"]) for view in vehicle["views"]] == [90, 70]
    # the very vehicle that was photographed, its heading found anew
    assert made["mean"]["mask_iou"] > 0.93
    assert made["mean"]["psnr"] > 20
    assert made["mean"]["paint"] < 5 and made["mean"]["structure"] < 0.2
    assert made["far"] == made["mean"] and made["failures"] == {}
    sheet = cv2.imread(str(sheets[0]))
    assert sheet is not None and sheet.shape[1] > 1000


def test_renders_of_an_earlier_run_beside_another_generator(
    crops: Path, ply: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "first"
    first = evaluate_photographs({"car": str(ply)}, [crops], out)
    views = f"views:{out / 'car'}"
    args = ["eval", "photographs", str(crops), "--model", f"before={views}", "--model", str(ply)]
    assert main([*args, "--out", str(tmp_path / "both"), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["generator"] for row in rows if "vehicle" in row] == [
        "before",
        "before",
        "car.ply",
        "car.ply",
    ]
    before, again = (row for row in rows if row.get("over") == "all")
    assert before["psnr_db"] == pytest.approx(first.generators[0].mean["psnr"], abs=0.2)
    assert before["psnr_db"] == pytest.approx(again["psnr_db"], abs=0.2)
    second = evaluate_photographs({"a": views, "b": views}, [crops / "car-a"], tmp_path / "c")
    console = Console(width=200)
    with console.capture() as shown:
        console.print(photographs_table(second))
    assert "b - a, mean" in shown.get() and "beyond 60 degrees" in shown.get()
    with pytest.raises(InputError, match="is in two sets"):
        evaluate_photographs({"a": views}, [crops, crops], tmp_path / "d")


def test_the_template_makes_a_vehicle_of_a_crop(crops: Path, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    generator = TemplateGenerator(spacing=0.12, style="hatchback")
    result = evaluate_photographs(
        {"coarse": generator},
        [crops / "car-a"],
        tmp_path / "out",
        seed=3,
        progress=lambda done, of: told.append((done, of)),
    )
    assert told == [(1, 1)]
    (made,) = result.generators
    (vehicle,) = made.vehicles
    assert vehicle.details["style"] == "hatchback" and vehicle.placement is not None
    assert vehicle.placement.yaw == 0.0  # its front is declared
    assert vehicle.mean["mask_iou"] > 0.75
    assert made.mean == pytest.approx(vehicle.mean)


class Sometimes:
    """Fails on some vehicles, as a network that samples nothing does."""

    name = "sometimes"

    def __init__(self, fails_on: tuple[str, ...]) -> None:
        self.fails_on = fails_on
        self.asked: list[Observation] = []

    def generate(self, observation: Observation, seed: int) -> Asset:
        self.asked.append(observation)
        if observation.track_id.split("/")[0] in self.fails_on:
            raise InputError(observation.track_id, "structure", "is empty", "try another seed")
        return Asset(cube_vehicle(0.0), UNIT_CUBE_Z_UP, self.name, seed, {"steps": 3})


def test_a_vehicle_that_fails_is_recorded_and_the_rest_judged(crops: Path, tmp_path: Path) -> None:
    generator = Sometimes(("car-a",))
    result = evaluate_photographs({"net": generator}, [crops], tmp_path / "out").generators[0]
    assert [one.id for one in result.vehicles] == ["car-b"]
    assert "structure: is empty" in result.failures["car-a"]
    assert result.vehicles[0].details == {"steps": 3}
    written = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert written["generators"][0]["failures"] == result.failures
    # what a generator is given: a crop with background and mask, the box, no LiDAR
    seen = generator.asked[1]
    assert seen.points.shape == (0, 3)
    assert tuple(seen.size) == SIZE
    assert set(np.unique(seen.rgba[..., 3])) == {0, 255}
    assert seen.rgba[..., :3][seen.rgba[..., 3] == 0].min() > 0


def test_a_generator_is_given_further_views(tmp_path: Path) -> None:
    """The real crops' further inputs; the names of those used stand in the record."""
    folder = write_crops(tmp_path / "set", ("car-a",), inputs=((130.0, 4.0), (30.0, 4.0)))
    for views, names in ((1, ()), (2, ("frame_01",)), (5, ("frame_01",))):
        generator = Sometimes(())
        out = tmp_path / f"out{views}"
        (result,) = evaluate_photographs({"a": generator}, [folder], out, views=views).generators
        (asked,) = generator.asked
        assert result.vehicles[0].further == names
        assert [round(np.degrees(one.azimuth)) for one in asked.views] == [130, 30][
            : 1 + len(names)
        ]


def test_nothing_is_left_where_no_vehicle_could_be_made(crops: Path, tmp_path: Path) -> None:
    for folder, fails in ((crops, ("car-a", "car-b")), (crops / "car-a", ("car-a",))):
        with pytest.raises(InputError, match="structure: is empty"):
            evaluate_photographs({"a": Sometimes(fails)}, [folder], tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_bad_input_is_one_line(
    crops: Path, ply: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(model: object, *args: object) -> str:
        command = ["eval", "photographs", *(str(arg) for arg in args), "--model", f"a={model}"]
        assert main(command) == 2
        line = capsys.readouterr().err
        assert line.startswith("recast: ") and line.count("\n") == 1
        return line

    out = tmp_path / "out"
    assert "is not a folder" in refused(ply, tmp_path / "nowhere", "--out", out)
    assert "has no set.json and no ID/input_views" in refused(ply, tmp_path, "--out", out)
    assert "generator: diorama: is not known" in refused("diorama", crops, "--out", out)
    assert "pth: does not exist" in refused(
        ply, crops, "--out", out, "--lpips-weights", tmp_path / "alex.pth"
    )
    assert not out.exists()
    out.mkdir()
    assert "exists already" in refused(ply, crops, "--out", out, "--limit", 1)


@pytest.mark.real_data
def test_real_vehicles(shared: Path, tmp_path: Path) -> None:
    """A coarse template stands where the photographed pickup does."""
    folder = shared / "data" / "vehicles" / "f32727777c346318"
    generator = TemplateGenerator(spacing=0.06)
    result = evaluate_photographs({"template": generator}, [folder], tmp_path / "out")
    (vehicle,) = result.generators[0].vehicles
    assert vehicle.placement is not None
    assert vehicle.details["style"] == "pickup"
    assert not vehicle.placement.flipped
    assert vehicle.mean["mask_iou"] > 0.75
    assert vehicle.mean["psnr"] > 18
    assert result.to_json()["generators"][0]["vehicles"][0]["views"][0]["name"] == "frame_00"
