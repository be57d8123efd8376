"""The generator that picks one of a user's vehicles."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from recast.actors import Actor, Observation, SplatGenerator, make_generator, save_actor
from recast.actors import library as retrieval
from recast.actors import library as summaries
from recast.actors.generate import VEHICLE, candidates_of
from recast.actors.library import LibraryGenerator, Summary, paint_apart, size_apart, summary_of
from recast.actors.mesh_generator import MeshGenerator
from recast.actors.vehicle_files import vehicle_generator
from recast.core.errors import InputError
from recast.runs.sources import generator_source
from recast.splats import write_ply
from support import made_up_actors as made_up
from support.mesh_files import car as box_car
from support.mesh_files import picture, textured_square
from support.tiny_clip import write_clip

BLUE = np.array([0.05, 0.08, 0.6])
BUS = np.array([8.0, 2.3, 2.9])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The vehicle of the made-up street, and others that differ in one thing or in all."""
    found: Path = tmp_path_factory.mktemp("library")
    vehicles = {
        "red-estate": made_up.car(),
        "blue-estate": made_up.car(paint=BLUE),
        "red-pickup": made_up.car(style="pickup"),
        "blue-van": made_up.car(np.array([5.4, 2.0, 2.3]), BLUE, "van"),
        "red-bus": made_up.car(BUS, style="bus"),
    }
    for name, gaussians in vehicles.items():
        write_ply(found / f"{name}.ply", gaussians)
    box_car().write(found / "boxes.glb")
    (found / "broken.glb").write_bytes(b"glTF" + bytes(40))
    (found / "notes.txt").write_text("not a vehicle")
    return found


def test_the_vehicle_itself_is_found(folder: Path, observation: Observation) -> None:
    ranking, left_out = LibraryGenerator(folder, "z-up").rank(observation)
    assert ranking[0].path.stem == "red-estate"
    assert sorted(ranking[0].terms) == ["colour", "lidar", "paint", "silhouette", "size"]
    costs = [one.cost for one in ranking]
    assert costs == sorted(costs)
    order = [one.path.stem for one in ranking]
    assert order.index("blue-estate") < order.index("blue-van")
    assert order.index("red-pickup") < order.index("red-bus")
    assert [text for text in left_out if "broken.glb: header" in text]


def test_the_choice_is_told(folder: Path, observation: Observation) -> None:
    generator = LibraryGenerator(folder, "z-up", tried=2)
    asset = generator.generate(observation, seed=3)
    assert (asset.generator, asset.seed, asset.axes.up) == ("library", 3, "+z")
    details = asset.details
    assert (details["file"], details["read_by"], details["rank"]) == ("red-estate.ply", "ply", 1)
    assert str(details["ranking"]).startswith("red-estate.ply ")
    assert "silhouette 0." in str(details["ranking"])
    assert details["vehicles"] == 7
    assert "broken.glb" in str(details["left_out"])
    assert dict(generator.generate(observation, seed=3).details) == dict(details)


def test_evidence_is_offered_the_best_few(folder: Path, observation: Observation) -> None:
    generator = LibraryGenerator(folder, "z-up", tried=3, offered=2)
    first, second = (make() for make in candidates_of(generator, observation, 0))
    assert [one.details["rank"] for one in (first, second)] == [1, 2]
    told = str(first.details["ranking"]).split("; ")
    assert len(told) == 3
    for one, text in zip((first, second), told, strict=False):
        assert text.startswith(f"{one.details['file']} ")


def test_only_the_likeliest_are_placed(
    folder: Path, observation: Observation, monkeypatch: pytest.MonkeyPatch
) -> None:
    placed: list[Path] = []

    def counted(path: Path, *rest: object) -> object:
        placed.append(path)
        return vehicle_generator(path, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(retrieval, "vehicle_generator", counted)
    ranking, _ = LibraryGenerator(folder, "z-up", tried=2).rank(observation)
    assert len(ranking) == len(placed) == 2
    assert {path.stem for path in placed} == {"red-estate", "red-pickup"}


def test_a_file_is_read_once_until_it_changes(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "car.ply"
    path.write_bytes((folder / "red-estate.ply").read_bytes())
    read: list[Path] = []
    original = summaries.read_gaussians
    monkeypatch.setattr(summaries, "read_gaussians", lambda p: read.append(p) or original(p))  # type: ignore[func-returns-value]
    assert summary_of(path) is summary_of(path)
    assert read == [path]
    os.utime(path, ns=(0, 0))
    summary_of(path)
    assert read == [path, path]


def test_proportions_and_paint(folder: Path) -> None:
    red, blue, bus = (
        summary_of(folder / f"{name}.ply") for name in ("red-estate", "blue-estate", "red-bus")
    )
    for one in (red, blue, bus):
        assert isinstance(one, Summary)
    assert size_apart(red, made_up.SIZE) < 0.1 < size_apart(red, BUS)  # type: ignore[arg-type]
    assert size_apart(bus, BUS) < 0.1  # type: ignore[arg-type]
    assert paint_apart(red, red.paint * 0.4) == pytest.approx(0, abs=1e-9)  # type: ignore[arg-type,union-attr]
    assert paint_apart(red, blue.paint) > 0.05  # type: ignore[arg-type,union-attr]


def test_an_actor_of_another_track_is_a_vehicle(
    actor: Actor, observation: Observation, tmp_path: Path
) -> None:
    save_actor(actor, tmp_path / "mine")
    asset = LibraryGenerator(tmp_path).generate(observation, 0)
    assert asset.axes == VEHICLE
    assert (asset.details["file"], asset.details["made_by"]) == ("mine", "template")


def test_clip_counts_if_its_weights_are_there(
    folder: Path, observation: Observation, tmp_path: Path
) -> None:
    for name in ("red-estate", "red-bus"):
        (tmp_path / f"{name}.ply").write_bytes((folder / f"{name}.ply").read_bytes())
    write_clip(tmp_path / "clip")
    ranking, _ = LibraryGenerator(tmp_path, "z-up").rank(observation)
    terms = {one.path.stem: one.terms["clip"] for one in ranking}
    assert all(0 <= term <= 2 for term in terms.values())
    assert terms["red-estate"] != terms["red-bus"]
    (tmp_path / "clip/model.safetensors").unlink()
    with pytest.raises(InputError, match=r"model\.safetensors"):
        LibraryGenerator(tmp_path)


def test_libraries_of_no_use(observation: Observation, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is missing"):
        LibraryGenerator(tmp_path / "none")
    with pytest.raises(InputError, match="holds no vehicle"):
        LibraryGenerator(tmp_path)
    (tmp_path / "a.ply").write_text("ply")
    (tmp_path / "b.obj").write_text("v 0 0 0")
    with pytest.raises(InputError, match="holds 2 vehicles, but none can be used") as error:
        LibraryGenerator(tmp_path).generate(observation, 0)
    assert "\n" not in str(error.value)


def test_what_stands_behind_names(folder: Path, tmp_path: Path) -> None:
    library = make_generator(f"library:{folder}", "z-up")
    assert isinstance(library, LibraryGenerator) and library.axes == "z-up"
    assert isinstance(make_generator(str(folder / "boxes.glb")), MeshGenerator)
    assert isinstance(make_generator(str(folder / "red-bus.ply")), SplatGenerator)
    for missing in ("none.glb", "none.OBJ", "none.ply"):
        with pytest.raises(InputError, match="is missing"):
            make_generator(str(tmp_path / missing))


def test_every_file_counts_in_the_fingerprint(tmp_path: Path) -> None:
    red, blue = (np.full((2, 2, 3), c, np.uint8) for c in ([200, 0, 0], [0, 0, 200]))
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd paint.png\n")
    (tmp_path / "paint.png").write_bytes(picture(red))
    glb = textured_square(red)
    glb.tree["images"] = [{"uri": "paint.png"}]
    glb.write(tmp_path / "b.glb")
    generators = [str(tmp_path / "a.obj"), str(tmp_path / "b.glb"), f"library:{tmp_path}"]
    before = [generator_source(name) for name in generators]
    assert before == [generator_source(name) for name in generators]
    (tmp_path / "paint.png").write_bytes(picture(blue))
    after = [generator_source(name) for name in generators]
    assert all(one != other for one, other in zip(before, after, strict=True))
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 0 0\n")
    assert generator_source(generators[0]) != after[0]
    (tmp_path / "a.mtl").unlink()
    with pytest.raises(InputError, match=r"a\.mtl"):
        generator_source(generators[0])
